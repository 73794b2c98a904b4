"""URDF and logs → a first configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from idtool.config import parse_config
from idtool.exceptions import IdtoolError
from idtool.model import Model, build_model
from idtool.names import some
from idtool.robot import Robot
from idtool.starting import sections, terms
from idtool.starting.bounds import find_bounds
from idtool.starting.draft import Draft
from idtool.starting.gears import gear_ratios, rotor_links
from idtool.starting.recorded import Progress, recorded
from idtool.starting.records import Left, Section, Start
from idtool.starting.text import written
from idtool.starting.trials import Workshop, try_out

_SECTIONS = (
    sections.joints,
    sections.locked_joints,
    sections.gravity,
    sections.log,
    sections.velocity,
    sections.low_pass,
    sections.friction,
    terms.rotors,
    terms.effects,
    terms.bounding_ellipsoids,
    terms.controller,
    terms.known,
)


_MERGED = ("locked_joints", "controller")  # their sections hold what is given


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
    parts = [part for part in (_section(draft, make) for make in _SECTIONS) if part is not None]
    parts += [_given(draft, key, ()) for key in given if key not in {part.key for part in parts}]
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
        warnings=tuple(dict.fromkeys((*draft.recorded.warnings, *(found.warnings if found else ())))),
    )


def _drafted(
    robot: Robot, logs: Sequence[Path], given: Mapping[str, Any], source: Path | None, progress: Progress
) -> Draft:
    """All that the sections are written from."""
    config = parse_config(given, str(source))
    seen = recorded(robot, logs, config, progress)
    names = seen.joints if config.joints is None else config.joints
    progress("reading geometry", 0.0)
    held = {name: lock.position for name, lock in seen.locked.items() if name not in names} | config.locked_joints
    model = build_model(robot, config.model_copy(update={"joints": names, "locked_joints": held}), names)
    plain = Draft(
        robot=robot,
        recorded=seen,
        given=given,
        source=source,
        config=config,
        bounds=find_bounds(robot, model),
        ratios=gear_ratios(robot),
        rotors=rotor_links(robot, names),
    )
    return _tried(plain, model, progress)


def _tried(draft: Draft, model: Model, progress: Progress) -> Draft:
    """The draft with what trials find, or why there are none."""
    if draft.ungained:
        return replace(draft, untried=f"there is no torque without the gains of {some(draft.ungained)}")
    given, commanded = draft.given, draft.recorded.commanded
    makes = (sections.joints, sections.locked_joints, sections.log, sections.low_pass, terms.bounding_ellipsoids)
    parts = [_section(draft, make) for make in (*makes, terms.controller)]
    data = {**given, **{part.key: part.value for part in parts if part is not None and part.value is not None}}
    rotors = [body.ratios for body in model.bodies if body.kind == "rotor"]
    spinning = {name for j, name in enumerate(model.names) if any(ratios[j] for ratios in rotors)}
    without = [] if "effects" in given else [name for name in draft.joints if name not in spinning]
    shop = Workshop(draft.robot, data, draft.recorded.paths, progress)
    late = not commanded and "effects" not in given  # a controller's torque is its own, in time with its command
    try:
        return replace(draft, found=try_out(shop, "friction" not in given, without, late))
    except IdtoolError as error:
        return replace(draft, untried=f"the fit fails: {error}")


def _section(draft: Draft, make: Any) -> Section | None:
    """A section; what is given there takes its place, but for a log's topic and a controller's delay that was found."""
    part: Section | None = make(draft)
    key = part.key if part is not None else "controller"
    if key not in draft.given or (part is not None and (key in _MERGED or part.value == draft.given[key])):
        return part
    if key == "log" and draft.recorded.topic is not None:
        return _given(
            draft, key, ("topic: the one with most of the URDF's joints (logs)",), part.value if part else None
        )
    return _given(draft, key, ())


def _given(draft: Draft, key: str, comments: tuple[str, ...], more: Mapping[str, Any] | None = None) -> Section:
    source = draft.source.name if draft.source else "the configuration"
    value = draft.given[key]
    return Section(key, (f"Given in {source}.", *comments), {**value, **more} if more else value)


def _header(draft: Draft) -> list[str]:
    logs = some([path.name for path in draft.recorded.paths])
    return [
        f"First configuration for {draft.robot.path.name}, by idtool init from {logs}. SI units.",
        "Each key says what it is and, in brackets, where it came from. What is commented out is left to fill in.",
    ]


def _found(draft: Draft) -> list[str]:
    """What was found out, a line each."""
    seen, found = draft.recorded, draft.found
    lines = [f"{len(draft.joints)} joints that move: {some(draft.joints)}"]
    if draft.locked:
        lines.append(f"held still: {some(draft.locked)}")
    if seen.topic is not None:
        lines.append(f"topic {seen.topic}, of {some(seen.topics)}")
    lines.append(f"motion below {seen.motion_hz:.2g} Hz, hence filter.cutoff_hz {seen.cutoff_hz:g}")
    if draft.bounds.found:
        lines.append(f"bounding ellipsoids of {some(draft.bounds.found)}")
    if draft.ratios:
        lines.append(f"gear ratios of {some(draft.ratios)}")
    if found is not None:
        lines += [f"offset of the torque: {some(found.offsets)}"] if found.offsets else []
        lines += (
            [f"rotor inertia: {some([f'{name} {x:.3g}' for name, x in found.inertia.items()])}"]
            if found.inertia
            else []
        )
        lines += [f"delay of the torque: {1e3 * found.delay:.3g} ms"] if found.delay else []
    return lines


def _left(draft: Draft) -> list[Left]:
    """What is left to fill in."""
    left = []
    if draft.ungained:
        left.append(Left("controller", f"kp and kd of {some(draft.ungained)}: no torque was logged", True))
    if draft.untried and not draft.ungained:
        left.append(Left("friction, effects", f"nothing was tried, as {draft.untried}"))
    bounded = dict(draft.bounds.found)
    if draft.bounds.missing and draft.given.get("bounding_ellipsoids", bounded) == bounded:
        left.append(Left("bounding_ellipsoids", f"of {some(draft.bounds.missing)}"))
    if "rotors" not in draft.given:
        left.append(Left("rotors", "mass, inertia and gear ratio, where the joints are geared"))
    return left
