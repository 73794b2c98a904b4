"""Gains of a joint controller whose torque was not logged: against drives in MuJoCo with known gains.

The leg of sample_logs follows a command 3 ms late; its log has position, velocity and both commands, with noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from leg_motions import shell
from leg_truth import CONFIG, JOINTS, TRUTH, URDF, Truth
from numpy.typing import NDArray
from paths import CONFIGS, REAL
from position_leg import GAINS, KD, KP, noisy, position_controlled

from idtool.common.exceptions import ConfigError
from idtool.data.logs import JointLog
from idtool.estimation import controller_gains
from idtool.estimation.controller_gains import ControllerGains, with_gains
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.fit import fit
from idtool.estimation.reduced_experiment import save_reduction
from idtool.reporting.fit_report import fit_report, model_config
from idtool.robot.config import UncertainValue, parse_config, read_config
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]

DELAY = 3e-3
FIT = {"kp": "fit", "kd": "fit", "delay": DELAY}
SHANK = {
    "known": {"mass": {"shank_link": TRUTH.bodies["shank_link"].mass}},
    "known_com": {"shank_link": TRUTH.bodies["shank_link"].com.tolist()},
}
ENTRIES = ([0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2])


def silent(stage: str, share: float) -> None:
    """No progress."""


@cache
def log(seed: int = 1) -> JointLog:
    """The leg along six seconds of the paper's motion."""
    return noisy(position_controlled(shell(6.0), DELAY), seed)


@cache
def log_without_velocity_command() -> JointLog:
    """The leg under drives that have a position command alone."""
    motion = shell(6.0)
    recorded = noisy(position_controlled(motion._replace(v=np.zeros_like(motion.v)), DELAY), seed=1)
    return replace(recorded, signals={name: x for name, x in recorded.signals.items() if name != "vcmd"})


def robot(mass_factor: float, inertia_factors: Sequence[float] = (1.0, 1.0, 1.0)) -> Robot:
    """The leg with true masses and inertias times factors, those of the links about their centres of mass."""
    urdf = read_robot(URDF)
    links = dict(urdf.links)
    for name, factor in zip(CONFIG["bounding_ellipsoids"], inertia_factors, strict=True):
        body = TRUTH.bodies[name]
        scaled = replace(body, mass=mass_factor * body.mass, inertia=mass_factor * factor * body.inertia)
        links[name] = Truth({name: scaled}, {}).parameters(name)
    return replace(urdf, links=links)


def rotors(mass_factor: float) -> dict[str, Any]:
    """The leg's rotors with true masses and inertias times a factor."""
    scaled = {}
    for name, rotor in CONFIG["rotors"].items():
        body = TRUTH.bodies[name]
        inertia = (mass_factor * body.inertia)[ENTRIES].tolist()
        inertial = {"mass": mass_factor * float(body.mass), "com": np.array(body.com).tolist(), "inertia": inertia}
        scaled[name] = {**rotor, "inertial": inertial}
    return scaled


def experiment(
    controller: Mapping[str, Any], recorded: JointLog | None = None, urdf: Robot | None = None, **options: Any
) -> Experiment:
    """The leg with a log."""
    config = parse_config({**CONFIG, "controller": controller, **options}, "leg.yaml")
    return prepare(urdf or read_robot(URDF), config, [recorded or log()])


def fitted_gains(
    controller: Mapping[str, Any], recorded: JointLog | None = None, urdf: Robot | None = None, **options: Any
) -> ControllerGains:
    """Gains of the leg."""
    _, gains = with_gains(experiment(controller, recorded, urdf, **options), silent)
    assert gains is not None
    return gains


def values(gains: Mapping[str, UncertainValue]) -> Array:
    """Gains of the three joints."""
    return np.array([gains[name].value for name in JOINTS])


@pytest.mark.parametrize("delay", [DELAY, "auto"])
def test_gains_are_found_if_mass_and_centre_of_one_link_are_known(delay: float | str) -> None:
    gains = fitted_gains({**FIT, "delay": delay}, **SHANK)
    assert set(gains.scale_sources.values()) == {"known_values"}
    assert values(gains.kp) == pytest.approx(KP, rel=0.02)
    assert values(gains.kd) == pytest.approx(KD, rel=0.02)
    assert not gains.notices


def test_gains_are_found_if_the_masses_of_the_urdf_are_right_and_its_inertias_are_not() -> None:
    gains = fitted_gains(FIT, urdf=robot(1.0, (1.25, 0.8, 1.25)), rotors=rotors(1.0))
    assert set(gains.scale_sources.values()) == {"prior"}
    assert values(gains.kp) == pytest.approx(KP, rel=0.02)
    assert values(gains.kd) == pytest.approx(KD, rel=0.02)


