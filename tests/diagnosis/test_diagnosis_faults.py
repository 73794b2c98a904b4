"""Faults put into data that MuJoCo made are named, each at its joint and nothing else; physics is not taken for one."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
import yaml
from commands import LEG, SAMPLES, TRAIN
from numpy.typing import NDArray
from paths import CHECKOUT, REAL
from robots import chain, link
from spatial_arm import ARM, JOINTS, recorded, reference, spec_of

from idtool.common.exceptions import LogError
from idtool.data.logs.log import JointLog, make_log
from idtool.diagnosis.data_faults import channel_search, find_data_faults
from idtool.diagnosis.data_faults.channel_fit import ChannelFit
from idtool.diagnosis.data_faults.channel_mistakes import (
    Evidence,
    LogScale,
    Mistake,
    PossibleMistakes,
    Suspects,
    velocity_factor,
)
from idtool.diagnosis.data_faults.channel_search import ChannelSearch
from idtool.diagnosis.data_faults.torque_scale import check_torques
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import parse_config, read_config
from idtool.robot.urdf.reading import parse_robot, read_robot

Array = NDArray[np.float64]
Signals = dict[str, Array]
Change = Callable[[Signals], None]
Named = set[tuple[str, str | None]]

needs_data = pytest.mark.skipif(not REAL.is_dir(), reason=f"the real logs are not in {REAL}")
DEGREES = 180 / np.pi
SECONDS = 6.0
LONG_LOGS = CHECKOUT / "benchmarks" / "long_logs.py"
LEVELS = {"q": 2e-6, "v": 2e-3, "tau": 0.02}  # white noise [rad, rad/s, N·m]


def silent(stage: str, share: float) -> None:
    """No progress."""


def simulated(act: Callable[[Any], None] = lambda data: None, text: str = ARM) -> Signals:
    """The arm with friction, read by good sensors."""
    model = spec_of(text).compile()
    model.dof_damping[:], model.dof_frictionloss[:] = 0.15, 0.2
    log, rng = recorded(model, SECONDS, act, steps=2), np.random.default_rng(3)
    return {"t": log["t"]} | {name: log[name] + LEVELS[name] * rng.normal(size=log[name].shape) for name in LEVELS}


@pytest.fixture(scope="module")
def arm() -> Signals:
    """What is logged of the arm."""
    return simulated()


@pytest.fixture
def of_arm(written: Callable[[str, str], Path]) -> Callable[..., Experiment]:
    """The arm and a log of it, put together."""

    def put(signals: Signals, text: str = ARM, **config: Any) -> Experiment:
        log = make_log(Path("arm.csv"), signals["t"], JOINTS, {k: x for k, x in signals.items() if k != "t"})
        settings = parse_config(config, "arm.yaml")
        return prepare(read_robot(written(text, "arm.urdf")), settings, [TRAIN], transform=lambda _: log)

    return put


def changed(signals: Signals, change: Change) -> Signals:
    """A copy with a fault."""
    copy = {name: x.copy() for name, x in signals.items()}
    change(copy)
    return copy


def sample(robot: str, change: Change = lambda s: None, log: Path = TRAIN) -> Experiment:
    """A sample log with a fault."""

    def seen(log: JointLog) -> JointLog:
        signals = changed({"t": log.t, **log.signals}, change)
        return make_log(log.path, signals.pop("t"), log.joints, signals)

    urdf = SAMPLES / f"{robot}.urdf"
    return prepare(read_robot(urdf), read_config(urdf.with_suffix(".yaml")), [log], transform=seen)


def named(experiment: Experiment) -> Named:
    """Kinds and joints of all faults."""
    return {(fault.code, fault.subject) for fault in find_data_faults(experiment, silent)}


def at(*joints: str) -> list[int]:
    return [JOINTS.index(joint) for joint in joints]


def times(factor: float, names: str, *joints: str) -> Change:
    """Channels, separated by spaces, of joints times a factor."""

    def change(s: Signals) -> None:
        for name in names.split():
            s[name][:, at(*joints)] *= factor

    return change


def exchanged(names: str, one: str, other: str) -> Change:
    def change(s: Signals) -> None:
        for name in names.split():
            s[name][:, at(one, other)] = s[name][:, at(other, one)]

    return change


def held(name: str, joint: str, every: int) -> Change:
    """Sampled and held."""

    def change(s: Signals) -> None:
        s[name][:, at(joint)] = np.repeat(s[name][::every, at(joint)], every, axis=0)[: len(s["t"])]

    return change


def frozen(name: str, joint: str) -> Change:
    def change(s: Signals) -> None:
        s[name][4000:4400, at(joint)] = s[name][4000, at(joint)]

    return change


def cut(name: str, joint: str, share: float) -> Change:
    """Cut off where it is larger than a share of its greatest size."""

    def change(s: Signals) -> None:
        x = s[name][:, at(joint)]
        s[name][:, at(joint)] = np.clip(x, -share * np.abs(x).max(), share * np.abs(x).max())

    return change


def kept(s: Signals, rows: NDArray[Any]) -> None:
    for name in s:
        s[name] = s[name][rows]


def dropped(s: Signals) -> None:
    kept(s, np.random.default_rng(0).random(len(s["t"])) > 0.02)


def gap(s: Signals) -> None:
    kept(s, np.abs(s["t"] - 3) > 0.15)


def late(s: Signals) -> None:
    s["v"][6:, at("lift")] = s["v"][:-6, at("lift")]


def jittering(s: Signals) -> None:
    s["t"] += 6e-4 * np.random.default_rng(0).random(len(s["t"]))


def wrapped(s: Signals) -> None:
    s["q"][:, at("lift")] = np.mod(s["q"][:, at("lift")], 2 * np.pi)


def repeated(s: Signals) -> None:
    rows = np.arange(len(s["t"]))
    for name in LEVELS:
        s[name] = s[name][rows - (rows % 8 == 7)]


def empty(name: str, joint: str) -> Change:
    def change(s: Signals) -> None:
        s[name][:, at(joint)] = 0.0

    return change


def in_ms(s: Signals) -> None:
    s["t"] *= 1000


def together(*changes: Change) -> Change:
    def change(s: Signals) -> None:
        for one in changes:
            one(s)

    return change


def of(fault: str, *joints: str) -> Named:
    return {(fault, joint) for joint in joints}


EVERY: dict[str, tuple[Change, Named]] = {
    "tau turned, middle": (times(-1, "tau", "lift"), of("wrong_sign", "lift")),
    "tau turned, two": (times(-1, "tau", "turn", "roll"), of("wrong_sign", "turn", "roll")),
    "tau turned, all": (times(-1, "tau", *JOINTS), of("wrong_sign", *JOINTS)),
    "q turned": (times(-1, "q", "lift"), of("wrong_sign", "lift")),
    "q and v turned": (times(-1, "q v", "lift"), of("wrong_sign", "lift")),
    "joint turned": (times(-1, "q v tau", "lift"), of("wrong_sign", "lift")),
    "v turned, another in degrees": (
        together(times(-1, "v", "lift"), times(DEGREES, "v", "roll")),
        of("wrong_sign", "lift") | of("wrong_unit", "roll"),
    ),
    "q and v in degrees": (times(DEGREES, "q v", *JOINTS), of("wrong_unit", *JOINTS)),
    "q in degrees": (times(DEGREES, "q", "lift"), of("wrong_unit", "lift")),
    "tau in mN·m": (times(1e3, "tau", *JOINTS), {("wrong_unit", None)}),
    "tau of the motors": (times(0.1, "tau", *JOINTS), {("wrong_unit", None)}),
    "one tau in mN·m": (times(1e3, "tau", "lift"), of("wrong_unit", "lift")),
    "stamps in ms": (in_ms, {("wrong_unit", None)}),
    "tau exchanged": (exchanged("tau", "turn", "lift"), of("wrong_joint_order", "turn", "lift")),
    "v exchanged": (exchanged("v", "turn", "roll"), of("wrong_joint_order", "turn", "roll")),
    "names exchanged": (exchanged("q v tau", "lift", "roll"), of("wrong_joint_order", "lift", "roll")),
    "samples dropped": (dropped, {("dropped_samples", None)}),
    "gap": (gap, {("dropped_samples", None)}),
    "cut off": (together(cut("tau", "lift", 0.7), cut("v", "turn", 0.6)), of("clipped", "lift", "turn")),
    "q cut off": (cut("q", "roll", 0.8), of("clipped", "roll")),
    "held": (together(held("tau", "lift", 4), held("tau", "roll", 40), held("q", "turn", 2)), of("stale", *JOINTS)),
    "frozen": (together(frozen("v", "turn"), frozen("tau", "lift"), frozen("q", "roll")), of("stale", *JOINTS)),
    "not filled": (empty("tau", "roll"), of("stale", "roll")),
    "rows repeated": (repeated, {("stale", None)}),
    "v late": (late, of("velocity_lag", "lift")),
    "stamps that jitter": (jittering, {("time_jitter", None)}),
    "q wrapped": (wrapped, of("wrapped_position", "lift")),
}


@pytest.mark.parametrize("name", EVERY)
def test_a_fault_is_named_and_nothing_else(arm: Signals, of_arm: Callable[..., Experiment], name: str) -> None:
    change, expected = EVERY[name]
    assert named(of_arm(changed(arm, change))) == expected


def as_measured(s: Signals) -> None:
    """Nothing."""


def off(s: Signals) -> None:
    """A torque sensor with a gain, an offset and noise of 1 %."""
    s["tau"] += 0.01 * s["tau"].std(axis=0) * np.random.default_rng(1).normal(size=s["tau"].shape)
    s["tau"][:, at("lift")] = 1.3 * s["tau"][:, at("lift")] + 0.5


def coarse(s: Signals) -> None:
    """Encoders of 14 bits, velocities and torques in steps."""
    for name, step in {"q": 2 * np.pi / 2**14, "v": 0.02, "tau": 0.05}.items():
        s[name] = step * np.round(s[name] / step)


def late_torque(s: Signals) -> None:
    """An effect, not a fault."""
    s["tau"][5:] = s["tau"][:-5]


def no_velocity(s: Signals) -> None:
    del s["v"]


def little_jitter(s: Signals) -> None:
    s["t"] += 1e-5 * np.random.default_rng(0).normal(size=len(s["t"]))


def drifting_clock(s: Signals) -> None:
    s["t"] += 5e-3 * np.sin(s["t"])


@pytest.mark.parametrize(
    "change", [off, coarse, late_torque, no_velocity, little_jitter, drifting_clock], ids=lambda c: c.__name__
)
def test_what_sensors_do_is_no_fault(arm: Signals, of_arm: Callable[..., Experiment], change: Change) -> None:
    assert named(of_arm(changed(arm, change))) == set()


def spring(data: Any) -> None:
    """And a balancer, against which the weight of the arm is small."""
    data.qfrc_applied[1] -= 8.0 * data.qpos[1]


def ripple_and_drag(data: Any) -> None:
    data.qfrc_applied[:] -= 0.5 * np.sin(12 * data.qpos) + 0.05 * data.qvel * np.abs(data.qvel)


def struck(data: Any) -> None:
    data.xfrc_applied[3, :3] = [0, 0, 25.0] if 3 < data.time < 3.5 else [0, 0, 0]


@pytest.mark.parametrize("act", [spring, ripple_and_drag, struck], ids=lambda act: act.__name__)
def test_physics_is_no_fault(of_arm: Callable[..., Experiment], act: Callable[[Any], None]) -> None:
    assert named(of_arm(simulated(act))) == set()


def with_inertials(text: str, factors: Mapping[str, float]) -> str:
    """The URDF with the mass and inertia of links times a factor."""
    for name, factor in factors.items():
        before, start, rest = text.partition(f'<link name="{name}"><inertial>')
        inertial, end, rest = rest.partition("</inertial>")
        parts = inertial.split('"')
        scaled = [f"{factor * float(x):.12g}" if i % 2 and i > 1 else x for i, x in enumerate(parts)]
        text = before + start + '"'.join(scaled) + end + rest
    return text


WRONG = {"turret": 0.4, "upper": 2.0, "fore": 0.5, "tool": 3.0}


@pytest.mark.parametrize("name", ["as it is", "tau turned, middle", "tau exchanged"])
def test_a_wrong_urdf_neither_is_a_fault_nor_hides_one(
    arm: Signals, of_arm: Callable[..., Experiment], name: str
) -> None:
    change, expected = {"as it is": (as_measured, set()), **EVERY}[name]
    assert named(of_arm(changed(arm, change), with_inertials(ARM, WRONG))) == expected


def test_the_wrong_urdf_is_wrong() -> None:
    """The test before would say nothing if the factors went nowhere."""
    masses = [mujoco.MjModel.from_xml_string(text).body_mass.sum() for text in (ARM, with_inertials(ARM, WRONG))]
    assert masses[1] - masses[0] == pytest.approx(-0.6 * 2.0 + 1.0 * 1.4 - 0.5 * 0.9 + 2.0 * 0.3)


def test_placeholders_in_a_urdf_are_no_fault(arm: Signals, of_arm: Callable[..., Experiment]) -> None:
    light = with_inertials(ARM, {"turret": 1e-3, "upper": 1e-3, "fore": 1e-3, "tool": 1e-3})
    assert named(of_arm(arm, light)) == set()


def test_a_joint_at_rest_is_neither_stale_nor_anything_else(of_arm: Callable[..., Experiment]) -> None:
    """Held by a brake: its encoder and velocity do not change at all, its torque does."""

    def braked(data: Any) -> None:
        data.qfrc_applied[2] = -1e4 * data.qpos[2] - 100 * data.qvel[2]

    s = simulated(braked)
    s["q"][:, 2], s["v"][:, 2] = 0.0, 0.0
    assert named(of_arm(s)) == set()


def limited(limit: float) -> Signals:
    """The arm behind drives that give no more than so much, which is what they log [N·m]."""
    model = spec_of().compile()
    model.dof_damping[:], model.dof_frictionloss[:], model.opt.timestep = 0.15, 0.2, 1e-3
    data, rows = mujoco.MjData(model), round(SECONDS * 1000)
    s = {"t": np.arange(rows) * 1e-3, **{name: np.zeros((rows, 3)) for name in LEVELS}}
    for k in range(rows):
        mujoco.mj_forward(model, data)
        wanted = data.qfrc_bias + 60 * (reference(data.time) - data.qpos) - 3 * data.qvel
        tau = np.clip(wanted, -limit, limit)
        s["q"][k], s["v"][k], s["tau"][k] = data.qpos + 0.5e-3 * data.qvel, data.qvel, tau
        data.qfrc_applied[:] = tau
        mujoco.mj_step(model, data)
        s["v"][k] = 0.5 * (s["v"][k] + data.qvel)
    return s


def test_a_torque_at_the_drives_limit_is_not_cut_off(of_arm: Callable[..., Experiment]) -> None:
    """The arm moves as the torque says, so that nothing is missing."""
    s = limited(5.0)
    assert np.mean(np.abs(s["tau"][:, 1]) == 5.0) > 0.02
    assert named(of_arm(s)) == set()


def test_details_say_what_to_do(arm: Signals, of_arm: Callable[..., Experiment]) -> None:
    (fault,) = find_data_faults(of_arm(changed(arm, times(-1, "tau", "lift"))), silent)
    assert "\n" not in fault.message
    assert "`log.scale`" in fault.advice
    (fault,) = find_data_faults(of_arm(changed(arm, late)), silent)
    assert fault.message.endswith("lags the derivative of q by 6.00 ms")
    assert "idtool corrects it" in fault.advice
    assert fault.severity == "note"


def test_a_fault_of_several_logs_is_told_once(of_arm: Callable[..., Experiment]) -> None:
    turned = times(-1, "v", "lift")

    def seen(log: JointLog) -> JointLog:
        signals = changed(dict(log.signals), turned)
        return make_log(log.path, log.t, log.joints, signals)

    config = read_config(LEG.with_suffix(".yaml"))
    both = prepare(read_robot(LEG), config, [TRAIN, TRAIN], transform=seen)
    found = find_data_faults(both, silent)
    assert [(fault.code, fault.subject) for fault in found if fault.severity != "note"] == [("wrong_sign", "hip")]
    assert {fault.subject for fault in found if fault.severity == "note"} == {"abad", "hip", "knee"}
    assert all(fault.message.endswith("(leg_train.mcap and 1 more log)") for fault in found if fault.severity == "note")


def test_the_sample_logs() -> None:
    """Their truth.yaml says that the leg's drives lag by a millisecond; the arm's do not."""
    assert named(sample("leg")) == {("velocity_lag", joint) for joint in ("abad", "hip", "knee")}
    assert named(sample("belt_arm", log=SAMPLES / "belt_arm_train.mcap")) == set()


def test_faults_of_the_sample_leg() -> None:
    """With rotors, bounds and a filter of its own."""

    def turned(s: Signals) -> None:
        s["tau"][:, 0] *= -1

    def swapped(s: Signals) -> None:
        s["tau"][:, [1, 2]] = s["tau"][:, [2, 1]]

    for change, kind, joints in ((turned, "wrong_sign", ["abad"]), (swapped, "wrong_joint_order", ["hip", "knee"])):
        found = named(sample("leg", change))
        assert {(fault, joint) for fault, joint in found if fault != "velocity_lag"} == {(kind, j) for j in joints}


def test_the_fit_is_made_from_a_sample_of_bounded_size(of_arm: Callable[..., Experiment], arm: Signals) -> None:
    """A log ten times as long gives no more rows."""
    t = np.arange(10 * len(arm["t"])) * 1e-3
    longer = {"t": t, **{name: np.concatenate([arm[name], arm[name][::-1]] * 5) for name in ("q", "tau")}}
    rows = [sum(len(motion.t) for motion in ChannelFit(of_arm(s)).motions) for s in (arm, longer)]
    assert rows[1] < 8 * 400
    assert rows[0] > 800


def searched(joints: int, coefficients: int) -> ChannelSearch:
    """A search in a chain of joints, for which all is known that suspicion needs."""
    urdf = chain(*(link(i) for i in range(1, joints + 1)))
    robot = parse_robot(Path("chain.urdf"), urdf.encode())
    fit = SimpleNamespace(equation=SimpleNamespace(coefficients=range(coefficients)), reduced=lambda change: None)
    return ChannelSearch(
        cast("ChannelFit", fit),
        tuple(robot.joints.values()),
        np.zeros((joints, 2)),
        velocity_gains={},
        computed=set(),
        log_scale=AS_LOGGED,
        progress=silent,
    )


AS_LOGGED = LogScale({})
NO_EVIDENCE = Evidence({}, set(), {})


@pytest.mark.parametrize(
    ("joints", "coefficients", "singles", "pairs", "mistakes"),
    [
        (6, 10_000, 6, 15, 64),
        (7, 10_000, 7, 21, 85),
        (8, 10_000, 2, 1, 10),
        (12, 192, 12, 66, 235),
        (20, 300, 20, 21, 124),
        (60, 900, 2, 1, 10),
    ],
)
def test_mistakes_of_many_joints_are_looked_for_in_few(
    joints: int, coefficients: int, singles: int, pairs: int, mistakes: int
) -> None:
    """Of up to seven in all; of more in as many as the coefficients leave time for: those that are explained worst."""
    search = searched(joints, coefficients)
    u = np.random.default_rng(0).permutation(joints) / joints
    suspects = search._suspects(u, np.arange(joints), NO_EVIDENCE)
    assert (len(suspects.singles), len(suspects.pairs)) == (singles, pairs)
    assert set(suspects.singles) == set(np.argsort(-u)[:singles].tolist())
    paired = {j for pair in suspects.pairs for j in pair}
    assert paired == set(np.argsort(-u)[: len(paired)].tolist())
    assert len(PossibleMistakes(search.joints, NO_EVIDENCE, AS_LOGGED).of(suspects)) == mistakes


def test_joints_whose_channels_look_wrong_are_suspected_first() -> None:
    """Impossible ones first, however well they are explained; inverted velocities in turn with others."""
    search = searched(60, 900)
    group = np.arange(60)
    for u in (np.linspace(0, 1, 60), np.full(60, 1e9)):
        evidence = Evidence({3: -1.0}, {5}, {})
        suspects = search._suspects(u, group, evidence)
        assert suspects.singles == (3, 5)
        mistakes = PossibleMistakes(search.joints, evidence, AS_LOGGED).of(suspects)
        of_position = [mistake.joints for mistake in mistakes if mistake.position is not None]
        assert of_position[:3] == [(5,), tuple(range(60)), (3,)]
    u = np.linspace(0, 1, 60)
    assert search._suspects(u, group, Evidence({}, set(), {7: 1e-3})).singles == (7, 59)
    assert search._suspects(u, group, Evidence({3: -1.0, 4: -1.0, 5: 1.0}, set(), {})).singles == (4, 59)


def test_a_mistake_is_found_though_what_is_tried_elsewhere_has_no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """In two joints that share no bodies: with the first one's torque turned, there is no fit."""
    search = searched(2, 20)
    search.fit.groups = (np.array([0]), np.array([1]))
    possible = PossibleMistakes(search.joints, NO_EVIDENCE, AS_LOGGED)
    candidates = [possible.of(Suspects((j,), (j,), ()))[:1] for j in range(2)]

    def unexplained(mistakes: Sequence[Mistake]) -> Array | None:
        return None if 0 in {j for mistake in mistakes for j in mistake.joints} else np.array([1.0, 0.01])

    monkeypatch.setattr(search, "_suspected_mistakes", lambda u: candidates)
    monkeypatch.setattr(search, "_unexplained_without", unexplained)
    ((joints, mistake),) = search._best_mistakes(np.ones(2))
    assert joints.tolist() == [1]
    assert (mistake.kind, mistake.joints) == ("wrong_sign", (1,))


