"""The sections on what a URDF does not know: rotors, effects, bounding ellipsoids, controller, masses."""

from __future__ import annotations

from typing import Any

from idtool.starting.bounds import search_paths
from idtool.starting.draft import Draft
from idtool.starting.gears import rotor_template, solid_ellipsoid
from idtool.starting.records import Section
from idtool.starting.sections import gain


def rotors(draft: Draft) -> Section:
    """See `Section`."""
    comments = [
        "Geared motors' rotors, bodies that spin with a joint at gear_ratio times its speed: to fill in where null."
    ]
    known = [f"{name}: {ratio:g}" for name, ratio in draft.ratios.items() if name in draft.joints]
    comments.append(f"gear_ratio: {', '.join(known) or 'none there'} (URDF, <transmission>); inertial: about the com.")
    if draft.rotors:
        comments.append(
            "A rotor with the name of a URDF link on a fixed joint is that link, with its place and inertia (URDF)."
        )
    comments.append("A rotor takes the place of its joint's rotor_inertia under effects: remove that one.")
    template = {}
    for name in draft.joints:
        link = draft.rotors.get(name)
        joint = draft.robot.joints[name]
        template[link or _free_name(draft, name)] = rotor_template(draft.robot, joint, draft.ratios.get(name), link)
    return Section("rotors", (), None, tuple(comments), template)


def _free_name(draft: Draft, joint: str) -> str:
    name = f"{joint}_rotor"
    while name in draft.robot.links:
        name += "_"
    return name


def effects(draft: Draft) -> Section:
    """See `Section`."""
    what = "What the model carries beside rigid bodies and friction"
    found = draft.found
    if found is None:
        return Section("effects", (), None, (f"{what}: not tried, as {draft.untried}.",), [])
    comments = [f"{what} (found by trial: held-out RMS torque error without -> with it)."]
    entries: list[dict[str, Any]] = []
    for trial in found.trials:
        if trial.kept and trial.effect == "rotor_inertia" and trial.joint is not None:
            inertia = found.inertia[trial.joint]
            unit = draft.unit(trial.joint, "inertia")
            comments.append(
                f"{trial.joint}: reflected rotor inertia {inertia:.3g} {unit}, gear ratio² × the rotor's: {gain(trial)}"
            )
            entries.append({"effect": trial.effect, "joint": trial.joint, "parameters": {"inertia": _short(inertia)}})
        if trial.kept and trial.effect == "time_delay":
            comments.append(
                f"all joints: torque is logged {1e3 * trial.value:.3g} ms late (below zero: early) against position: "
                f"{gain(trial)}"
            )
            entries.append({"effect": "time_delay", "parameters": {"delay": _short(trial.value)}})
    if not entries:
        comments = [
            f"{what} (found by trial: neither rotor inertia nor a delay shows); idtool diagnose looks for others."
        ]
    return Section("effects", tuple(comments), entries)


def _short(x: float) -> float:
    return float(f"{x:.4g}")


def bounding_ellipsoids(draft: Draft) -> Section:
    """See `Section`."""
    bounds = draft.bounds
    comments = [
        "Smallest ellipsoids around each link's collision or visual geometry, 5 % longer; m, rad, link frame (URDF)."
    ]
    if not bounds.found:
        comments = ["An ellipsoid per link, in its frame, that holds all its mass; m, rad: none was found (URDF)."]
    if not bounds.missing:
        return Section("bounding_ellipsoids", tuple(comments), dict(bounds.found))
    remarks = [f"{link}: {why}" for link, why in bounds.missing.items()]
    if any("mesh" in why for why in bounds.missing.values()):
        remarks.append(f"Meshes were {search_paths(draft.robot)}.")
    remarks.append(
        "Template, from the URDF's inertia as a solid ellipsoid: too small, enlarge it to what the link fills."
    )
    if bounds.unused:
        remarks.append("With it go ellipsoids of links that are one body with a link that has none.")
    template = dict(bounds.unused)
    for link in bounds.missing:
        pi = draft.robot.links[link]
        solid = None if pi is None else solid_ellipsoid(pi)
        template[link] = [solid or {"center": [0.0, 0.0, 0.0], "semi_axes": [None] * 3, "rpy": [0.0, 0.0, 0.0]}]
    return Section("bounding_ellipsoids", tuple(comments), dict(bounds.found) or None, tuple(remarks), template)


def controller(draft: Draft) -> Section | None:
    """See `Section`; None where the logs have torque."""
    names = draft.recorded.commanded
    if not names:
        return None
    what = "The joint controller that made the torque, as none was logged: kp N·m/rad, kd N·m·s/rad at the joint"
    late = (
        "delay: s from command to torque: half a sample, as a command is held until the next one (default);",
        "a longer one is for you to fill in, as data cannot tell it from friction and inertia.",
    )
    given, delay = draft.given.get("controller"), {"delay": half_a_sample(draft)}
    if given is None:
        template = {"kp": dict.fromkeys(names), "kd": dict.fromkeys(names), **delay}
        remark = "Nothing can be fitted without: fill in kp and kd where null."
        return Section("controller", (f"{what}.", *late), None, (remark,), template)
    source = draft.source.name if draft.source else "the configuration"
    if "delay" in given:
        return Section("controller", (f"{what} (given in {source}).",), given)
    return Section("controller", (f"{what} (given in {source}).", *late), {**given, **delay})


def half_a_sample(draft: Draft) -> float:
    """Of the logs [s]."""
    return _short(0.5 / min(draft.recorded.rates_hz))


def known(draft: Draft) -> Section:
    """See `Section`."""
    robot = draft.robot
    links = [robot.joints[name].child for name in draft.joints]
    what = "Masses that were measured by other means, kg; with a standard error they are soft. To fill in where null."
    masses = [f"{link} {pi[0]:.4g}" for link in links[:3] if (pi := robot.links[link]) is not None]
    prior = f"The URDF has {', '.join(masses)}." if masses else "The URDF has none."
    entry = {link: {"value": None, "standard_error": None} for link in links[:1]}
    return Section("known", (), None, (what, prior), {"mass": entry, "total_mass": None})