def test_gains_are_as_wrong_as_all_masses_are() -> None:
    right = fitted_gains(FIT, urdf=robot(1.0), rotors=rotors(1.0))
    wrong = fitted_gains(FIT, urdf=robot(1.2), rotors=rotors(1.2))
    assert values(wrong.kp) == pytest.approx(1.2 * values(right.kp), rel=1e-3)
    assert values(wrong.kd) == pytest.approx(1.2 * values(right.kd), rel=1e-3)
    assert [notice.code for notice in wrong.notices] == ["controller_gains_scale"]
    weighed = fitted_gains(
        FIT, urdf=robot(1.2), rotors=rotors(1.2), known={"total_mass": sum(body.mass for body in TRUTH.bodies.values())}
    )
    assert values(weighed.kp) == pytest.approx(KP, rel=0.02)
    assert [notice.severity for notice in weighed.notices] == ["note"]


def test_a_known_mass_alone_does_not_fix_the_scale() -> None:
    """The torque tells first moments: the mass of a link acts on it like a first moment of the link before it."""
    assert set(fitted_gains(FIT, known=SHANK["known"]).scale_sources.values()) == {"prior"}


@pytest.mark.parametrize("kd", ["fit", GAINS["kd"]])
def test_given_gain_of_one_joint_is_the_scale_of_all(kd: Any) -> None:
    gains = fitted_gains({**FIT, "kp": {"abad": 300.0, "hip": "fit", "knee": "fit"}, "kd": kd})
    assert set(gains.scale_sources.values()) == {"given_gain"}
    assert set(gains.kp) == {"hip", "knee"}
    assert set(gains.kd) == (set(JOINTS) if kd == "fit" else set())
    assert [gain.value for gain in gains.kp.values()] == pytest.approx(KP[1:], rel=0.02)
    assert [gain.value for gain in gains.kd.values()] == pytest.approx(KD[: len(gains.kd)], rel=0.02)


def test_given_kd_of_one_joint_is_the_scale_of_all() -> None:
    gains = fitted_gains({**FIT, "kd": {"abad": float(KD[0]), "hip": "fit", "knee": "fit"}})
    assert set(gains.scale_sources.values()) == {"given_gain"}
    assert values(gains.kp) == pytest.approx(KP, rel=0.02)
    assert [gain.value for gain in gains.kd.values()] == pytest.approx(KD[1:], rel=0.02)


def test_logged_torque_of_one_joint_is_the_scale_of_all() -> None:
    signals = log().signals
    tau = np.full_like(signals["q"], np.nan)
    t = log().t
    for name, gain in (("q", KP[0]), ("v", KD[0])):
        command = np.interp(t - DELAY, t, signals[f"{name}cmd"][:, 0])
        tau[:, 0] = np.nan_to_num(tau[:, 0]) + gain * (command - signals[name][:, 0])
    gains = fitted_gains(FIT, replace(log(), signals={**signals, "tau": tau}))
    assert set(gains.kp) == {"hip", "knee"}
    assert set(gains.scale_sources.values()) == {"logged_torque"}
    assert [gain.value for gain in gains.kp.values()] == pytest.approx(KP[1:], rel=0.02)
    assert [gain.value for gain in gains.kd.values()] == pytest.approx(KD[1:], rel=0.02)


def test_standard_errors_are_those_of_noise() -> None:
    clean = position_controlled(shell(6.0), DELAY)
    found = [fitted_gains(FIT, noisy(clean, seed, louder=5.0), **SHANK) for seed in range(8)]
    for name in ("kp", "kd"):
        of_runs = [getattr(gains, name) for gains in found]
        scatter = np.std([values(gains) for gains in of_runs], axis=0, ddof=1)
        errors = [[gains[joint].standard_error for joint in JOINTS] for gains in of_runs]
        expected = np.sqrt(np.mean(np.square(errors), axis=0))
        assert (scatter / expected < 1.8).all()  # 8 values tell it to 25 %
        assert (scatter / expected > 0.2).all()  # errors of the model count too


def test_errors_contain_the_prior_s_where_it_tells_the_scale_of_a_joint() -> None:
    """In one second, the abad joint hardly moves: its scale relative to the others is a prior's of 30 %."""
    gains = fitted_gains(FIT, noisy(position_controlled(shell(1.0), DELAY), 1))
    assert all(gain.standard_error is not None for gain in gains.kp.values())
    abad, _, knee = (gains.kp[name].standard_error / gains.kp[name].value for name in JOINTS)  # type: ignore[operator]
    assert 0.1 < abad < 0.35
    assert knee < 0.03
    assert "controller_gains_uncertain" in {notice.code for notice in gains.notices}


def test_gains_that_logs_do_not_determine_are_refused() -> None:
    recorded = log()
    ideal = replace(recorded, signals={**recorded.signals, "qcmd": recorded.signals["q"]})
    with pytest.raises(ConfigError, match=r"controller.kp: the logs do not determine kp of abad"):
        fitted_gains(FIT, ideal)
    with pytest.raises(ConfigError, match=r"the position follows its command exactly"):
        fitted_gains({**FIT, "delay": 0.0}, ideal)
    with pytest.raises(ConfigError, match=r"controller.kp: the logs do not determine kp of hip"):
        fitted_gains(FIT, noisy(position_controlled(shell(0.3), DELAY), 1))


