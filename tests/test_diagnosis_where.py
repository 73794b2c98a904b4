"""Where a disagreement is found: torques of Pinocchio, to which is added what acts somewhere that is known."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray
from reference import Reference

from idtool.config import EffectEntry, parse_config
from idtool.diagnosis.course import Course, course
from idtool.diagnosis.ground import ground
from idtool.diagnosis.regions import Scene, in_words
from idtool.diagnosis.trial import with_effects
from idtool.diagnosis.where import bursts, located, residual_maps, unexplained
from idtool.experiment import Experiment, prepare
from idtool.robot import read_robot

Array = NDArray[np.float64]
Hidden = Callable[[Array, Array, Array, Array], Array]  # t, q, v, tau to torque; (2, N) but for t

RATE, SECONDS, NOISE = 1000.0, 16.0, 0.01
FLOOR = {"j1": NOISE, "j2": NOISE}
LINK = """<link name="{0}"><inertial><origin xyz="0.02 0.01 -0.2"/><mass value="2"/>
<inertia ixx="0.04" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 0 {3}"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="99" velocity="20"/></joint>"""
URDF = "".join(
    [
        '<robot name="arm"><link name="base"/>',
        *(LINK.format(name) for name in ("upper", "lower")),
        JOINT.format("j1", "base", "upper", 0),
        JOINT.format("j2", "upper", "lower", -0.4),
        "</robot>",
    ]
)


def quiet(stage: str, share: float) -> None:
    """Progress that nobody looks at."""


