"""Motion, torque and residuals of a robot as a recording for rerun's viewer, on one timeline.

The robot stands there twice, as measured and as simulated, the links' bounding ellipsoids with it. Curves are those of
the pages: the least and greatest value in each of some thousand stretches of time, so that no spike is lost.

Shapes: nv joints, n points. Units: s, rad or m, N·m or N.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.estimation.evaluation.envelope import Trace
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.urdf.reading import Robot

_TIMELINE = "log"  # the timeline's name
_FRAME_PREFIXES = {"measured": "", "simulated": "simulated/"}  # the robots, and what is put before their frames' names
_COLORS = {"measured": (150, 150, 150), "model": (217, 95, 2), "simulated": (217, 95, 2), "residual": (27, 120, 55)}
_ELLIPSOID = (31, 119, 180, 60)


@dataclass(frozen=True)
class LogRecording:
    """What is shown of one log.

    Attributes
    ----------
    name
        The log's.
    seconds
        How long it is, from its first sample on.
    start
        Time of its first sample [s].
    curves
        What a curve is, ``torque/measured`` or ``position/simulated``, to its times, shape (n,), and values, (nv, n).
    """

    name: str
    seconds: float
    start: float
    curves: Mapping[str, tuple[Array, Array]]


def log_recording(name: str, parts: Sequence[tuple[Trace, Mapping[str, str]]]) -> LogRecording:
    """A log by traces, each with what its curves are called there and what they are.

    Parameters
    ----------
    name
        The log's.
    parts
        A trace and its curves: name in the trace to what it is; one that the trace has not is left out.
    """
    start = min(float(trace.t[0]) for trace, _ in parts)
    end = max(float(trace.t[-1]) for trace, _ in parts)
    curves = {
        what: (trace.t, trace.curves[own])
        for trace, names in parts
        for own, what in names.items()
        if own in trace.curves
    }
    return LogRecording(name, end - start, start, curves)


def rerun_recording(
    robot: Robot, joints: Sequence[str], ellipsoids: Mapping[str, Sequence[Ellipsoid]], takes: Sequence[LogRecording]
) -> bytes:
    """The content of an .rrd file; logs follow one another.

    Parameters
    ----------
    robot
        Its URDF is shown, with the meshes that can be found.
    joints
        Names of the nv joints.
    ellipsoids
        By link.
    takes
        The logs.

    Raises
    ------
    ConfigError
        If rerun is not installed.
    """
    rr = rerun_package()
    recording = rr.RecordingStream("idtool", recording_id=robot.path.stem)
    stream = recording.binary_stream()
    whats = list(dict.fromkeys(what for one in takes for what in one.curves))
    poses = [pose for pose in _FRAME_PREFIXES if f"position/{pose}" in whats]
    trees = {pose: tree for pose in poses if (tree := _add_robot(rr, recording, robot, pose)) is not None}
    root = next((tree.root_link().name for tree in trees.values()), "")
    recording.send_blueprint(_blueprint(rr, root, joints, whats))
    _add_styles(rr, recording, joints, whats)
    for link, own in ellipsoids.items():
        _add_ellipsoids(rr, recording, link, own)
    first = 0.0
    for one in takes:
        recording.set_time(_TIMELINE, duration=first)
        recording.log("logs", rr.TextLog(one.name))
        for what, (t, x) in one.curves.items():
            for j, joint in enumerate(joints):
                times, values = _finite_points(t - one.start + first, x[j])
                if len(times):
                    path = rr.new_entity_path([what.split("/")[0], joint, what.split("/")[1]])
                    index = rr.TimeColumn(_TIMELINE, duration=times)
                    recording.send_columns(path, indexes=[index], columns=rr.Scalars.columns(scalars=values))
        for pose, tree in trees.items():
            _add_motion(rr, recording, tree, pose, joints, one, first)
        first += one.seconds
    return bytes(stream.read())


def rerun_package() -> ModuleType:
    """The rerun package, which is an extra.

    Raises
    ------
    ConfigError
        If it is not installed.
    """
    try:
        import rerun
        import rerun.blueprint
        import rerun.urdf
    except ImportError:
        raise ConfigError("--rerun", "needs rerun, which is not installed; pip install 'idtool[rerun]'") from None
    module: ModuleType = rerun
    return module


def _blueprint(rr: Any, root: str, joints: Sequence[str], whats: Sequence[str]) -> Any:
    """The robot on the left, the curves of one joint on a page on the right."""
    kinds = list(dict.fromkeys(what.split("/")[0] for what in whats))
    pages = [
        rr.blueprint.Vertical(
            *(rr.blueprint.TimeSeriesView(origin=rr.new_entity_path([kind, joint]), name=kind) for kind in kinds),
            name=joint,
        )
        for joint in joints
    ]
    where = rr.blueprint.SpatialInformation(target_frame=root)
    space = rr.blueprint.Spatial3DView(origin="/", name="robot", spatial_information=where)
    return rr.blueprint.Blueprint(rr.blueprint.Horizontal(space, rr.blueprint.Tabs(*pages)))


def _add_styles(rr: Any, recording: Any, joints: Sequence[str], whats: Sequence[str]) -> None:
    """Colours and names of the curves."""
    for what in whats:
        kind, name = what.split("/")
        line = rr.SeriesLines(colors=_COLORS.get(name, _COLORS["measured"]), names=name)
        for joint in joints:
            recording.log([kind, joint, name], line, static=True)


def _add_robot(rr: Any, recording: Any, robot: Robot, pose: str) -> Any:
    """The URDF in one of its poses; None where the viewer's reader cannot take it."""
    with tempfile.TemporaryDirectory() as folder:
        path = robot.path
        if not path.is_file():  # the description came with a log
            path = Path(folder, "robot.urdf")
            path.write_bytes(robot.text)
        try:
            tree = rr.urdf.UrdfTree.from_file_path(
                path, pose, frame_prefix=_FRAME_PREFIXES[pose] or None, static_transform_entity_path=f"{pose}/fixed"
            )
            tree.log_urdf_to_recording(recording)
            root, other = tree.root_link().name, f"{_FRAME_PREFIXES[pose]}{tree.root_link().name}"
            if other != root:  # both stand in one place
                recording.log(f"{pose}/base", rr.Transform3D(parent_frame=root, child_frame=other), static=True)
        except Exception as error:  # whatever a library for another purpose makes of it, the curves are there
            recording.log("logs", rr.TextLog(f"the URDF is not shown: {error}"), static=True)
            return None
    return tree


