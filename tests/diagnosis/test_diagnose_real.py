"""A payload on a real arm: its log, and the torque that Pinocchio gives the payload along it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import fitted, idtool
from numpy.typing import NDArray
from paths import CONFIGS, REAL
from scipy.signal import butter, sosfiltfilt

from idtool.data.logs import read_log, write_log
from idtool.data.logs.log import make_log

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"the real logs are not in {REAL}")

PANDA = REAL / "panda" / "panda.urdf"
MASS = 2.8  # kg
CENTER = np.array([0.01, -0.02, 0.11])  # m, in the hand's frame
INERTIA = np.diag([0.012, 0.010, 0.008])  # kg·m², about the centre


def payload_torque(t: NDArray[np.float64], q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Torque of all joints, shape (N, 7), along a motion that is smoothed below 20 Hz."""
    rate = 1000.0
    times = np.arange(t[0], t[-1], 1 / rate)
    low_pass = butter(4, 20 / (rate / 2), output="sos")

    def smooth(x: NDArray[np.float64]) -> NDArray[np.float64]:
        resampled = np.stack([np.interp(times, t, column) for column in x.T], axis=1)
        return np.asarray(sosfiltfilt(low_pass, resampled, axis=0))

    positions, velocities = smooth(q), smooth(v)
    accelerations = np.gradient(velocities, 1 / rate, axis=0)
    whole = pin.buildModelFromUrdf(str(PANDA))
    fingers = [whole.getJointId(name) for name in whole.names if "finger" in name]
    arm = pin.buildReducedModel(whole, fingers, pin.neutral(whole))
    loaded = arm.copy()
    hand = arm.frames[arm.getFrameId("panda_hand")]
    loaded.appendBodyToJoint(hand.parentJoint, pin.Inertia(MASS, CENTER, INERTIA), hand.placement)
    arm_data, loaded_data = arm.createData(), loaded.createData()
    added = []
    for states in zip(positions, velocities, accelerations, strict=True):
        added.append(pin.rnea(loaded, loaded_data, *states) - pin.rnea(arm, arm_data, *states))
    return np.stack([np.interp(t, times, column) for column in np.stack(added).T], axis=1)


def test_a_payload_is_weighed_on_the_link_that_carries_it(tmp_path: Path) -> None:
    """With the model of the log's first half, in its second half; all links are candidates."""
    log = read_log(REAL / "panda" / "excitation.mcap")
    half = len(log.t) // 2
    for name, rows, payload in (("empty", slice(half), False), ("loaded", slice(half, None), True)):
        own = {signal: x[rows] for signal, x in log.signals.items()}
        t = log.t[rows]
        if payload:
            own["tau"] = own["tau"] + payload_torque(t, own["q"], own["v"])
        file = tmp_path / f"{name}.csv"
        write_log(file, make_log(file, t, log.joints, own))
    fitted(tmp_path / "model", PANDA, tmp_path / "empty.csv", "--config", CONFIGS / "panda.yaml")
    model = ("--config", tmp_path / "model" / "model.yaml", "--inertia", "fixed", "--effects", "payload")
    urdf = tmp_path / "model" / "identified.urdf"
    result = idtool("diagnose", urdf, tmp_path / "loaded.csv", *model, "--no-simulation", "--out", tmp_path / "out")
    assert result.code == 0, result.err
    report = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    (step,) = [step for step in report["steps"] if step["effect"] != "unknown"]
    assert step["link"] == "panda_link7"
    assert step["parameters"]["mass"] == pytest.approx(MASS, abs=0.03)
    height = 0.107 + CENTER[2]  # the hand is mounted 107 mm above the frame of link 7, turned by an eighth
    x, y = (CENTER[0] + CENTER[1]) / np.sqrt(2), (CENTER[1] - CENTER[0]) / np.sqrt(2)
    assert step["parameters"]["com"] == pytest.approx([x, y, height], abs=0.003)
    assert step["validation_rms_after"]["overall"] < 0.03 * step["validation_rms_before"]["overall"]