def test_a_search_that_has_not_converged_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller_gains, "_MAX_ITERATIONS", 1)
    assert "controller_gains_not_converged" in {notice.code for notice in fitted_gains(FIT, **SHANK).notices}


def test_kd_is_not_told_from_viscous_friction_without_a_velocity_command() -> None:
    for controller, options in ((FIT, {}), ({**FIT, "delay": "auto"}, {"friction": {"viscous": False}})):
        with pytest.raises(ConfigError, match=r"without a moving vcmd, kd of abad, hip, knee cannot be told from"):
            fitted_gains(controller, log_without_velocity_command(), **options)
    gains = fitted_gains(
        {**FIT, "kp": 300.0}, log_without_velocity_command(), friction={"viscous": False, "coulomb": True}
    )
    viscous = [TRUTH.friction[name].viscous for name in JOINTS]
    assert values(gains.kd) == pytest.approx(KD + viscous, rel=0.05)
    assert gains.joints_with_friction_in_kd == JOINTS
    assert "controller_gain_with_friction" in {notice.code for notice in gains.notices}


def test_placeholders_in_the_urdf_are_no_scale() -> None:
    unit = np.array([1.0, 0, 0, 0, 1.0, 0, 1.0, 0, 0, 1.0])
    urdf = robot(1.0)
    urdf = replace(urdf, links={**urdf.links, **dict.fromkeys(CONFIG["bounding_ellipsoids"], unit)})
    with pytest.raises(ConfigError, match=r"are placeholders; set known.total_mass, or give one kp"):
        fitted_gains(FIT, urdf=urdf)


def test_unknown_gains_are_refused_where_nothing_fits_them() -> None:
    unresolved = experiment(FIT)
    assert unresolved.lacks_gains
    with pytest.raises(ConfigError, match=r"controller: needs numbers for kp and kd in place of fit"):
        unresolved.reduce(silent)
    with pytest.raises(ConfigError, match=r"fit depends on all logs together"):
        save_reduction(unresolved, 0.3, silent)
    sensor = {"effect": "joint_elasticity", "joint": "knee", "parameters": {"stiffness": 1e4}}
    with pytest.raises(ConfigError, match=r"effects on the measured torque"):
        fitted_gains(FIT, effects=[sensor])


def test_a_word_that_is_no_gain_is_refused() -> None:
    for kp in ("auto", {"hip": "auto"}):
        with pytest.raises(ConfigError, match=r"controller\.kp(\.hip)?: auto is not a gain; give a number, or fit"):
            parse_config({"controller": {"kp": kp}}, "leg.yaml")
    with pytest.raises(ConfigError, match=r"controller\.kp\.hip: input should be greater than or equal to 0"):
        parse_config({"controller": {"kp": {"hip": -1}}}, "leg.yaml")


def test_the_report_has_the_gains_and_the_model_their_numbers() -> None:
    fitted = fit(experiment(FIT, **SHANK), silent)
    report = fit_report(fitted)
    knee = report.controller_gains["knee"]
    assert knee.kp == pytest.approx(300, rel=0.02)
    assert knee.kd_standard_error is not None
    assert knee.scale == "known_values"
    assert report.controller_gains_text is not None
    assert report.controller_gains_text.startswith("kp: abad 30")
    written = parse_config(model_config(fitted), "model.yaml").controller
    assert written is not None
    assert written.kp_of("knee") == knee.kp
    assert report.friction["knee"].coulomb == pytest.approx(TRUTH.friction["knee"].coulomb, rel=0.03)


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the real logs are not in {REAL}")
def test_gains_of_the_go2_are_those_of_its_controller_relative_to_its_masses() -> None:
    """20, 20 and 40 N·m/rad for hip, thigh and calf, but for a factor by which all masses of its URDF are wrong."""
    config = read_config(CONFIGS / "go2.yaml")
    assert config.controller is not None
    unknown = config.model_copy(update={"controller": config.controller.model_copy(update={"kp": "fit"})})
    logs = [REAL / "go2" / f"chirp_{run}.csv" for run in (4, 5, 6)]
    _, gains = with_gains(prepare(read_robot(REAL / "go2" / "go2.urdf"), unknown, logs), silent)
    assert gains is not None
    true = {"hip": 20.0, "thigh": 20.0, "calf": 40.0}
    assert len(gains.kp) == 12
    for joint, gain in gains.kp.items():
        (expected,) = (value for part, value in true.items() if part in joint)
        assert gain.standard_error is not None
        assert gain.value == pytest.approx(0.88 * expected, rel=0.2)
        assert abs(gain.value - 0.88 * expected) < 3 * gain.standard_error
    assert {"controller_gains_scale", "controller_gains_uncertain"} <= {notice.code for notice in gains.notices}
