"""Motion, torque and residuals of a robot as a recording for rerun's viewer, on one timeline.

The robot stands there twice, as measured and as simulated, the links' bounding ellipsoids with it. Curves are those of
the pages: the least and greatest value in each of some thousand stretches of time, so that no spike is lost.

Shapes: nv joints, n points. Units: s, rad or m, N·m or N.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.estimation.dataset.envelope import Trace
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.urdf.reading import Robot

_TIMELINE = "log"  # the timeline's name
_FRAME_PREFIXES = {"measured": "", "simulated": "simulated/"}  # the robots, and what is put before their frames' names
_COLORS = {"measured": (150, 150, 150), "model": (217, 95, 2), "simulated": (217, 95, 2), "residual": (27, 120, 55)}
_ELLIPSOID = (31, 119, 180, 60)


@dataclass(frozen=True)
class LogRecording:
    """Curves of one log.

    Attributes
    ----------
    name
        The log's.
    seconds
        Duration from its first sample [s].
    start
        Time of its first sample [s].
    curves
        Entity path, such as ``torque/measured`` or ``position/simulated``, to times, shape (n,), and values, (nv, n).
    """

    name: str
    seconds: float
    start: float
    curves: Mapping[str, tuple[Array, Array]]


def log_recording(name: str, parts: Sequence[tuple[Trace, Mapping[str, str]]]) -> LogRecording:
    """The recording of a log from traces.

    Parameters
    ----------
    name
        The log's.
    parts
        Traces, each with the names of its curves to their entity paths; missing curves are left out.
    """
    start = min(float(trace.t[0]) for trace, _ in parts)
    end = max(float(trace.t[-1]) for trace, _ in parts)
    curves = {}
    for trace, paths in parts:
        for curve, path in paths.items():
            if curve in trace.curves:
                curves[path] = (trace.t, trace.curves[curve])
    return LogRecording(name, end - start, start, curves)


def rerun_recording(
    robot: Robot, joints: Sequence[str], ellipsoids: Mapping[str, Sequence[Ellipsoid]], logs: Sequence[LogRecording]
) -> bytes:
    """The content of an .rrd file; logs follow one another.

    Parameters
    ----------
    robot
        The robot; its URDF is shown, with the meshes that can be found.
    joints
        Names of the nv joints.
    ellipsoids
        Bounding ellipsoids by link.
    logs
        The logs.

    Raises
    ------
    ConfigError
        If rerun is not installed.
    """
    rr = rerun_package()
    recording = rr.RecordingStream("idtool", recording_id=robot.path.stem)
    stream = recording.binary_stream()
    paths = list(dict.fromkeys(path for log in logs for path in log.curves))
    trees = {}
    for pose in _FRAME_PREFIXES:
        if f"position/{pose}" in paths:
            tree = _add_robot(rr, recording, robot, pose)
            if tree is not None:
                trees[pose] = tree
    root = next((tree.root_link().name for tree in trees.values()), "")
    recording.send_blueprint(_blueprint(rr, root, joints, paths))
    _add_styles(rr, recording, joints, paths)
    for link, link_ellipsoids in ellipsoids.items():
        _add_ellipsoids(rr, recording, link, link_ellipsoids)
    start = 0.0
    for log in logs:
        recording.set_time(_TIMELINE, duration=start)
        recording.log("logs", rr.TextLog(log.name))
        _add_curves(rr, recording, joints, log, start)
        for pose, tree in trees.items():
            _add_motion(rr, recording, tree, pose, joints, log, start)
        start += log.seconds
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
        raise ConfigError("--rerun", "needs rerun, which is not installed; run pip install 'idtool[rerun]'") from None
    module: ModuleType = rerun
    return module


def _blueprint(rr: Any, root: str, joints: Sequence[str], paths: Sequence[str]) -> Any:
    """The robot on the left, the curves of one joint on a page on the right."""
    kinds = list(dict.fromkeys(path.split("/")[0] for path in paths))
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


def _add_styles(rr: Any, recording: Any, joints: Sequence[str], paths: Sequence[str]) -> None:
    """Colours and names of the curves."""
    for path in paths:
        kind, name = path.split("/")
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


def _add_ellipsoids(rr: Any, recording: Any, link: str, ellipsoids: Sequence[Ellipsoid]) -> None:
    """A link's bounding ellipsoids, moving with it as measured."""
    shown = rr.Ellipsoids3D(
        centers=[ellipsoid.center for ellipsoid in ellipsoids],
        half_sizes=[ellipsoid.semi_axes for ellipsoid in ellipsoids],
        quaternions=[Rotation.from_matrix(ellipsoid.rotation).as_quat() for ellipsoid in ellipsoids],
        colors=[_ELLIPSOID] * len(ellipsoids),
        fill_mode="solid",
    )
    recording.log(["ellipsoids", link], rr.CoordinateFrame(frame=link), shown, static=True)


def _add_curves(rr: Any, recording: Any, joints: Sequence[str], log: LogRecording, start: float) -> None:
    """The curves of a log, which begins at ``start`` [s] on the timeline."""
    for path, (t, x) in log.curves.items():
        kind, name = path.split("/")
        for j, joint in enumerate(joints):
            times, values = _finite_points(t - log.start + start, x[j])
            if len(times):
                entity = rr.new_entity_path([kind, joint, name])
                index = rr.TimeColumn(_TIMELINE, duration=times)
                recording.send_columns(entity, indexes=[index], columns=rr.Scalars.columns(scalars=values))


def _add_motion(
    rr: Any, recording: Any, tree: Any, pose: str, joints: Sequence[str], log: LogRecording, start: float
) -> None:
    """The joints' motion, one posture per stretch of time."""
    if f"position/{pose}" not in log.curves:
        return
    t, q = log.curves[f"position/{pose}"]
    for name, x in zip(joints, q, strict=True):
        times, values = _finite_points(*_midpoints(t - log.start + start, x))
        joint = tree.get_joint_by_name(name)
        if joint is not None and len(values):
            columns = joint.compute_transform_columns(values.tolist(), clamp=False)
            path = rr.new_entity_path([pose, "joints", name])
            recording.send_columns(path, indexes=[rr.TimeColumn(_TIMELINE, duration=times)], columns=columns)


def _midpoints(t: Array, x: Array) -> tuple[Array, Array]:
    """The middle between least and greatest value of each stretch, from pairs of points."""
    return t.reshape(-1, 2).mean(axis=1), x.reshape(-1, 2).mean(axis=1)


def _finite_points(t: Array, x: Array) -> tuple[Array, Array]:
    known = np.isfinite(x)
    return t[known], x[known]
