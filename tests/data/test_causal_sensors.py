"""No look ahead with the sensors of a base, of contacts and of wrenches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.logs import Recording, config_text, write_csv
from ground.quadruped import JOINTS as QUADRUPED_JOINTS
from ground.robot import urdf_text
from numpy.typing import NDArray
from quadruped_recordings import TRUTH, record_quadruped
from sensor_arm import COULOMB, JOINTS, SENSOR, Push, wrench_channels, write_log
from sensor_arm import urdf_text as arm_urdf

import idtool
from idtool.api.data import load_experiment
from idtool.common.safe_yaml import parse_yaml
from idtool.data.causal import causal_batches
from idtool.data.logs.log import Channel
from idtool.estimation.dataset.experiment import Experiment

Array = NDArray[np.float64]

PUSH = Push(np.array([12.0, -8.0, 15.0, 0.5, 0.8, -0.6]), np.array([0.2, 0.01, 0.03]))
WIDEN = 0.12  # s, by default
ORDER = 4


@pytest.fixture(scope="module")
def standing() -> Recording:
    return record_quadruped("stand", 4.0)


def quadruped(folder: Path, recording: Recording, forces: str) -> Experiment:
    """The quadruped while it stands, its forces ``unknown`` or ``measured``."""
    write_csv(folder / "stand.csv", recording)
    (folder / "quadruped.urdf").write_text(urdf_text(TRUTH))
    config = dict(parse_yaml(Path("quadruped.yaml"), config_text(TRUTH, forces).encode()))
    friction = {}
    for joint, viscous, coulomb in zip(QUADRUPED_JOINTS, TRUTH.viscous, TRUTH.coulomb, strict=True):
        friction[joint] = {"viscous": float(viscous), "coulomb": float(coulomb)}
    config["friction"] = friction
    base = {**config["base"], "imu": {**config["base"]["imu"], "delay": 0.002}}
    return load_experiment(
        idtool.Model(folder / "quadruped.urdf", config={**config, "base": base}), folder / "stand.csv", holdout=0.0
    )


def arm(folder: Path) -> Experiment:
    """An arm with a wrench sensor that is pushed by a measured wrench."""
    write_log(folder / "pushed.csv", 6.0, np.zeros(6), push=PUSH)
    (folder / "arm.urdf").write_text(arm_urdf())
    channels = wrench_channels("hand")
    tool = {"name": "tool", "link": "hand", "kind": "surface", "frame": "link", "point": [*PUSH.point]}
    tool |= {"force": channels[:3], "moment": channels[3:]}
    friction = {name: {"viscous": 0.0, "coulomb": COULOMB} for name in JOINTS}
    config = {"contacts": [tool], "wrench_sensors": [{"joint": SENSOR}], "friction": friction}
    return load_experiment(idtool.Model(folder / "arm.urdf", config=config), folder / "pushed.csv", holdout=0.0)


def seen(experiment: Experiment) -> tuple[Array, Array]:
    """Times, and all filtered rows, with the shares of them that count."""
    signals = experiment.runs[0].signals
    times, rows = [], []
    for batch in causal_batches(signals, ORDER):
        blocks, shares = experiment.equation.counted_rows(batch)
        times.append(batch.t + signals.log.start)
        rows.append(np.concatenate([*blocks, np.stack(shares).astype(float)]))
    return np.concatenate(times), np.concatenate(rows, axis=1)


def change_after(experiment: Experiment, t: float, rng: np.random.Generator) -> None:
    """Change all that a log says from a time on; what was calibrated before stays."""
    signals = experiment.runs[0].signals
    log = signals.log
    for x in log.signals.values():
        late = log.t >= t
        x[late] += rng.normal(size=x[late].shape)
    changed = {}
    for name, channel in log.channels.items():
        late = channel.t >= t
        other = 1 - channel.x if name.startswith("contact_") else channel.x + rng.normal(size=len(channel.x))
        changed[name] = Channel(channel.t, np.where(late, other, channel.x))
    if signals.base_sensors is not None:
        signals.base_sensors._channels = changed
    if signals.wrench_channels is not None:
        channels = [[changed[name] for name in wrench_channels(SENSOR)]]
        signals.wrench_channels = replace(signals.wrench_channels, channels=channels)
    if signals.contact_channels is not None:
        signals.contact_channels = replace(signals.contact_channels, channels=changed)


@pytest.mark.parametrize("kind", ["unknown", "measured", "arm"])
def test_the_future_does_not_change_the_past(
    kind: str, standing: Recording, tmp_path: Path, rng: np.random.Generator
) -> None:
    experiment = arm(tmp_path) if kind == "arm" else quadruped(tmp_path, standing, kind)
    log = experiment.runs[0].signals.log
    t, before = seen(experiment)
    cut = float(log.t[len(log) // 2])
    change_after(experiment, cut, rng)
    again, after = seen(experiment)
    np.testing.assert_array_equal(t, again)
    past = t < cut
    assert past.sum() > 50
    np.testing.assert_array_equal(before[:, past], after[:, past])
    future = t > cut + WIDEN + 0.03
    assert future.sum() > 50
    assert (before[:, future] != after[:, future]).any(axis=0).all()


@pytest.mark.parametrize("kind", ["unknown", "arm"])
def test_true_parameters_leave_as_little_as_without_delay(kind: str, standing: Recording, tmp_path: Path) -> None:
    """All signals, flags and orientation included, are late by the same time."""
    experiment = arm(tmp_path) if kind == "arm" else quadruped(tmp_path, standing, kind)
    signals, equation = experiment.runs[0].signals, experiment.equation
    errors = []
    for batches in (signals.batches(), causal_batches(signals, ORDER)):
        squares, samples = np.zeros(len(equation.joints)), 0
        for batch in batches:
            blocks, _ = equation.counted_rows(batch)
            for j, (block, active) in enumerate(zip(blocks, equation.active(), strict=True)):
                squares[j] += np.square(block[-1] - equation.prior[active] @ block[:-1]).sum()
            samples += len(batch.t)
        errors.append(np.sqrt(squares / samples))
    zero_phase, causal = errors
    np.testing.assert_allclose(causal, zero_phase, rtol=0.15, atol=1e-3 * zero_phase.max())