@pytest.mark.parametrize(
    ("gain", "position_factor", "factor"),
    [
        (1.01, 1.0, 1.0),
        (-0.99, 1.0, -1.0),
        (1.01, -1.0, -1.0),
        (-0.99, -1.0, 1.0),
        (57.3, 1.0, 0.01745),
        (-57.3, -1.0, 0.01745),
        (0.0174, np.pi / 180, 1.0),
        (1.01, np.pi / 180, np.pi / 180),
        (-1.01, np.pi / 180, -np.pi / 180),
    ],
)
def test_what_makes_v_the_derivative_of_q(gain: float, position_factor: float, factor: float) -> None:
    assert velocity_factor(gain, position_factor) == factor


def test_advice_counts_in_the_scale_that_is_set() -> None:
    scale = LogScale({"tau": {"hip": 1.27}, "q": 2.0, "v": {}})
    assert scale.advice("hip", {"tau": -1.0}) == "set the `log.scale` of tau to -1.27"
    assert scale.advice("knee", {"tau": -1.0, "v": -1.0}) == "set the `log.scale` of tau and v to -1"
    assert scale.advice("knee", {"tau": -1.0, "v": -1.0, "qcmd": -1.0}).endswith("of tau, v and qcmd to -1")
    of_all = "set the `log.scale` of v to -1 and of q to 0.0349066 for knee and 2 for the other joints"
    assert scale.advice("knee", {"v": -1.0, "q": np.pi / 180}) == of_all