def _add_ellipsoids(rr: Any, recording: Any, link: str, own: Sequence[Ellipsoid]) -> None:
    """A link's bounding ellipsoids, moving with it as measured."""
    shown = rr.Ellipsoids3D(
        centers=[one.center for one in own],
        half_sizes=[one.semi_axes for one in own],
        quaternions=[Rotation.from_matrix(one.rotation).as_quat() for one in own],
        colors=[_ELLIPSOID] * len(own),
        fill_mode="solid",
    )
    recording.log(["ellipsoids", link], rr.CoordinateFrame(frame=link), shown, static=True)


def _add_motion(
    rr: Any, recording: Any, tree: Any, pose: str, joints: Sequence[str], one: LogRecording, first: float
) -> None:
    """The joints' motion, one pose per stretch of time."""
    if f"position/{pose}" not in one.curves:
        return
    t, q = one.curves[f"position/{pose}"]
    for joint, x in zip(joints, q, strict=True):
        times, values = _finite_points(*_midpoints(t - one.start + first, x))
        found = tree.get_joint_by_name(joint)
        if found is not None and len(values):
            columns = found.compute_transform_columns(values.tolist(), clamp=False)
            path = rr.new_entity_path([pose, "joints", joint])
            recording.send_columns(path, indexes=[rr.TimeColumn(_TIMELINE, duration=times)], columns=columns)


def _midpoints(t: Array, x: Array) -> tuple[Array, Array]:
    """The middle between least and greatest of each stretch, of pairs of points."""
    return t.reshape(-1, 2).mean(axis=1), x.reshape(-1, 2).mean(axis=1)


def _finite_points(t: Array, x: Array) -> tuple[Array, Array]:
    known = np.isfinite(x)
    return t[known], x[known]
