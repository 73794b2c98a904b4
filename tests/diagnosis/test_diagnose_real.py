"""Payloads on real robots: their logs, and the torque that Pinocchio gives the payload along them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import fitted, installed
from numpy.typing import NDArray
from paths import CONFIGS, REAL
from scipy.signal import butter, sosfiltfilt

from idtool.data.logs import read_log, write_log
from idtool.data.logs.log import make_log

Array = NDArray[np.float64]

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"the real logs are not in {REAL}")

PANDA = REAL / "panda" / "panda.urdf"
GO2 = REAL / "go2" / "go2.urdf"
GO2_LOGS = [REAL / "go2" / f"chirp_{run}.csv" for run in (4, 5)]
LATE = 0.0106  # s, from the Go2's command to its torque


def payload_torque(
    model: pin.Model, link: str, payload: pin.Inertia, t: Array, q: Array, v: Array, cutoff: float
) -> Array:
    """Torque of all joints for a payload in a link's frame, shape (N, nv), along a motion that is smoothed.

    Parameters
    ----------
    model
        The robot.
    link, payload
        The link, and the payload in its frame.
    t, q, v
        Times [s], and the motion in the order of the model's joints, shape (N, nv).
    cutoff
        Of the low-pass that smooths it [Hz].
    """
    rate = 1000.0
    times = np.arange(t[0], t[-1], 1 / rate)
    low_pass = butter(4, cutoff / (rate / 2), output="sos")

    def smooth(x: Array) -> Array:
        resampled = np.stack([np.interp(times, t, column) for column in x.T], axis=1)
        return np.asarray(sosfiltfilt(low_pass, resampled, axis=0))

    positions, velocities = smooth(q), smooth(v)
    accelerations = np.gradient(velocities, 1 / rate, axis=0)
    loaded = model.copy()
    frame = model.frames[model.getFrameId(link)]
    loaded.appendBodyToJoint(frame.parentJoint, payload, frame.placement)
    data, loaded_data = model.createData(), loaded.createData()
    added = []
    for states in zip(positions, velocities, accelerations, strict=True):
        added.append(pin.rnea(loaded, loaded_data, *states) - pin.rnea(model, data, *states))
    return np.stack([np.interp(t, times, column) for column in np.stack(added).T], axis=1)


def payload_found(folder: Path, log: Path) -> dict[str, Any]:
    """The only effect that a diagnosis of a log names, all links being candidates; the model is in a folder."""
    model = ("--config", folder / "model.yaml", "--inertia", "fixed", "--effects", "payload")
    command = ("diagnose", folder / "identified.urdf", log, *model, "--no-simulation", "--out", folder / "out")
    result = installed(*command, folder=folder)
    assert result.code == 0, result.err
    report = json.loads((folder / "out" / "diagnosis.json").read_text())
    (step,) = [step for step in report["steps"] if step["effect"] != "unknown"]
    return dict(step)


@pytest.mark.slow
def test_a_payload_is_weighed_on_the_link_that_carries_it(tmp_path: Path) -> None:
    """On the hand of an arm: with the model of the log's first half, in its second half."""
    whole = pin.buildModelFromUrdf(str(PANDA))
    fingers = [whole.getJointId(name) for name in whole.names if "finger" in name]
    arm = pin.buildReducedModel(whole, fingers, pin.neutral(whole))
    mass, center = 2.8, np.array([0.01, -0.02, 0.11])
    payload = pin.Inertia(mass, center, np.diag([0.012, 0.010, 0.008]))

    log = read_log(REAL / "panda" / "excitation.mcap")
    half = len(log.t) // 2
    empty = {name: x[:half] for name, x in log.signals.items()}
    loaded = {name: x[half:] for name, x in log.signals.items()}
    added = payload_torque(arm, "panda_hand", payload, log.t[half:], loaded["q"], loaded["v"], cutoff=20)
    loaded["tau"] = loaded["tau"] + added
    write_log(tmp_path / "empty.csv", make_log(tmp_path / "empty.csv", log.t[:half], log.joints, empty))
    write_log(tmp_path / "loaded.csv", make_log(tmp_path / "loaded.csv", log.t[half:], log.joints, loaded))

    fitted(tmp_path / "model", PANDA, tmp_path / "empty.csv", "--config", CONFIGS / "panda.yaml")
    step = payload_found(tmp_path / "model", tmp_path / "loaded.csv")
    assert step["link"] == "panda_link7"
    assert step["parameters"]["mass"] == pytest.approx(mass, abs=0.03)
    height = 0.107 + center[2]  # the hand is mounted 107 mm above the frame of link 7, turned by an eighth
    x, y = (center[0] + center[1]) / np.sqrt(2), (center[1] - center[0]) / np.sqrt(2)
    assert step["parameters"]["com"] == pytest.approx([x, y, height], abs=0.003)
    assert step["validation_rms_after"]["overall"] < 0.03 * step["validation_rms_before"]["overall"]


@pytest.mark.slow
def test_a_payload_is_weighed_on_the_leg_that_carries_it(tmp_path: Path) -> None:
    """On a calf of a quadruped whose torque is its controller's: with the model of other logs.

    Many joints: the check of the data, in a copy of the process, once waited forever for threads of the solver.
    """
    quadruped = pin.buildModelFromUrdf(str(GO2))
    mass, center = 0.4, np.array([0.0, 0.02, -0.12])
    payload = pin.Inertia(mass, center, np.diag([4e-4, 4e-4, 4e-4]))

    log = read_log(REAL / "go2" / "chirp_6.csv")
    order = [log.joints.index(name) for name in list(quadruped.names)[1:]]
    signals = {name: np.array(x) for name, x in log.signals.items()}
    q, v = signals["q"][:, order], signals["v"][:, order]
    added = payload_torque(quadruped, "RL_calf", payload, log.t, q, v, cutoff=10)
    for column, joint in enumerate(order):
        gain = 40 if "calf" in log.joints[joint] else 20
        later = np.interp(log.t + LATE, log.t, added[:, column])
        signals["qcmd"][:, joint] += later / gain
    write_log(tmp_path / "loaded.csv", make_log(tmp_path / "loaded.csv", log.t, log.joints, signals))

    fitted(tmp_path / "model", GO2, *GO2_LOGS, "--config", CONFIGS / "go2.yaml")
    step = payload_found(tmp_path / "model", tmp_path / "loaded.csv")
    assert step["link"] == "RL_calf"
    assert step["parameters"]["mass"] == pytest.approx(mass, abs=0.03)
    assert step["parameters"]["com"] == pytest.approx(center, abs=0.01)
