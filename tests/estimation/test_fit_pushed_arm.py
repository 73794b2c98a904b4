"""An arm in MuJoCo on a fixed base that is pushed at its hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from prescribed_motions import silent
from sensor_arm import COULOMB, JOINTS, LINKS, SENSOR, Push, urdf_text, wrench_channels, write_log

import idtool
from idtool.api.data import load_experiment
from idtool.common.exceptions import ConfigError, LogError
from idtool.estimation.fit import fit
from idtool.estimation.identification import estimate_from_logs
from idtool.estimation.row_correlation import with_row_correlation
from idtool.estimation.row_noise import with_row_noise

SIDEWAYS = (9.81 * 0.6, 0.0, -9.81 * 0.8)  # gravity of an arm that is mounted on a slope
SECONDS = 10.0
HAND = LINKS[-1]
TRUE_MASS = {link.name: link.mass for link in LINKS}
PUSH = Push(np.array([12.0, -8.0, 15.0, 0.5, 0.8, -0.6]), np.array([0.2, 0.01, 0.03]))
FORCE = Push(np.array([12.0, -8.0, 15.0, 0.0, 0.0, 0.0]), PUSH.point)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm")
    no_offset = np.zeros(6)
    write_log(path / "free.csv", 8.0, no_offset, seed=5, gravity=SIDEWAYS)
    write_log(path / "pushed.csv", SECONDS, no_offset, push=PUSH, gravity=SIDEWAYS)
    write_log(path / "touched.csv", SECONDS, no_offset, push=FORCE, gravity=SIDEWAYS)
    lighter = urdf_text()
    for mass in TRUE_MASS.values():
        lighter = lighter.replace(f'mass value="{mass}"', f'mass value="{0.8 * mass:g}"')
    (path / "prior.urdf").write_text(lighter)
    (path / "arm.urdf").write_text(urdf_text())
    return path


def measured(axes: str, **changes: Any) -> dict[str, Any]:
    """The push, measured along the axes of the ``hand``, or of the ``world``: those of the base."""
    frame = "link" if axes == "hand" else "world"
    channels = wrench_channels("hand" if axes == "hand" else "base")
    wrench = {"force": channels[:3], "moment": channels[3:]}
    return {
        "name": "tool",
        "link": "hand",
        "kind": "surface",
        "frame": frame,
        "point": [*PUSH.point],
        **wrench,
        **changes,
    }


UNKNOWN = {"name": "tool", "link": "hand", "point": [*PUSH.point], "flag": "contact_tool", "widen": 0.01}


def model_of(folder: Path, *contacts: Mapping[str, Any], urdf: str = "prior.urdf", **config: Any) -> idtool.Model:
    ellipsoids = {link.name: [{"center": [0.1, 0, 0.05], "semi_axes": [0.3, 0.2, 0.2]}] for link in LINKS}
    settings = {"gravity": SIDEWAYS, "contacts": list(contacts), "bounding_ellipsoids": ellipsoids, **config}
    return idtool.Model(folder / urdf, config=settings)


def fit_and_test(model: idtool.Model, log: Path, folder: Path) -> tuple[idtool.FitResult, float]:
    """The fit to a log, and the torque error of its model in a log without a push [N m]."""
    result = idtool.fit(model, log, quick=True)
    result.save(folder)
    settings = idtool.Model(folder / "identified.urdf", config=folder / "model.yaml").settings
    without_contacts = {**settings.model_dump(exclude_unset=True), "contacts": []}
    free = idtool.Model(folder / "identified.urdf", config=without_contacts)
    validation = idtool.validate(free, log.parent / "free.csv", simulation=False)
    return result, validation.rms.model["overall"]


@pytest.fixture(scope="module")
def error_by_free_motion(folder: Path) -> float:
    """Torque error of a model that was fitted to a log without a push, in this log [N m]."""
    _, error = fit_and_test(model_of(folder), folder / "free.csv", folder / "free")
    return error


@pytest.mark.parametrize(
    ("log", "contact"), [("pushed", measured("hand")), ("pushed", measured("world")), ("touched", UNKNOWN)]
)
def test_model_is_as_good_as_without_a_push(
    folder: Path, tmp_path: Path, error_by_free_motion: float, log: str, contact: dict[str, Any]
) -> None:
    result, error = fit_and_test(model_of(folder, contact), folder / f"{log}.csv", tmp_path)
    assert error < 1.25 * error_by_free_motion
    for name in JOINTS:
        assert result.friction[name].coulomb == pytest.approx(COULOMB, abs=0.006)
    hand = result.bodies["hand"]
    assert hand.mass * hand.com[0] == pytest.approx(TRUE_MASS["hand"] * HAND.com[0], rel=0.02)


@pytest.mark.parametrize("log", ["pushed", "touched"])
def test_push_that_is_not_in_the_configuration_spoils_the_model(
    folder: Path, tmp_path: Path, error_by_free_motion: float, log: str
) -> None:
    result, error = fit_and_test(model_of(folder), folder / f"{log}.csv", tmp_path)
    assert error > 30 * error_by_free_motion
    assert result.friction["lift"].coulomb < 0.5 * COULOMB


def test_estimate_is_made_from_decorrelated_rows_and_errors_are_those_of_rows(folder: Path) -> None:
    experiment = load_experiment(model_of(folder, UNKNOWN), [folder / "touched.csv"])
    with_noise = with_row_noise(experiment, silent)
    decorrelated = with_row_correlation(with_noise, silent)
    expected = estimate_from_logs(decorrelated, "ls", silent).estimate.theta
    of_independent_rows = estimate_from_logs(with_noise, "ls", silent).estimate.theta
    assert np.abs(of_independent_rows - expected).max() > 1e-5

    result = fit(experiment, silent)
    np.testing.assert_allclose(result.estimate.theta, expected, atol=1e-8)
    contacts = result.experiment.equation.contacts
    assert contacts is not None
    assert contacts.correlation is None


def test_rows_of_which_the_sample_tells_nothing_keep_their_noise(folder: Path) -> None:
    """As those of a joint that rests in it."""
    experiment = load_experiment(model_of(folder, UNKNOWN), [folder / "touched.csv"])
    (run,) = experiment.runs
    too_short = replace(experiment, runs=(replace(run, train=(slice(0, 20),)),))
    determined = with_row_noise(too_short, silent)
    assert determined.equation.contacts is not None
    assert experiment.equation.contacts is not None
    np.testing.assert_array_equal(determined.equation.contacts.noise, experiment.equation.contacts.noise)
    assert with_row_correlation(determined, silent) is determined


def test_wrist_sensor_and_a_measured_push_tell_what_the_sensor_carries(folder: Path) -> None:
    model = model_of(folder, measured("hand"), wrench_sensors=[{"joint": SENSOR}])
    result = idtool.fit(model, folder / "pushed.csv", quick=True)
    carried = result.bodies["upper"].mass + result.bodies["hand"].mass
    assert carried == pytest.approx(TRUE_MASS["upper"] + TRUE_MASS["hand"], rel=0.015)


@pytest.mark.parametrize("flag", ["contact_tool", None])
def test_wrist_sensor_beside_an_unknown_force_tells_what_it_carries(folder: Path, flag: str | None) -> None:
    """Three unknown components in nine rows.

    A force that may act all the time can carry any weight, but leaves the moment of this weight about its point. In the
    frame of the hand, that of the upper half changes as if its mass were at the axis of the hand.
    """
    model = model_of(folder, {**UNKNOWN, "flag": flag}, wrench_sensors=[{"joint": SENSOR, "offset": "none"}])
    result = idtool.fit(model, folder / "touched.csv", quick=True)
    upper, hand = result.bodies["upper"], result.bodies["hand"]
    true_carried = TRUE_MASS["upper"] + TRUE_MASS["hand"]
    if flag is not None:
        assert upper.mass + hand.mass == pytest.approx(true_carried, rel=0.015)
    moment = hand.mass * hand.com[0] - (upper.mass + hand.mass) * PUSH.point[0]
    true_moment = HAND.mass * HAND.com[0] - true_carried * PUSH.point[0]
    assert moment == pytest.approx(true_moment, rel=0.015)
    for name in JOINTS:
        assert result.friction[name].coulomb == pytest.approx(COULOMB, abs=0.006)


def test_simulation_is_only_of_the_time_without_a_push(folder: Path) -> None:
    friction = {name: {"viscous": 0.0, "coulomb": COULOMB} for name in JOINTS}
    result = idtool.validate(model_of(folder, UNKNOWN, urdf="arm.urdf", friction=friction), folder / "touched.csv")
    assert "contacts_not_simulated" in [notice.code for notice in result.notices]
    simulation = result.simulation
    assert simulation is not None
    assert simulation.seconds == pytest.approx((1 - PUSH.share) * SECONDS, rel=0.05)
    assert simulation.position["overall"] < 0.1 * simulation.baseline.position["overall"]


@pytest.mark.parametrize(
    ("log", "contact"), [("pushed", measured("world")), pytest.param("touched", UNKNOWN, marks=pytest.mark.slow)]
)
def test_diagnosis_names_friction_beside_a_push(folder: Path, log: str, contact: dict[str, Any]) -> None:
    """Coulomb friction of one joint that the model lacks, and no other effect."""
    friction = {name: {"viscous": True, "coulomb": name != "lift"} for name in JOINTS}
    model = model_of(folder, contact, urdf="arm.urdf", friction=friction)
    diagnosis = idtool.diagnose(model, folder / f"{log}.csv", inertia="fixed")
    (step,) = diagnosis.steps
    assert (step.effect, step.joint) == ("coulomb_friction", "lift")
    assert step.parameters["coulomb"] == pytest.approx(COULOMB, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"flag": "auto"}, "flag: auto: is for a floating base; name the channel of a flag"),
        ({"link": "base"}, "link: base: is moved by no joint"),
        ({"link": "hnad"}, "did you mean hand"),
    ],
)
def test_contact_that_cannot_be_used_is_refused(folder: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        idtool.fit(model_of(folder, {**UNKNOWN, **changes}), folder / "touched.csv", quick=True)


def test_ball_needs_to_know_where_up_is(folder: Path) -> None:
    model = model_of(folder, {**UNKNOWN, "radius": 0.02}, gravity=(0, 0, 0))
    with pytest.raises(ConfigError, match=r"radius: 0\.02: has no lowest point without gravity"):
        idtool.fit(model, folder / "touched.csv", quick=True)


def test_missing_channel_is_named(folder: Path) -> None:
    model = model_of(folder, measured("world", force=["force_base_x", "force_base_y", "force_base_q"]))
    with pytest.raises(LogError, match="has no channel force_base_q; did you mean force_base_z"):
        idtool.fit(model, folder / "pushed.csv", quick=True)


def test_contact_that_leaves_nothing_of_the_torque_is_refused(folder: Path) -> None:
    model = model_of(folder, {**UNKNOWN, "kind": "surface", "flag": None})
    with pytest.raises(LogError, match="unknown contact forces can explain all torques"):
        idtool.fit(model, folder / "touched.csv", quick=True)


@pytest.mark.parametrize(
    ("command", "call"),
    [
        ("diagnose --against", lambda model, log: idtool.diagnose(model, log, against=log.parent / "free.csv")),
        ("excite with logs", lambda model, log: idtool.excite(model, logs=log)),
    ],
)
def test_commands_that_need_joints_alone_say_so(folder: Path, command: str, call: Callable[..., Any]) -> None:
    with pytest.raises(ConfigError, match=f"contacts: are not for idtool {command}; remove them"):
        call(model_of(folder, UNKNOWN), folder / "touched.csv")
