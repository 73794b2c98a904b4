"""URDF and logs → a first configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from idtool.common.exceptions import IdtoolError
from idtool.common.names import join_names, printable
from idtool.common.notice import unique
from idtool.dynamics.effects import JointTerm, effect_types
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import parse_config
from idtool.robot.model import Model, build_model
from idtool.robot.urdf.reading import Robot
from idtool.setup import sections, terms
from idtool.setup.bounds import find_bounds, search_paths
from idtool.setup.draft import Draft
from idtool.setup.gears import gear_ratios, rotor_links
from idtool.setup.recorded import recorded
from idtool.setup.records import Section, Start, TodoItem
from idtool.setup.text import one_line, written
from idtool.setup.trials import Found, TrialRunner, search_of, trial_of, try_out

_SECTIONS: Mapping[str, Callable[[Draft], Section | None]] = {
    "joints": sections.joints,
    "locked_joints": sections.locked_joints,
    "gravity": sections.gravity,
    "log": sections.log,
    "velocity": sections.velocity,
    "filter": sections.low_pass,
    "friction": sections.friction,
    "rotors": terms.rotors,
    "effects": terms.effects,
    "bounding_ellipsoids": terms.bounding_ellipsoids,
    "controller": terms.controller,
    "known": terms.known,
}
_FOR_TRIALS = ("joints", "locked_joints", "log", "filter", "bounding_ellipsoids", "controller")
_MERGED = ("locked_joints", "controller")  # their sections hold what is given, and say so
_BY_TRIAL = ("friction", "effects")  # not tried where they are given


def start(
    robot: Robot, logs: Sequence[Path], given: Mapping[str, Any], source: Path | None, progress: Progress
) -> Start:
    """A first configuration.

    Parameters
    ----------
    robot
        From the URDF.
    logs
        Logs to find out from.
    given, source
        A configuration to start from, whose keys are kept as they are, and its file.
    progress
        Told the stage and how far it has come.

    Raises
    ------
    IdtoolError
        If a log or the configuration cannot be used, or no joint can be identified.
    """
    draft = _drafted(robot, logs, given, source, progress)
    parts = [part for key in _SECTIONS if (part := _section(draft, key)) is not None]
    parts += [_given(draft, key) for key in draft.given if key not in _SECTIONS]
    data = {part.key: part.value for part in parts if part.value is not None}
    parse_config(data, "idtool init")  # what is written can be read
    found = draft.found
    return Start(
        data=data,
        text=written(_header(draft), parts),
        found=tuple(_found(draft)),
        left=tuple(_left(draft)),
        trials=found.trials if found else (),
        rms=found.rms if found else None,
        band_hz=draft.config.filter.cutoff_hz or draft.recorded.cutoff_hz,
        notices=unique([*draft.recorded.notices, *(found.notices if found else ())]),
    )


def _drafted(
    robot: Robot, logs: Sequence[Path], given: Mapping[str, Any], source: Path | None, progress: Progress
) -> Draft:
    """All that the sections are written from."""
    config = parse_config(given, str(source))
    seen = recorded(robot, logs, config, progress)
    progress("reading geometry", 0.0)
    held = {name: lock.position for name, lock in seen.locked.items()} | config.locked_joints
    model = build_model(robot, config.model_copy(update={"joints": seen.joints, "locked_joints": held}), seen.joints)
    plain = Draft(
        robot=robot,
        paths=tuple(logs),
        recorded=seen,
        given={key: value for key, value in given.items() if value is not None},
        source=source,
        config=config,
        bounds=find_bounds(robot, model),
        ratios=gear_ratios(robot),
        rotors=rotor_links(robot, seen.joints),
    )
    return _tried(plain, model, progress)


def _tried(draft: Draft, model: Model, progress: Progress) -> Draft:
    """The draft with what trials find, or why there are none."""
    if draft.ungained:
        return replace(draft, untried=f"there is no torque without the gains of {join_names(draft.ungained)}")
    parts = [_section(draft, key) for key in _FOR_TRIALS]
    data = {**draft.given, **{part.key: part.value for part in parts if part is not None and part.value is not None}}
    shop = TrialRunner(draft.robot, data, draft.recorded.logs, progress)
    on_joints: list[tuple[str, str]] = []
    searched: list[str] = []
    for effect, kind in effect_types().items():
        trial = kind.init_trial
        is_given = ("friction" if kind.friction_key else "effects") in draft.given
        if trial is None or is_given or (trial.needs_measured_torque and draft.recorded.commanded):
            continue
        if issubclass(kind, JointTerm):
            able = [name for name in draft.joints if kind.may_act_on(model, model.names.index(name))]
            on_joints += [(effect, name) for name in able]
        else:
            searched.append(effect)
    try:
        return replace(draft, found=try_out(shop, on_joints, searched))
    except IdtoolError as error:
        return replace(draft, untried=f"the fit fails: {error}")


def _section(draft: Draft, key: str) -> Section | None:
    """A section; what is given there takes its place, but for what logs add to a log's and a controller's entry."""
    part = _SECTIONS[key](draft)
    if key not in draft.given or (part is not None and key in _MERGED):
        return part
    if part is None or key in _BY_TRIAL:
        return _given(draft, key)
    if part.value == draft.given[key]:
        return replace(part, comments=(f"Given in {draft.origin}, and the same as is found here.", *part.comments))
    if key == "log" and draft.recorded.topic is not None:
        topic = "topic: the one with most of the URDF's joints and signals (logs)."
        return replace(_given(draft, key, topic), value={**draft.given[key], **part.value})
    return _given(draft, key)


def _given(draft: Draft, key: str, *comments: str) -> Section:
    return Section(key, (f"Given in {draft.origin}.", *comments), draft.given[key])


def _header(draft: Draft) -> list[str]:
    logs = join_names([path.name for path in draft.paths])
    return [
        f"First configuration for {draft.robot.path.name}, by idtool init from {logs}. SI units.",
        "Each key says what it is and, in brackets, where it came from. What is commented out is left to fill in.",
    ]


def _found(draft: Draft) -> list[str]:
    """What was found out, a line each."""
    seen, found = draft.recorded, draft.found
    count = len(seen.moving)
    lines = [
        f"{count} joints that move: {join_names(seen.moving)}" if count > 1 else f"1 joint that moves: {seen.moving[0]}"
    ]
    if draft.locked:
        lines.append(f"held still: {join_names(draft.locked)}")
    if seen.topic is not None:
        lines.append(f"topic {seen.topic}, of {join_names(seen.topics)}")
    if "filter" not in draft.given:
        lines.append(f"motion below {seen.motion_hz:.2g} Hz, hence filter.cutoff_hz {seen.cutoff_hz:g}")
    if draft.bounds.found:
        lines.append(f"bounding ellipsoids of {join_names(draft.bounds.found)}")
    if geared := [name for name, ratio in draft.ratios.items() if abs(ratio) != 1]:
        lines.append(f"gear ratios of {join_names(geared)}")
    return lines if found is None else [*lines, *_found_effects(found)]


def _found_effects(found: Found) -> Iterator[str]:
    """What trials found, a line each effect: friction first, what concerns the whole robot last."""
    friction: dict[str, list[str]] = {}
    terms: dict[str, list[str]] = {}
    whole: list[str] = []
    for (effect, joint), value in found.values.items():
        kind = effect_types()[effect]
        if joint is None:
            search = search_of(effect)
            whole.append(f"{search.heading}: {search.shown(value)}")
        elif kind.friction_key:
            friction.setdefault(effect, []).append(joint)
        else:
            terms.setdefault(effect, []).append(f"{joint} {value:.3g}")
    for effect, names in (friction | terms).items():
        yield f"{trial_of(effect).heading}: {join_names(names)}"
    yield from whole


def _left(draft: Draft) -> list[TodoItem]:
    """What is left to fill in."""
    left = []
    if draft.ungained:
        left.append(TodoItem("controller", f"kp and kd of {join_names(draft.ungained)}: no torque was logged", True))
    elif draft.untried:
        left.append(TodoItem("friction, effects", f"nothing was tried, as {draft.untried}"))
    if untold := draft.recorded.untold:
        named = join_names([f"tau_{name} (not in {log})" for name, log in untold.items()])
        left.append(TodoItem("log.columns", f"the torque of joints that move, or log their command: {named}"))
    if "bounding_ellipsoids" not in draft.given or draft.given["bounding_ellipsoids"] == draft.bounds.found:
        left += _unbounded(draft)
    if "rotors" not in draft.given:
        left.append(TodoItem("rotors", "mass, inertia and gear ratio, where the joints are geared"))
    if "total_mass" not in draft.given.get("known", {}):
        left.append(TodoItem("known.total_mass", "what moves, on a scale: torque alone seldom tells it"))
    return left


def _unbounded(draft: Draft) -> list[TodoItem]:
    bounds = draft.bounds
    if not bounds.missing:
        return []
    what = f"of {join_names(bounds.missing)}"
    if bounds.unread:
        first = bounds.unread[0]
        which = (
            "their meshes" if len(bounds.unread) == len(bounds.missing) else f"meshes of {join_names(bounds.unread)}"
        )
        what += f"; {which} could not be read ({printable(first)}: {one_line(bounds.missing[first])}); they were "
        what += search_paths(draft.robot)
    return [TodoItem("bounding_ellipsoids", what)]