@cache
def motion() -> tuple[Array, Array, Array, Array]:
    """t (N,), q and v (2, N) of two joints of which the second now and then stands still, and Pinocchio's torque."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    now_and_then = np.clip(0.5 + 1.2 * np.sin(2 * np.pi * t / 5.3), 0, 1)
    moving = now_and_then**3 * (10 - 15 * now_and_then + 6 * now_and_then**2)
    q = np.stack(
        [
            0.8 * np.sin(2.1 * t) + 0.3 * np.sin(4.7 * t + 1) + 0.2 * np.sin(0.37 * t),
            moving * (0.5 * np.sin(7.3 * t) + 0.3 * np.sin(3.1 * t + 2)),
        ]
    )
    v = np.gradient(q, 1 / RATE, axis=1, edge_order=2)
    a = np.gradient(v, 1 / RATE, axis=1, edge_order=2)
    reference = Reference(URDF, ["j1", "j2"], {"gravity": [0, 0, -9.81]})
    tau = np.stack([reference.torque(*state) for state in zip(q.T, v.T, a.T, strict=True)], axis=1)
    return t, q, v, tau


def experiment_of(folder: Path, *hidden: Hidden, rows: Any = slice(None), **config: Any) -> Experiment:
    """A log for each hidden torque, whose model is the arm without it; the last third is held out."""
    t, q, v, tau = motion()
    rng = np.random.default_rng(7)
    (folder / "arm.urdf").write_text(URDF)
    logs = []
    for i, extra in enumerate(hidden):
        total = tau + extra(t, q, v, tau) + NOISE * rng.normal(size=tau.shape)
        columns = np.vstack([t, q, v, total]).T[rows]
        logs.append(folder / f"log{i}.csv")
        head = "t,q_j1,q_j2,v_j1,v_j2,tau_j1,tau_j2"
        np.savetxt(logs[-1], columns, fmt="%.10g", delimiter=",", header=head, comments="")
    told = {"friction": {"viscous": False, "coulomb": False}, **config}
    return prepare(read_robot(folder / "arm.urdf"), parse_config(told, ""), logs, holdout=0.3)


def on(joint: int, torque: Callable[..., Array]) -> Hidden:
    """A torque of t, q, v, tau of a joint, on it alone."""

    def hidden(t: Array, q: Array, v: Array, tau: Array) -> Array:
        found = np.zeros_like(q)
        found[joint] = torque(t, q[joint], v[joint], tau[joint])
        return found

    return hidden


nothing = on(0, lambda t, q, v, tau: 0 * t)


def after_reversals(t: Array, q: Array, v: Array, tau: Array) -> Array:
    """A torque in the first 0.05 rad after each reversal."""
    turns = np.flatnonzero(np.diff(np.sign(v)))
    last = np.searchsorted(turns, np.arange(len(q)), side="right") - 1
    return np.where((last >= 0) & (np.abs(q - q[turns[last]]) < 0.05), np.sign(v), 0.0)


def noisy(bound: Callable[..., NDArray[np.bool_]]) -> Hidden:
    """Disturbances on the first joint, within the band, where the state is in a region."""
    t = motion()[0]
    rough = np.interp(t, t[::20], np.random.default_rng(3).normal(size=len(t[::20])))
    return on(0, lambda t, q, v, tau: rough * bound(t, q, v, tau))


REGIONS: list[tuple[Hidden, str, list[float]]] = [
    (noisy(lambda t, q, v, tau: np.abs(v) < 0.3), "below {} rad/s", [0.3]),
    (noisy(lambda t, q, v, tau: np.abs(v) > 2.0), "above {} rad/s", [2.0]),
    (noisy(lambda t, q, v, tau: q > 0.6), "above {} rad", [0.6]),
    (noisy(lambda t, q, v, tau: np.abs(q - 0.3) < 0.2), "between {} and {} rad", [0.1, 0.5]),
    (noisy(lambda t, q, v, tau: np.abs(q) > 0.7), "below {} or above {} rad", [-0.7, 0.7]),
    (noisy(lambda t, q, v, tau: np.abs(tau) > 10), "at torques above {} N·m", [10.0]),
    (noisy(lambda t, q, v, tau: t < 4), "at the start of the log, up to {} s", [4.0]),
    (noisy(lambda t, q, v, tau: t > 12), "at the end of the log, from {} s", [12.0]),
    (noisy(lambda t, q, v, tau: np.abs(t - 6) < 1), "in a stretch of the log", []),
    (noisy(lambda t, q, v, tau: t > 0), "all along", []),
    (on(0, after_reversals), "in the first {} rad after reversals", [0.05]),
    (on(0, lambda t, q, v, tau: 0.4 * np.sin(2 * np.pi * 6.3 * t)), "at {} Hz", [6.3]),
    (on(0, lambda t, q, v, tau: 0.4 * np.sin(28 * q + 1)), "{} periods per turn", [28.0]),
]


@pytest.mark.parametrize(("hidden", "words", "bounds"), REGIONS, ids=[words for _, words, _ in REGIONS])
def test_the_region_is_said_in_words(tmp_path: Path, hidden: Hidden, words: str, bounds: list[float]) -> None:
    experiment = experiment_of(tmp_path, hidden)
    where = unexplained(experiment, experiment.equation.prior, FLOOR, quiet)
    assert where.joints == ("j1",)
    number = r"(-?[\d.]+)"
    match = re.fullmatch(re.escape(words).replace(r"\{\}", number), where.region)
    assert match, where.region
    np.testing.assert_allclose([float(x) for x in match.groups()], bounds, rtol=0.1)


def test_a_torque_that_comes_with_another_joints_motion(tmp_path: Path) -> None:
    _, q, v, _ = motion()
    moves = np.abs(v[1]) > 0.3
    experiment = experiment_of(tmp_path, noisy(lambda *_: moves))
    region = unexplained(experiment, experiment.equation.prior, FLOOR, quiet).region
    assert re.fullmatch(r"while j2 moves, above 0\.(3|2[89]|3[0-3]) rad/s", region)
    experiment = experiment_of(tmp_path, noisy(lambda *_: moves & (q[0] > 0.4)))
    one, other = sorted(unexplained(experiment, experiment.equation.prior, FLOOR, quiet).region.split(" and "))
    assert re.fullmatch(r"above 0\.(4|3\d|4\d) rad", one)
    assert re.fullmatch(r"while j2 moves, above 0\.(3|2\d|3\d) rad/s", other)


def test_noise_is_nowhere(tmp_path: Path) -> None:
    experiment = experiment_of(tmp_path, nothing)
    where = unexplained(experiment, experiment.equation.prior, FLOOR, quiet)
    assert (where.joints, where.windows, where.region) == ((), (), "")


def test_a_prismatic_joint_has_metres_and_several_joints_have_names() -> None:
    n = 4000
    rng = np.random.default_rng(1)
    q, v, a, tau = rng.normal(size=(4, 2, n))
    kept = np.ones((2, n), dtype=bool)
    found = Course(np.arange(n) * 0.006, np.full(n, 0.006), q, v, a, tau, np.zeros((1, 2, n)), kept, (0,))

    def said(within: NDArray[np.bool_]) -> str:
        energy = rng.normal(size=n) ** 2 * within
        still, none = np.full(2, 1e-3), np.zeros(n)
        return in_words(Scene(found, 0, ("slide", "turn"), (True, False), still, 40.0, energy, none, True, True), ())

    assert re.fullmatch(r"below 0\.(5|49) m/s of slide", said(np.abs(v[0]) < 0.5))
    assert re.fullmatch(r"above 0\.5\d? m of slide", said(q[0] > 0.5))
    assert re.fullmatch(r"at torques above 1(\.\d)? N of slide", said(np.abs(tau[0]) > 1))
    assert re.fullmatch(r"while turn moves, above 1(\.\d)? rad/s", said(np.abs(v[1]) > 1))


WRENCH = [6.0, 0.0, 4.0, 0.0, 1.5, 0.0]


def contact(*windows: tuple[float, float]) -> Hidden:
    """What the joints need while a wrench acts on the second link, by Pinocchio's Jacobian."""
    model = pin.buildModelFromXML(URDF)
    data, frame = model.createData(), model.getFrameId("lower")

    def hidden(t: Array, q: Array, v: Array, tau: Array) -> Array:
        needed = np.zeros_like(q)
        now = np.logical_or.reduce([(t >= first) & (t < last) for first, last in windows])
        for i in np.flatnonzero(now):
            J = pin.computeFrameJacobian(model, data, q[:, i], frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            needed[:, i] = -J.T @ WRENCH
        return needed

    return hidden


WINDOWS = ((2.113, 4.207), (6.551, 7.009), (10.204, 14.498))


def test_contacts_are_found_although_the_model_is_fitted_to_them(tmp_path: Path) -> None:
    """To within 10 ms, in training and held-out parts, with a gap in the log, from a model that they have bent."""
    t = motion()[0]
    experiment = experiment_of(
        tmp_path, contact(*WINDOWS), rows=np.abs(t - 9.0) > 0.3, friction={"viscous": True, "coulomb": True}
    )
    fitted = ground(experiment, quiet).theta
    found = bursts(experiment, fitted, quiet)
    np.testing.assert_allclose(found, WINDOWS, atol=0.01)
    left = unexplained(experiment, fitted, FLOOR, quiet)
    assert left.joints == ("j1", "j2")
    with_it = with_effects(experiment, [entry := wrench(found)], fitted)
    assert entry.parameters["windows"] == [list(window) for window in found]
    where = located(experiment, experiment.equation.prior, with_it, with_it.equation.prior, quiet)
    assert where.joints == ("j1", "j2")
    t = experiment.runs[0].signals.log.t
    told = np.any([(t >= first) & (t <= last) for first, last in where.windows], axis=0)
    truth = np.any([(t >= first) & (t <= last) for first, last in WINDOWS], axis=0)
    near = np.any([(t >= first - 0.1) & (t <= last + 0.1) for first, last in WINDOWS], axis=0)
    assert not told[~near].any()
    assert told[truth].mean() > 0.7
    assert re.fullmatch(r"in \d stretches of the log", where.region)


def wrench(windows: tuple[tuple[float, float], ...]) -> EffectEntry:
    """The contact as a model has it."""
    parameters = {"windows": [list(window) for window in windows], "wrench": WRENCH}
    return EffectEntry(effect="external_contact", link="lower", parameters=parameters)


@pytest.mark.parametrize(
    ("begin", "end", "windows"), [(0.0, 2.5, ((0.0, 2.5),)), (14.0, 16.0, ((14.0, 16.0),)), (0.0, 16.0, ())]
)
def test_a_contact_may_be_there_from_the_start_or_to_the_end(
    tmp_path: Path, begin: float, end: float, windows: tuple[tuple[float, float], ...]
) -> None:
    experiment = experiment_of(tmp_path, contact((begin, end)))
    found = bursts(experiment, experiment.equation.prior, quiet)
    assert len(found) == len(windows)
    np.testing.assert_allclose(np.reshape(found, (-1, 2)), np.reshape(windows, (-1, 2)), atol=0.01)


def ramp(t: Array) -> Array:
    """From 5 to 8 s, come and gone within 0.3 s each."""
    return np.clip(np.minimum(t - 5.0, 8.0 - t) / 0.3, 0.0, 1.0)


NO_CONTACTS: dict[str, Hidden] = {
    "nothing": nothing,
    "friction that rises at low speed": on(0, lambda t, q, v, tau: 2 * np.exp(-np.square(v / 0.3)) * np.tanh(v / 0.01)),
    "friction after reversals": on(0, lambda *state: 2 * after_reversals(*state)),
    "an end stop": on(0, lambda t, q, v, tau: 10 * np.maximum(q - 0.8, 0.0)),
    "ripple": on(0, lambda t, q, v, tau: 0.5 * np.sin(28 * q)),
    "saturation": on(0, lambda t, q, v, tau: -0.5 * np.sign(tau) * np.maximum(np.abs(tau) - 10, 0.0)),
    "what comes and goes slowly": on(0, lambda t, q, v, tau: 2 * ramp(t)),
    "a kick": on(1, lambda t, q, v, tau: 5.0 * (np.abs(t - 6) < 0.05)),
    "shaking": on(1, lambda t, q, v, tau: 2.0 * (np.abs(t - 6) < 1) * np.sin(60 * t)),
}


@pytest.mark.parametrize("hidden", NO_CONTACTS.values(), ids=NO_CONTACTS)
def test_what_is_no_contact(tmp_path: Path, hidden: Hidden) -> None:
    experiment = experiment_of(tmp_path, hidden)
    assert bursts(experiment, experiment.equation.prior, quiet) == ()


def test_with_several_logs_a_contact_has_no_windows(tmp_path: Path) -> None:
    experiment = experiment_of(tmp_path, contact(WINDOWS[0]), nothing)
    assert bursts(experiment, experiment.equation.prior, quiet) == ()


def test_what_a_step_explains_is_located(tmp_path: Path) -> None:
    """Friction of the second joint is known after the step, and a little of the first's; and a step that does harm."""
    friction = {"j1": {"coulomb": True}, "j2": {"coulomb": True}}
    disturbed = noisy(lambda t, q, v, tau: t > 0)
    level = np.array([[0.2], [0.7]])
    hidden = lambda t, q, v, tau: disturbed(t, q, v, tau) + level * np.sign(v)  # noqa: E731
    experiment = experiment_of(tmp_path, hidden, friction=friction)
    keys = [c.key[:2] for c in experiment.equation.coefficients]
    before, after = experiment.equation.prior, experiment.equation.prior.copy()
    for joint, coulomb in zip(("j1", "j2"), level[:, 0], strict=True):
        after[keys.index(("coulomb_friction", joint))] = coulomb
    assert located(experiment, before, experiment, after, quiet).joints == ("j2",)
    assert located(experiment, after, experiment, before, quiet).joints == ()


def test_maps(tmp_path: Path) -> None:
    """Closed forms: a line in time, a line in angle, and a curve over each variable."""
    experiment = experiment_of(
        tmp_path,
        lambda t, q, v, tau: np.stack([0.3 * np.sin(2 * np.pi * 6.5 * t), 0.2 * np.sin(41 * q[1]) + 0.05 * v[1]]),
    )
    maps = residual_maps(experiment, experiment.equation.prior, quiet)
    one, two = maps["j1"], maps["j2"]
    peak = int(np.argmax(one.density))
    assert one.frequency[peak] == 6.5
    assert np.sqrt(np.square(one.density[peak - 4 : peak + 5]).sum() * one.frequency[0]) == pytest.approx(
        0.3 / np.sqrt(2), rel=0.02
    )
    rest = one.density[one.frequency > 9]
    np.testing.assert_allclose(np.median(rest[:80]), NOISE * np.sqrt(2 / RATE), rtol=0.1)  # white, of both sides
    line = int(np.argmax(two.amplitude))
    assert two.angle[line] == pytest.approx(41, abs=0.5)
    assert two.amplitude[line] == pytest.approx(0.2, rel=0.03)
    travel = np.ptp(motion()[1][1])
    assert two.angle[0] == pytest.approx(2 * np.pi / travel, rel=0.05)
    fast = np.abs(two.against["velocity"]) > 0.5
    np.testing.assert_allclose(two.mean["velocity"][fast], 0.05 * two.against["velocity"][fast], atol=0.1)
    slope = np.polyfit(two.against["velocity"], two.mean["velocity"], 1)[0]
    assert slope == pytest.approx(0.05, rel=0.15)
    np.testing.assert_allclose(one.rms["time"], np.hypot(0.3 / np.sqrt(2), NOISE), rtol=0.15)
    assert np.ptp(one.against["time"]) == pytest.approx(SECONDS, rel=0.03)


def test_maps_of_logs_follow_each_other(tmp_path: Path) -> None:
    """Time runs on; velocity's bins are finer near zero; nothing is drawn where nothing was."""
    experiment = experiment_of(tmp_path, nothing, on(0, lambda t, q, v, tau: 0 * t + 1.0))
    one = residual_maps(experiment, experiment.equation.prior, quiet)["j1"]
    time, mean = one.against["time"], one.mean["time"]
    assert (np.diff(time) > 0).all()
    np.testing.assert_allclose(mean[time < SECONDS - 0.3], 0.0, atol=0.01)
    np.testing.assert_allclose(mean[time > SECONDS + 0.3], 1.0, atol=0.01)
    width = np.diff(one.against["velocity"])
    assert width.min() < 0.2 * width.max()
    assert np.abs(one.against["velocity"][np.argmin(width)]) < 0.3


def test_a_log_too_long_to_be_held_is_sampled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = experiment_of(tmp_path, on(0, lambda t, q, v, tau: 0.3 * np.sin(40 * t)))
    models = [(experiment.equation, experiment.equation.prior)]
    whole = course(experiment, models, quiet, "")
    monkeypatch.setattr("idtool.diagnosis.course._MOST", whole.left.size * 3.0)
    part = course(experiment, models, quiet, "")
    assert len(whole.stretches) == 1
    assert 0.3 * len(whole.t) < len(part.t) < 0.7 * len(whole.t)
    assert set(part.t) < set(whole.t)
    long = replace(whole, starts=(0, 100))
    assert long.stretches == (slice(0, 100), slice(100, len(whole.t)))