OF_SCALES = {
    name: EVERY[name][0]
    for name in (
        "tau turned, two",
        "q turned",
        "q and v turned",
        "joint turned",
        "v turned, another in degrees",
        "q and v in degrees",
        "q in degrees",
        "one tau in mN·m",
    )
} | {
    "v turned, in degrees": times(-DEGREES, "v", "lift"),
    "q turned, v in degrees": together(times(-1, "q", "lift"), times(DEGREES, "v", "lift")),
    "q and tau turned": times(-1, "q tau", "lift"),
}


@pytest.mark.parametrize("name", OF_SCALES)
def test_who_follows_the_advice_has_no_fault_left(arm: Signals, of_arm: Callable[..., Experiment], name: str) -> None:
    wrong = changed(arm, OF_SCALES[name])
    scales: dict[tuple[str, str], float] = {}
    for fault in find_data_faults(of_arm(wrong), silent):
        for signals, scale in re.findall(r"of ([\w, ]+?) to (-?[\d.]+)", fault.advice):
            for signal in re.split(", | and ", signals):
                scales[signal, str(fault.subject)] = float(scale)
    assert scales
    for (signal, joint), scale in scales.items():
        wrong[signal][:, at(joint)] *= scale
    for signal, level in LEVELS.items():
        np.testing.assert_allclose(wrong[signal], arm[signal], rtol=2e-3, atol=level)
    assert named(of_arm(wrong)) == set()


