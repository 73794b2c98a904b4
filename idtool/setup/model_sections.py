"""Sections of a first configuration that a URDF lacks: rotors, effects, bounding ellipsoids, controller, masses."""

from __future__ import annotations

from typing import Any

from idtool.common.names import join_names
from idtool.common.number_text import short_number
from idtool.dynamics.effects import effect_types
from idtool.setup.bounds import search_paths
from idtool.setup.draft import Draft
from idtool.setup.records import ConfigSection, TodoItem
from idtool.setup.sections import errors, sized
from idtool.setup.transmissions import rotor_template, solid_ellipsoid
from idtool.setup.trials import TrialResults, search_of, searched_entry, term_type, trial_of


def rotors(draft: Draft) -> ConfigSection:
    """The section ``rotors``: templates, filled in as far as the URDF allows."""
    known = {name: ratio for name, ratio in draft.ratios.items() if name in draft.joints}
    told = [f"{name}: {ratio:g}" for name, ratio in known.items() if abs(ratio) != 1]
    comments = [
        "Rotors of geared motors: bodies that spin at gear_ratio times the speed of a joint. Replace every null by a "
        "value.",
        f"Gear ratios in the URDF (<transmission>): {', '.join(told) or 'none'}. The inertia is about the centre of "
        "mass. In place of inertial, inertia about the axis is enough, a number: all else but joint and gear_ratio may "
        "then be left out.",
    ]
    if len(told) < len(known):
        one = join_names([name for name, ratio in known.items() if abs(ratio) == 1])
        comments.append(f"A gear ratio of 1 was ignored, because it usually means that the ratio is unknown: {one}.")
    if draft.rotors:
        comments.append(
            "A rotor with the name of a URDF link on a fixed joint is that link, with its origin and inertia (URDF)."
        )
    replaced = join_names([effect for effect, kind in effect_types().items() if kind.is_rotor_inertia])
    comments.append(
        f"A rotor replaces the {replaced} of its joint. If you add a rotor, remove that entry under effects."
    )
    template = {}
    for name in draft.joints:
        link, ratio = draft.rotors.get(name), known.get(name, 1.0)
        key = link or _free_name(draft, name)
        template[key] = rotor_template(draft.robot, draft.robot.joints[name], None if abs(ratio) == 1 else ratio, link)
    return ConfigSection("rotors", (), None, tuple(comments), template)


def armature(draft: Draft) -> ConfigSection | None:
    """The section ``armature``: a template for joints without a rotor; None if all have one."""
    joints = draft.without_rotor
    if not joints:
        return None
    comments = (
        f"Reflected inertia of rotors (inertia × gear ratio²), {draft.unit('inertia', joints)}, in place of rotors: "
        "auto is estimated on each joint without a rotor; a number, for all joints or by joint, is known.",
        f"Joints without one: {join_names(joints)}.",
    )
    return ConfigSection("armature", (), None, comments, "auto")


def _free_name(draft: Draft, joint: str) -> str:
    name = f"{joint}_rotor"
    while name in draft.robot.links:
        name += "_"
    return name


def effects(draft: Draft) -> ConfigSection:
    """The section ``effects``: those that the trials kept."""
    what = "Effects besides rigid bodies and friction"
    found = draft.trial_results
    if found is None:
        return ConfigSection("effects", (), None, (f"{what}: not tried, because {draft.no_trials_reason}.",), [])
    kept = [trial for trial in found.trials if trial.kept and not effect_types()[trial.effect].friction_key]
    if not kept:
        return ConfigSection("effects", (f"{what} ({_nothing_kept(found)}); idtool diagnose searches for others.",), [])
    comments = [f"{what} (found by trial; held-out RMS torque error without -> with the effect)."]
    entries: list[dict[str, Any]] = []
    for trial in kept:
        effect, joint = trial.effect, trial.joint
        value = found.values[effect, joint]
        if joint is None:
            entry = searched_entry(effect, _short(value))
            owner = effect_types()[effect].whole_robot_owner
            size = search_of(effect).shown(value)
        else:
            entry = term_type(effect).zero_entry(joint)
            entry.parameters[term_type(effect).coefficient_name] = _short(value)
            owner = joint
            size = sized(draft, effect, joint, value)
        comments.append(f"{owner}: {trial_of(effect).comment.format(value=size)}: {errors(trial)}")
        entries.append(entry.model_dump(exclude_none=True))
    return ConfigSection("effects", tuple(comments), entries)


def _nothing_kept(found: TrialResults) -> str:
    """Names of the effects that were tried, in words, for the case that none was kept."""
    names = {effect: kind.init_trial.name for effect, kind in effect_types().items() if kind.init_trial}
    names = {effect: name for effect, name in names.items() if not effect_types()[effect].friction_key}
    was_tried = {trial.effect for trial in found.trials}
    tried = [name for effect, name in names.items() if effect in was_tried]
    no_trials_reason = [name for effect, name in names.items() if effect not in was_tried]
    if not tried:
        return "none was tried"
    shows = (
        f"{tried[0]} does not reduce the error"
        if len(tried) == 1
        else f"neither {' nor '.join(tried)} reduces the error"
    )
    others = "".join(f"; {name} was not tried" for name in no_trials_reason)
    return f"found by trial: {shows}{others}"


