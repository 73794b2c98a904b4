"""What a recording for rerun's viewer holds, read back by rerun."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import LEG, VALIDATE_CSV, idtool
from numpy.typing import NDArray

from idtool.estimation.dataset.envelope import Trace
from idtool.reporting.rerun_recording import LogRecording, log_recording, rerun_recording
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.urdf.reading import read_robot

pytest.importorskip("rerun", reason="rerun is an extra: `make test-rerun` installs it")

Array = NDArray[np.float64]

JOINTS = ("abad", "hip", "knee")
TORQUE = {"measured": "torque/measured", "identified": "torque/model"}
MOTION = {"measured": "position/measured", "identified": "position/simulated"}


def trace(name: str, start: float) -> Trace:
    """Curves of three joints with one spike."""
    t = start + 0.01 * np.arange(400)
    x = np.sin(np.outer([1.0, 1.3, 1.7], t))
    x[1, 77] = 9.0
    return Trace(name, t, {"measured": x, "identified": 0.9 * x})


def written(folder: Path, takes: list[LogRecording]) -> dict[str, Any]:
    """By entity, all of a recording's columns."""
    import rerun.chunk

    ellipsoids = {"thigh_link": [Ellipsoid((0, 0, -0.17), (0.06, 0.06, 0.37), (0.1, 0.2, 0.3))]}
    file = folder / "leg.rrd"
    file.write_bytes(rerun_recording(read_robot(LEG), JOINTS, ellipsoids, takes))
    found: dict[str, Any] = {}
    for chunk in rerun.chunk.RrdReader(str(file)).stream():
        batch = chunk.to_record_batch()
        columns = found.setdefault(chunk.entity_path, {})
        for name in batch.schema.names:
            seconds = name in ("log", "log_time")
            columns.setdefault(name, []).extend(1e-9 * x.value if seconds else x.as_py() for x in batch.column(name))
    return found


def test_curves_are_there_and_no_spike_is_lost(tmp_path: Path) -> None:
    one = trace("a.mcap", 5.0)
    found = written(tmp_path, [log_recording("a.mcap", [(one, TORQUE), (one, MOTION)])])
    for kind in ("torque/{}/measured", "torque/{}/model", "position/{}/measured", "position/{}/simulated"):
        assert {kind.format(joint) for joint in JOINTS} <= {path.strip("/") for path in found}
    hip = found["/torque/hip/measured"]
    shown = [
        (t, x[0]) for t, x in zip(hip["log"], hip["Scalars:scalars"], strict=True) if x and isinstance(x[0], float)
    ]
    times, values = np.array(sorted(shown)).T
    np.testing.assert_allclose(times, one.t - 5.0, atol=1e-8)
    np.testing.assert_allclose(values, one.curves["measured"][1])
    assert values.max() == 9.0


def test_links_stand_where_pinocchio_has_them(tmp_path: Path) -> None:
    """Each joint's transform at all times, of the measured and of the simulated robot."""
    one = trace("a.mcap", 0.0)
    found = written(tmp_path, [log_recording("a.mcap", [(one, MOTION)])])
    model = pin.buildModelFromUrdf(str(LEG))
    data = model.createData()
    for pose, name in (("measured", "measured"), ("simulated", "identified")):
        q = one.curves[name].reshape(3, -1, 2).mean(axis=2)
        for n in (0, 50, 199):
            pin.forwardKinematics(model, data, q[:, n])
            for j, joint in enumerate(JOINTS):
                columns, placed = found[f"/{pose}/joints/{joint}"], data.liMi[1 + j]
                np.testing.assert_allclose(columns["Transform3D:translation"][n][0], placed.translation, atol=1e-6)
                turned = pin.Quaternion(np.array(columns["Transform3D:quaternion"][n][0], dtype=float)).matrix()
                np.testing.assert_allclose(turned, placed.rotation, atol=1e-6)


def test_logs_follow_one_another(tmp_path: Path) -> None:
    takes = [
        log_recording(name, [(trace(name, start), MOTION)]) for name, start in (("a.mcap", 5.0), ("b.mcap", 100.0))
    ]
    found = written(tmp_path, takes)
    times = np.sort(found["/position/knee/measured"]["log"])
    assert len(times) == 800
    np.testing.assert_allclose(times[[0, 399, 400, 799]], [0, 3.99, 3.99, 7.98], atol=1e-8)
    assert [text for row in found["/logs"]["TextLog:text"] for text in row] == ["a.mcap", "b.mcap"]


def test_ellipsoids_move_with_their_links(tmp_path: Path) -> None:
    one = trace("a.mcap", 0.0)
    bound = written(tmp_path, [log_recording("a.mcap", [(one, MOTION)])])["/ellipsoids/thigh_link"]
    assert bound["CoordinateFrame:frame"] == [["thigh_link"]]
    np.testing.assert_allclose(bound["Ellipsoids3D:half_sizes"][0][0], (0.06, 0.06, 0.37), atol=1e-6)


@pytest.mark.parametrize("command", ["fit", "validate", "simulate", "diagnose"])
def test_every_command_that_runs_a_model_writes_one(command: str, tmp_path: Path) -> None:
    """With the robot moving as measured, and as simulated where it was run forwards."""
    import rerun.chunk

    options = {"diagnose": ["--no-simulation", "--report-only"], "simulate": ["--out", "s.mcap"]}.get(command, [])
    done = idtool(command, LEG, VALIDATE_CSV, *options, "--rerun", "leg.rrd", "--quiet", folder=tmp_path)
    assert done.code == 0, done.err
    paths = {chunk.entity_path for chunk in rerun.chunk.RrdReader(str(tmp_path / "leg.rrd")).stream()}
    assert {f"/measured/joints/{joint}" for joint in JOINTS} <= paths
    assert ("/simulated/joints/hip" in paths) == (command != "diagnose")
    assert ("/torque/hip/residual" in paths) == (command != "simulate")
