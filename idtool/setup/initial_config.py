"""URDF and logs → a first configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from idtool.common.exceptions import IdtoolError
from idtool.common.names import join_names, printable
from idtool.common.notice import unique
from idtool.common.number_text import short_number
from idtool.dynamics.effects import JointTerm, effect_types
from idtool.estimation.dataset.experiment import Progress, prepare
from idtool.estimation.dataset.wrench_sensor_sign import sensor_signs
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot
from idtool.setup import model_sections, sections
from idtool.setup.base_sections import base_sections
from idtool.setup.bounds import find_bounds, search_paths
from idtool.setup.draft import Draft
from idtool.setup.held_base import held_logs
from idtool.setup.log_summary import summarize_logs
from idtool.setup.records import ConfigSection, InitialConfig, TodoItem
from idtool.setup.rolling_radius import rolling_radius
from idtool.setup.transmissions import gear_ratios, rotor_links
from idtool.setup.trials import TrialResults, TrialRunner, TrialTerms, run_trials, search_of, trial_of
from idtool.setup.yaml_text import configuration_text, one_line

_SECTIONS: Mapping[str, Callable[[Draft], ConfigSection | None]] = {
    "joints": sections.joints,
    "locked_joints": sections.locked_joints,
    "gravity": sections.gravity,
    "base": lambda draft: draft.base.sections.get("base"),
    "contacts": lambda draft: draft.base.sections.get("contacts"),
    "wrench_sensors": lambda draft: draft.base.sections.get("wrench_sensors"),
    "log": sections.log,
    "velocity": sections.velocity,
    "filter": sections.low_pass,
    "friction": sections.friction,
    "rotors": model_sections.rotors,
    "armature": model_sections.armature,
    "effects": model_sections.effects,
    "bounding_ellipsoids": model_sections.bounding_ellipsoids,
    "controller": model_sections.controller,
    "known": model_sections.known,
}
_BASE = ("base", "contacts", "wrench_sensors")
_SECTIONS_FOR_TRIALS = ("joints", "locked_joints", *_BASE, "log", "filter", "bounding_ellipsoids", "controller")
_ANY_RADIUS = 0.02  # m, so that the orientation of the base, which a ball needs, is read
_MIN_FRAME_RATIO = 1.5  # of the torque error along the wrong axes to that along the right ones
_MERGED = ("locked_joints", "controller")  # their sections include the given values
_BY_TRIAL = ("friction", "effects")  # no trials if they are given


def make_initial_config(
    robot: Robot, logs: Sequence[Path], given: Mapping[str, Any], source: Path | None, progress: Progress
) -> InitialConfig:
    """Make a first configuration.

    Parameters
    ----------
    robot
        The robot.
    logs
        The logs.
    given, source
        A configuration to start from, whose keys are kept unchanged, and its file.
    progress
        Callback for the stage and its share that is done.

    Raises
    ------
    IdtoolError
        If a log or the configuration cannot be used, or no joint can be identified.
    """
    draft = _make_draft(robot, logs, given, source, progress)
    parts = [part for key in _SECTIONS if (part := _section(draft, key)) is not None]
    parts += [_given_section(draft, key) for key in draft.given if key not in _SECTIONS]
    data = {part.key: part.value for part in parts if part.value is not None}
    parse_config(data, "idtool init")  # check that it can be read back
    results = draft.trial_results
    return InitialConfig(
        data=data,
        text=configuration_text(_header(draft), parts),
        findings=tuple(_findings(draft)),
        todo=tuple(_todo_items(draft)),
        trials=results.trials if results else (),
        rms=results.rms if results else None,
        band_hz=draft.config.filter.cutoff_hz or draft.log_summary.cutoff_hz,
        notices=unique([*draft.log_summary.notices, *(results.notices if results else ())]),
    )


def _make_draft(
    robot: Robot, logs: Sequence[Path], given: Mapping[str, Any], source: Path | None, progress: Progress
) -> Draft:
    """Collect everything that the sections are written from."""
    config = parse_config(given, str(source))
    summary = summarize_logs(robot, logs, config, progress)
    progress("reading geometry", 0.0)
    locked = {name: lock.position for name, lock in summary.locked.items()} | config.locked_joints
    base = base_sections(robot, summary.logs, config, summary.joints, summary.imu_topics, summary.pose_topics)
    with_base = parse_config({**base.values(), **given}, "idtool init")
    model_settings = with_base.model_copy(update={"joints": summary.joints, "locked_joints": locked})
    model = build_model(robot, model_settings, summary.joints)
    draft = Draft(
        robot=robot,
        paths=tuple(logs),
        log_summary=summary,
        given={key: value for key, value in given.items() if value is not None},
        source=source,
        config=config,
        bounds=find_bounds(robot, model),
        ratios=gear_ratios(robot),
        rotors=rotor_links(robot, summary.joints),
        standing_links=_standing_links(robot, model),
        base=base,
    )
    return _with_trials(draft, model, progress)


def _standing_links(robot: Robot, model: RobotModel) -> dict[str, float]:
    """Masses of the links that no identified joint moves [kg]."""
    masses = {}
    for link, pi in robot.links.items():
        if pi is not None and model.frames[link].body < 0 and pi[0] > 0:
            masses[link] = float(pi[0])
    return masses


def _with_trials(draft: Draft, model: RobotModel, progress: Progress) -> Draft:
    """The draft with the results of trials, or the reason why there are none."""
    if draft.with_fitted_gains:
        reason = "the controller gains are fitted; give the numbers that idtool fit writes to model.yaml, and run again"
        return replace(draft, no_trials_reason=reason)
    if draft.without_gains:
        return replace(draft, no_trials_reason=f"the controller gains of {join_names(draft.without_gains)} are missing")
    draft = _with_radius(_with_signs(draft))
    if not draft.log_summary.with_torque:
        return replace(draft, no_trials_reason="no torque was logged")
    draft = _with_support(draft)
    draft = _with_frame(draft, progress)
    runner = TrialRunner(draft.robot, _trial_data(draft), draft.log_summary.logs, progress)
    on_joints: list[tuple[str, str]] = []
    searched: list[str] = []
    for effect, kind in effect_types().items():
        trial = kind.init_trial
        is_given = ("friction" if kind.friction_key else "effects") in draft.given
        is_given |= kind.is_rotor_inertia and "armature" in draft.given
        if trial is None or is_given or (trial.needs_measured_torque and draft.log_summary.commanded):
            continue
        if issubclass(kind, JointTerm):
            affected = [name for name in draft.joints if kind.may_act_on(model, model.names.index(name))]
            on_joints += [(effect, name) for name in affected]
        else:
            searched.append(effect)
    try:
        return replace(draft, trial_results=run_trials(runner, on_joints, searched))
    except IdtoolError as error:
        return replace(draft, no_trials_reason=f"the fit failed: {error}")


def _trial_data(draft: Draft) -> dict[str, Any]:
    """The configuration before the trials, plain data."""
    parts = [_section(draft, key) for key in _SECTIONS_FOR_TRIALS]
    return {**draft.given, **{part.key: part.value for part in parts if part is not None and part.value is not None}}


def _with_signs(draft: Draft) -> Draft:
    """The draft with the signs of proposed wrench sensors, as far as the logs tell them."""
    if "wrench_sensors" not in draft.base.sections:
        return draft
    config = parse_config(_trial_data(draft), "trial")
    signs: dict[str, int] = {}
    for log in draft.log_summary.logs:
        try:
            experiment = prepare(draft.robot, config, [log])
        except IdtoolError:  # which the trials report
            continue
        signs = sensor_signs(experiment.runs[0].signals, experiment.model, experiment.config) | signs
        if len(signs) == len(config.wrench_sensors):
            break
    return replace(draft, base=draft.base.with_signs(signs))


def _with_radius(draft: Draft) -> Draft:
    """The draft with the radius of feet without a known one, if the logs determine it by how they roll."""
    feet = draft.base.feet_without_radius
    if not feet:
        return draft
    data = _trial_data(draft)
    balls = [{**entry, "radius": _ANY_RADIUS} if entry["name"] in feet else entry for entry in data["contacts"]]
    config = parse_config({**data, "contacts": balls}, "trial")
    try:
        radius = rolling_radius(prepare(draft.robot, config, draft.log_summary.logs), feet)
    except IdtoolError:  # which the trials report
        radius = None
    return replace(draft, base=draft.base.with_radius(radius))


def _with_support(draft: Draft) -> Draft:
    """The draft with a contact for what holds the robot while no other contact is closed, if there is such a log."""
    if "contacts" not in draft.base.sections:
        return draft
    config = parse_config(_trial_data(draft), "trial")
    try:
        held = held_logs(prepare(draft.robot, config, draft.log_summary.logs))
    except IdtoolError:  # which the trials report
        held = []
    return replace(draft, base=draft.base.with_support(draft.robot.root, held)) if held else draft


def _with_frame(draft: Draft, progress: Progress) -> Draft:
    """The draft with the axes of measured forces on the feet of which the logs are explained better."""
    if not draft.base.measured_contacts:
        return draft
    errors: dict[str, float] = {}
    for frame in ("world", "link"):
        progress(f"trying forces along the axes of the {frame}", 0.5 * len(errors))
        data = _trial_data(replace(draft, base=draft.base.with_frame(frame, is_certain=True)))
        runner = TrialRunner(draft.robot, data, draft.log_summary.logs, progress)
        try:
            errors[frame] = runner.evaluator(runner.config(TrialTerms())).score(runner.config(TrialTerms())).rms()
        except IdtoolError:  # without an orientation, there are no axes of the world
            errors[frame] = math.inf
    best = min(errors, key=lambda frame: errors[frame])
    is_certain = _MIN_FRAME_RATIO * errors[best] < max(errors.values()) < math.inf
    frame = best if is_certain or math.isinf(errors["world"]) else "world"
    return replace(draft, base=draft.base.with_frame(frame, is_certain))


def _section(draft: Draft, key: str) -> ConfigSection | None:
    """A section; a given value replaces it, except that the logs may add to the log and controller sections."""
    part = _SECTIONS[key](draft)
    if key not in draft.given or (part is not None and key in _MERGED):
        return part
    if part is None or key in _BY_TRIAL:
        return _given_section(draft, key)
    if part.value == draft.given[key]:
        return replace(part, comments=(f"Given in {draft.origin}; idtool init finds the same value.", *part.comments))
    if key == "log" and draft.log_summary.topic is not None:
        topic = "topic: the topic with most of the URDF's joints and signals (logs)."
        return replace(_given_section(draft, key, topic), value={**draft.given[key], **part.value})
    return _given_section(draft, key)


def _given_section(draft: Draft, key: str, *comments: str) -> ConfigSection:
    return ConfigSection(key, (f"Given in {draft.origin}.", *comments), draft.given[key])


def _header(draft: Draft) -> list[str]:
    logs = join_names([path.name for path in draft.paths])
    return [
        f"First configuration for {draft.robot.path.name}, written by idtool init from {logs}. SI units.",
        "Comments describe the keys and, in brackets, the sources of their values. Sections that are commented out are "
        "templates: complete them if they apply to the robot.",
    ]


def _findings(draft: Draft) -> list[str]:
    """Findings from the URDF and the logs, one line each."""
    summary, results = draft.log_summary, draft.trial_results
    count = len(summary.moving)
    lines = [
        f"{count} moving joints: {join_names(summary.moving)}" if count > 1 else f"1 moving joint: {summary.moving[0]}"
    ]
    if draft.locked:
        lines.append(f"joints assumed to stand still: {join_names(draft.locked)}")
    if summary.topic is not None:
        lines.append(f"topic {summary.topic}, out of {join_names(summary.topics)}")
    lines += _found_base(draft)
    if "filter" not in draft.given:
        lines.append(
            f"motion below {short_number(summary.motion_hz, 2)} Hz, so filter.cutoff_hz is {summary.cutoff_hz:g}"
        )
    if draft.bounds.ellipsoids:
        lines.append(f"bounding ellipsoids of {join_names(draft.bounds.ellipsoids)}")
    if geared := [name for name, ratio in draft.ratios.items() if abs(ratio) != 1]:
        lines.append(f"gear ratios of {join_names(geared)}")
    return lines if results is None else [*lines, *_kept_effects(results)]


def _found_base(draft: Draft) -> Iterator[str]:
    """Findings on the base, one line each."""
    found = draft.base.values()
    base = found.get("base", {})
    if "imu" in base:
        yield f"floating base {base['link']}, IMU {base['imu']['link']}"
    if "pose" in base:
        yield f"floating base {base['link']}, pose of {base['pose']['link']}"
    if "contacts" in found:
        yield f"contacts: {join_names([contact['name'] for contact in found['contacts']])}"
    if "wrench_sensors" in found:
        yield f"wrench sensors: {join_names([sensor['joint'] for sensor in found['wrench_sensors']])}"


def _kept_effects(results: TrialResults) -> Iterator[str]:
    """The kept effects, one line each: friction first, effects on the whole robot last."""
    friction: dict[str, list[str]] = {}
    terms: dict[str, list[str]] = {}
    whole: list[str] = []
    for (effect, joint), value in results.values.items():
        kind = effect_types()[effect]
        if joint is None:
            search = search_of(effect)
            whole.append(f"{search.heading}: {search.shown(value)}")
        elif kind.friction_key:
            friction.setdefault(effect, []).append(joint)
        else:
            terms.setdefault(effect, []).append(f"{joint} {short_number(value)}")
    for effect, names in (friction | terms).items():
        yield f"{trial_of(effect).heading}: {join_names(names)}"
    yield from whole


def _todo_items(draft: Draft) -> list[TodoItem]:
    """Values that the user has to fill in."""
    items = []
    if fitted := draft.with_fitted_gains:
        items.append(TodoItem("controller", f"kp and kd of {join_names(fitted)} if you know them: fit estimates them"))
    elif draft.without_gains:
        items.append(
            TodoItem(
                "controller", f"kp and kd of {join_names(draft.without_gains)}, because no torque was logged", True
            )
        )
    elif draft.no_trials_reason:
        items.append(TodoItem("friction, effects", f"nothing was tried, because {draft.no_trials_reason}"))
    items += draft.base.todo
    if not draft.log_summary.are_sensors_read:
        items.append(TodoItem("base.imu.topic", "name the IMU, if the base moves: no topic of one is in all logs"))
    if without_torque := draft.log_summary.without_torque:
        named = join_names([f"tau_{name} (not in {log})" for name, log in without_torque.items()])
        items.append(TodoItem("log.columns", f"give the column of the torque, or log the command instead: {named}"))
    if "bounding_ellipsoids" not in draft.given or draft.given["bounding_ellipsoids"] == draft.bounds.ellipsoids:
        items += _unbounded(draft)
    if "rotors" not in draft.given and "armature" not in draft.given:
        what = "gear ratio and inertia of each, if the joints are geared"
        if draft.without_rotor:
            what += "; or armature: auto, which estimates their reflected inertia"
        items.append(TodoItem("rotors", what))
    if "total_mass" not in draft.given.get("known", {}):
        items.append(model_sections.total_mass_todo(draft))
    return items


def _unbounded(draft: Draft) -> list[TodoItem]:
    bounds = draft.bounds
    if not bounds.missing:
        return []
    what = f"ellipsoids of {join_names(bounds.missing)}"
    if bounds.unread:
        first = bounds.unread[0]
        which = (
            "their meshes" if len(bounds.unread) == len(bounds.missing) else f"meshes of {join_names(bounds.unread)}"
        )
        what += f"; {which} could not be read ({printable(first)}: {one_line(bounds.missing[first])}); they were "
        what += search_paths(draft.robot)
    return [TodoItem("bounding_ellipsoids", what)]