def advice_for(experiment: Experiment) -> str:
    return " | ".join(fault.advice for fault in find_data_faults(experiment, silent))


def test_of_a_velocity_that_does_not_follow_the_position_no_sign_is_advised(
    arm: Signals, of_arm: Callable[..., Experiment]
) -> None:
    """A joint is turned, and its velocity disturbed: its sign cannot be told."""

    def disturb(s: Signals) -> None:
        s["v"][:, at("lift")] += 0.5 * np.std(s["v"][:, at("lift")]) * np.sin(2 * np.pi * 1.3 * s["t"])[:, None]

    advice = advice_for(of_arm(changed(arm, together(times(-1, "q v tau", "lift"), disturb))))
    assert "of q and tau to -1; then compare v, which may be wrong in the same way, with the derivative of q" in advice


def test_a_velocity_is_not_to_be_scaled_to_positions_that_are_impossible(
    arm: Signals, of_arm: Callable[..., Experiment]
) -> None:
    """The position is in degrees and turned, which the search does not find; the velocity is right."""
    advice = advice_for(of_arm(changed(arm, times(-DEGREES, "q", "lift"))))
    assert "correct q, then run the diagnosis again" in advice
    assert "57.3" not in advice


@pytest.mark.parametrize(
    ("gains", "reverses"), [({}, True), ({0: 1.0}, True), ({0: -1.0}, False), ({0: np.nan}, False)]
)
def test_an_axis_is_to_be_reversed_only_if_all_signals_are(gains: Mapping[int, float], reverses: bool) -> None:
    possible = PossibleMistakes(searched(1, 20).joints, Evidence(gains, set(), {}), AS_LOGGED)
    ((_, advice),) = possible._inverted_joint(0).details
    assert advice.startswith("reverse the axis, or set") == reverses


