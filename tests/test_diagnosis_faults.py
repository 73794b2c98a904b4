"""Faults put into data that MuJoCo made are named, each at its joint and nothing else; physics is not taken for one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
from commands import LEG, SAMPLES, TRAIN
from numpy.typing import NDArray
from spatial_arm import ARM, JOINTS, recorded, spec_of

from idtool.config import parse_config, read_config
from idtool.diagnosis.fault_fit import FaultFit
from idtool.diagnosis.faults import Fault, faults
from idtool.experiment import Experiment, prepare
from idtool.logs.log import Log, make_log
from idtool.robot import read_robot

Array = NDArray[np.float64]
Signals = dict[str, Array]
Change = Callable[[Signals], None]
Named = set[tuple[str, str | None]]

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the real logs are not in {DATA}")
DEGREES = 180 / np.pi
SECONDS = 8.0
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
        return prepare(read_robot(written(text, "arm.urdf")), settings, [TRAIN], seen_as=lambda _: log)

    return put


def changed(signals: Signals, change: Change) -> Signals:
    """A copy with a fault."""
    copy = {name: x.copy() for name, x in signals.items()}
    change(copy)
    return copy


def sample(robot: str, change: Change = lambda s: None, log: Path = TRAIN) -> Experiment:
    """A sample log with a fault."""

    def seen(log: Log) -> Log:
        signals = changed({"t": log.t, **log.signals}, change)
        return make_log(log.path, signals.pop("t"), log.joints, signals)

    urdf = SAMPLES / f"{robot}.urdf"
    return prepare(read_robot(urdf), read_config(urdf.with_suffix(".yaml")), [log], seen_as=seen)


def named(experiment: Experiment) -> Named:
    """Kinds and joints of all faults."""
    return {(fault.fault, fault.joint) for fault in faults(experiment, silent)}


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


EVERY: dict[str, tuple[Change, Named]] = {
    "tau turned, base": (times(-1, "tau", "turn"), {("wrong_sign", "turn")}),
    "tau turned, middle": (times(-1, "tau", "lift"), {("wrong_sign", "lift")}),
    "tau turned, end": (times(-1, "tau", "roll"), {("wrong_sign", "roll")}),
    "tau turned, two": (times(-1, "tau", "turn", "roll"), {("wrong_sign", "turn"), ("wrong_sign", "roll")}),
    "tau turned, all": (times(-1, "tau", *JOINTS), {("wrong_sign", joint) for joint in JOINTS}),
    "v turned": (times(-1, "v", "lift"), {("wrong_sign", "lift")}),
    "q turned": (times(-1, "q", "lift"), {("wrong_sign", "lift")}),
    "q and v turned": (times(-1, "q v", "lift"), {("wrong_sign", "lift")}),
    "joint turned": (times(-1, "q v tau", "lift"), {("wrong_sign", "lift")}),
    "q and v in degrees": (times(DEGREES, "q v", *JOINTS), {("wrong_unit", joint) for joint in JOINTS}),
    "q in degrees": (times(DEGREES, "q", "lift"), {("wrong_unit", "lift")}),
    "v in degrees": (times(DEGREES, "v", "lift"), {("wrong_unit", "lift")}),
    "tau in mN·m": (times(1e3, "tau", *JOINTS), {("wrong_unit", None)}),
    "tau of the motors": (times(0.1, "tau", *JOINTS), {("wrong_unit", None)}),
    "one tau in mN·m": (times(1e3, "tau", "lift"), {("wrong_unit", "lift")}),
    "stamps in ms": (in_ms, {("wrong_unit", None)}),
    "tau exchanged": (exchanged("tau", "turn", "lift"), {("wrong_joint_order", j) for j in ("turn", "lift")}),
    "tau exchanged, far": (exchanged("tau", "turn", "roll"), {("wrong_joint_order", j) for j in ("turn", "roll")}),
    "v exchanged": (exchanged("v", "turn", "roll"), {("wrong_joint_order", j) for j in ("turn", "roll")}),
    "names exchanged": (exchanged("q v tau", "lift", "roll"), {("wrong_joint_order", j) for j in ("lift", "roll")}),
    "samples dropped": (dropped, {("dropped_samples", None)}),
    "gap": (gap, {("dropped_samples", None)}),
    "tau cut off": (cut("tau", "lift", 0.7), {("clipped", "lift")}),
    "v cut off": (cut("v", "lift", 0.6), {("clipped", "lift")}),
    "tau held": (held("tau", "lift", 4), {("stale", "lift")}),
    "tau held long": (held("tau", "roll", 40), {("stale", "roll")}),
    "q held": (held("q", "turn", 2), {("stale", "turn")}),
    "v frozen": (frozen("v", "turn"), {("stale", "turn")}),
    "tau frozen": (frozen("tau", "lift"), {("stale", "lift")}),
    "q frozen": (frozen("q", "roll"), {("stale", "roll")}),
    "tau not filled": (empty("tau", "roll"), {("stale", "roll")}),
    "rows repeated": (repeated, {("stale", None)}),
    "v late": (late, {("velocity_lag", "lift")}),
    "stamps that jitter": (jittering, {("time_jitter", None)}),
    "q wrapped": (wrapped, {("wrapped_position", "lift")}),
}


@pytest.mark.parametrize("name", EVERY)
def test_a_fault_is_named_and_nothing_else(arm: Signals, of_arm: Callable[..., Experiment], name: str) -> None:
    change, expected = EVERY[name]
    assert named(of_arm(changed(arm, change))) == expected