def _short(x: float) -> float:
    return float(f"{x:.4g}")


def bounding_ellipsoids(draft: Draft) -> ConfigSection:
    """The section ``bounding_ellipsoids``: ellipsoids around known geometry, templates for other links."""
    bounds = draft.bounds
    comments = [
        "Smallest ellipsoids around each link's collision or visual geometry, enlarged by 5 %; m, rad, in the link "
        "frame (URDF)."
    ]
    if not bounds.ellipsoids:
        comments = [
            "For each link, an ellipsoid in its frame that contains all its mass; m, rad. The URDF has no usable "
            "geometry."
        ]
    if not bounds.missing:
        return ConfigSection("bounding_ellipsoids", tuple(comments), dict(bounds.ellipsoids))
    remarks = [f"{link}: {why}" for link, why in bounds.missing.items()]
    if bounds.unread:
        remarks.append(f"Meshes were {search_paths(draft.robot)}.")
    remarks.append(
        "Template: the solid ellipsoid with the URDF's inertia. It is only a guide: the ellipsoid must enclose the "
        "whole link."
    )
    if bounds.unused:
        remarks.append("It includes ellipsoids of links that are part of the same body as a link without an ellipsoid.")
    template = dict(bounds.unused)
    for link in bounds.missing:
        pi = draft.robot.links[link]
        solid = None if pi is None else solid_ellipsoid(pi)
        template[link] = [solid or {"center": [0.0, 0.0, 0.0], "semi_axes": [None] * 3, "rpy": [0.0, 0.0, 0.0]}]
    return ConfigSection(
        "bounding_ellipsoids", tuple(comments), dict(bounds.ellipsoids) or None, tuple(remarks), template
    )


def controller(draft: Draft) -> ConfigSection | None:
    """The section ``controller``: the given values, or a template; None if the logs have torque."""
    names = draft.log_summary.commanded
    if not names:
        return None
    units = f"kp {draft.unit('stiffness', names)}, kd {draft.unit('damping', names)}"
    what = f"The joint controller, from which the torque is computed because none was logged: {units} at the joint"
    late = ("delay: time from command to torque, s; auto (default): idtool fit determines it.",)
    given, delay = draft.given.get("controller"), {"delay": "auto"}
    if given is None and draft.can_fit_gains:
        relative = (
            "fit: idtool fit estimates the gains, but only relative to the masses: if all masses are 10 % wrong, so "
            "are the gains; and only with a complete model: geared joints need rotors or armature. Give the numbers if "
            "you know them; one number, as in kp: 25, is that of all joints."
        )
        return ConfigSection("controller", (f"{what}.", relative, *late), {"kp": "fit", "kd": "fit", **delay})
    if given is None:
        template = {"kp": dict.fromkeys(names), "kd": dict.fromkeys(names), **delay}
        remark = (
            "Without these gains, nothing can be fitted: replace every null of kp and kd by a value; one number, as in "
            "kp: 25, is that of all joints."
        )
        return ConfigSection("controller", (f"{what}.", *late), None, (remark,), template)
    said = f"{what} (given in {draft.origin})."
    if "delay" in given:
        return ConfigSection("controller", (said,), given)
    return ConfigSection("controller", (said, *late), {**given, **delay})


def known(draft: Draft) -> ConfigSection:
    """The section ``known``: a template, with the URDF's masses for comparison."""
    robot = draft.robot
    links = [robot.joints[name].child for name in draft.joints]
    what = (
        "Masses that were measured by other means, kg; with a standard error they are soft constraints. Replace every "
        "null by a value."
    )
    masses = [f"{link} {short_number(pi[0])}" for link in links if (pi := robot.links[link]) is not None]
    prior = f"Masses in the URDF: {join_names(masses) or 'none'}."
    whole = (
        "total_mass: mass of all moving parts, including rotors; it is easy to measure, and the torque rarely "
        "determines it."
    )
    remarks = [what, whole, prior]
    if draft.standing_links:
        remarks.append(f"A scale also weighs what stands still and is not in the model; subtract {_standing(draft)}.")
    entry = {link: {"value": None, "standard_error": None} for link in links[:1]}
    return ConfigSection("known", (), None, tuple(remarks), {"mass": entry, "total_mass": None})


def total_mass_todo(draft: Draft) -> TodoItem:
    """The item that asks for the total mass."""
    what = "weigh the moving parts: the torque alone rarely determines their mass"
    if draft.standing_links:
        what += f"; if you weigh the whole robot, subtract {_standing(draft)}"
    return TodoItem("known.total_mass", what)


def _standing(draft: Draft) -> str:
    """The links that stand still, with their mass, in words."""
    mass = sum(draft.standing_links.values())
    return f"{join_names(draft.standing_links)}, {mass:.4g} kg in the URDF"