def test_alternatives_are_told_whole() -> None:
    """With their joints, and not cut short."""
    possible = PossibleMistakes(searched(2, 20).joints, NO_EVIDENCE, AS_LOGGED)
    one, other, both = possible.of(Suspects((0, 1), (0, 1), ((0, 1),)))[:3]
    names = ["hip", "knee"]
    (fault,) = replace(one, others=(other, both)).faults(names, 0.5, 0.01, set())
    wrong = "tau has the opposite sign of the torque that moves the joint"
    assert f"from knee: {wrong}; or hip, knee: {wrong})" in fault.message


def test_a_search_in_few_of_many_joints_finds_the_mistake(
    of_arm: Callable[..., Experiment], arm: Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If three joints were many, with time for two."""
    monkeypatch.setattr(channel_search, "_FULL_SEARCH_JOINTS", 2)
    monkeypatch.setattr(channel_search, "_MAX_FIT_WORK", 0.0)
    for name in ("tau turned, middle", "joint turned", "tau exchanged"):
        change, expected = EVERY[name]
        assert named(of_arm(changed(arm, change))) == expected


@pytest.mark.slow
@pytest.mark.parametrize("change", ["tau of b0_j11", "q v of b0_j14", "tau of b0_j2 b0_j17"])
def test_wrong_signs_are_found_in_a_chain_of_20_joints(tmp_path: Path, change: str) -> None:
    """In a few minutes, not hours."""
    subprocess.run(
        [sys.executable, LONG_LOGS, tmp_path, "--branches", "1", "--length", "20", "--minutes", "0.33"], check=True
    )
    signals, joints = (words.split() for words in change.split(" of "))
    config = yaml.safe_load((tmp_path / "robot.yaml").read_text())
    config["log"] = {"scale": {signal: dict.fromkeys(joints, -1.0) for signal in signals}}
    settings = parse_config(config, "robot.yaml")
    experiment = prepare(read_robot(tmp_path / "robot.urdf"), settings, [tmp_path / "log_0.mcap"])
    assert named(experiment) == of("wrong_sign", *joints)


@needs_data
def test_the_real_logs() -> None:
    """What a roboticist would agree with: the data's README names the stamps of both."""
    config = read_config(CHECKOUT / "configs" / "panda.yaml")
    urdf, log = REAL / "panda" / "panda.urdf", REAL / "panda" / "excitation.mcap"
    found = named(prepare(read_robot(urdf), config, [log]))
    lags = {("velocity_lag", f"panda_joint{k}") for k in range(1, 8)}
    assert found == {("time_jitter", None), ("stale", None), *lags}
    config = read_config(CHECKOUT / "configs" / "go2.yaml").model_copy(update={"rotors": {}})
    logs = [REAL / "go2" / f"chirp_{k}.csv" for k in (4, 5, 6, 7)]
    (fault,) = find_data_faults(prepare(read_robot(REAL / "go2" / "go2.urdf"), config, logs), silent)
    assert (fault.code, fault.subject) == ("time_jitter", None)
    assert "3 more logs" in fault.message


@pytest.mark.parametrize("joint", range(3))
def test_a_torque_in_a_millionth_of_its_unit_ends_the_diagnosis_at_once(joint: int) -> None:
    def scale(signals: Signals) -> None:
        signals["tau"][:, joint] *= 1e6

    name = ("abad", "hip", "knee")[joint]
    with pytest.raises(
        LogError, match=rf"leg_train\.mcap: tau of joint {name} cannot be right: it is 1e\+06 times that of the URDF"
    ):
        diagnose(sample("leg", scale), Options(simulate=False, budget=0.0), silent)


def test_a_torque_is_not_refused_for_another_unit_a_spike_or_friction_alone() -> None:
    def scale(signals: Signals) -> None:
        signals["tau"][:, 1] *= 1e3

    def spike(signals: Signals) -> None:
        signals["tau"][5000, 1] = 1e9

    def rest(signals: Signals) -> None:
        signals["tau"][:, [0, 2]] *= 1e-6  # two joints whose motors are off

    for change in (scale, spike, rest):
        check_torques(sample("leg", change))


@needs_data
def test_no_torque_of_real_robots_is_refused() -> None:
    """Friction is many times the rigid torque of the last joints."""
    panda, go2 = REAL / "panda", REAL / "go2"
    config = read_config(CHECKOUT / "configs" / "panda.yaml")
    check_torques(prepare(read_robot(panda / "panda.urdf"), config, [panda / "excitation.mcap"]))
    config = read_config(CHECKOUT / "configs" / "go2.yaml").model_copy(update={"rotors": {}})
    check_torques(prepare(read_robot(go2 / "go2.urdf"), config, [go2 / f"chirp_{k}.csv" for k in (4, 5)]))
