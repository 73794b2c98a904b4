"""The sections of a first configuration on the robot and its logs: joints, gravity, log, velocity, filter, friction."""

from __future__ import annotations

from typing import Any

from idtool.common.names import join_names
from idtool.common.number_text import short_number
from idtool.data.base_sensors import POSE_CUTOFF
from idtool.dynamics.effects import effect_types
from idtool.robot.config import Config, Friction
from idtool.setup.draft import Draft
from idtool.setup.loaded_logs import MAX_SAMPLES
from idtool.setup.records import ConfigSection, Trial
from idtool.setup.trials import HOLDOUT, term_type, trial_of

HELD_OUT = f"the last {100 * HOLDOUT:.0f} % of each log (of its first {MAX_SAMPLES} samples if it is longer)"


def joints(draft: Draft) -> ConfigSection:
    """The section ``joints``: the joints that are identified."""
    what = (
        "Joints that are identified: actuated joints that are in every log, move, and have a torque or a command "
        "(URDF, logs)."
    )
    return ConfigSection("joints", (what,), list(draft.log_summary.identifiable))


def locked_joints(draft: Draft) -> ConfigSection:
    """The section ``locked_joints``: joints that are held still, with given positions where there are any."""
    given = [name for name in draft.locked if name in draft.config.locked_joints]
    reasons = {name: lock.reason for name, lock in draft.log_summary.locked.items() if name not in given}
    what = "Joints that are assumed to stand still, and their positions, rad or m"
    if not draft.locked:
        return ConfigSection("locked_joints", (f"{what} (default: none).",), {})
    if reasons:
        what += ": the median in the logs (logs), otherwise 0 or the position limit closest to 0 (URDF)"
    why = [f"{why}: {join_names([n for n in reasons if reasons[n] == why])}" for why in sorted(set(reasons.values()))]
    if given:
        why.append(f"given in {draft.origin}: {join_names(given)}")
    return ConfigSection("locked_joints", (f"{what}.", *why), draft.locked)


def gravity(draft: Draft) -> ConfigSection | None:
    """The section ``gravity``: the default; None with a floating base, whose accelerometer measures it."""
    if draft.has_floating_base:
        return None
    what = f"Gravity in the frame of the URDF's root link {draft.robot.root}, m/s² (default: the z axis points up)."
    return ConfigSection("gravity", (what,), list(Config().gravity))


def log(draft: Draft) -> ConfigSection:
    """The section ``log``: the topic if there are several, the preset if there is one, and a template."""
    seen = draft.log_summary
    rates = ", ".join(dict.fromkeys(short_number(rate, 4) for rate in seen.rates_hz))
    comments = [f"How the logs are read. Their sampling rate is {rates} Hz, according to their time stamps (logs)."]
    value: dict[str, Any] = {}
    if seen.topic is not None:
        comments.append(
            f"topic: the topic with most of the URDF's joints and signals, out of {join_names(seen.topics)} (logs)."
        )
        value["topic"] = seen.topic
    presets = {log.preset for log in seen.logs if log.preset is not None}
    if len(presets) == 1:
        comments.append("preset: the robot whose messages these are, which do not name the joints (logs and URDF).")
        value["preset"] = presets.pop()
    first = draft.joints[0]
    unit = draft.unit("torque", draft.joints)
    remark = (
        f"scale: {unit} per logged unit, if the log is not in {unit}, for example torque constant × gear ratio; "
        "columns: names of the columns in the file."
    )
    template = {"scale": {"tau": {first: None}}, "columns": {f"tau_{first}": None}}
    return ConfigSection("log", tuple(comments), value or None, (remark,), template)


def velocity(draft: Draft) -> ConfigSection:
    """The section ``velocity``: the default, and its outcome on these logs as a comment."""
    what = "Joint velocity: measured, differentiated (from q), or auto: the less noisy of the two if both are reliable"
    found = draft.trial_results
    if found is None:
        return ConfigSection("velocity", (f"{what} (default).",), "auto")
    if not found.differentiated:
        chose = "the measured velocity for all joints"
    else:
        chose = f"the differentiated position for {join_names(found.differentiated)}"
        if len(found.differentiated) < len(draft.joints):
            chose += " and the measured velocity for the other joints"
    return ConfigSection("velocity", (f"{what} (default). On these logs, auto uses {chose} (logs).",), "auto")


def low_pass(draft: Draft) -> ConfigSection:
    """The section ``filter``: a low-pass, with a cut-off by the band of the motion."""
    seen = draft.log_summary
    what = (
        "One zero-phase low-pass for all signals. cutoff_hz: the motion lies below "
        f"{short_number(seen.motion_hz, 2)} Hz (logs); the cut-off is {seen.bands:g} times this frequency, "
        "but at least 5 Hz, and "
        "not above 40 Hz or a fifth of the sampling rate. kind and order have their default values."
    )
    if seen.commanded:
        what += (
            " Torque that is computed from commands contains the encoders' noise, which would be mistaken for inertia "
            "with a higher cut-off."
        )
    cutoff_hz = seen.cutoff_hz
    if draft.uses_pose and cutoff_hz > POSE_CUTOFF:
        cutoff_hz = POSE_CUTOFF
        what += (
            f" With a pose of the base, at most {POSE_CUTOFF:g} Hz: its noise grows with the square of the frequency."
        )
    return ConfigSection("filter", (what,), {"kind": "butterworth", "cutoff_hz": cutoff_hz, "order": 4})


def friction(draft: Draft) -> ConfigSection:
    """The section ``friction``: viscous and Coulomb friction, and an offset where the trials kept one."""
    what = "Friction terms: viscous and Coulomb (default), and offset (a constant torque)"
    found = draft.trial_results
    if found is None:
        return ConfigSection(
            "friction", (), None, (f"{what}: not tried, because {draft.no_trials_reason}.",), Friction().model_dump()
        )
    comments = [f"{what} where it reduces the held-out torque error; held out: {HELD_OUT} (found by trial)."]
    value: dict[str, Any] = {name: Friction().model_dump() for name in draft.joints}
    for trial in found.trials:
        if trial.kept and trial.joint is not None and effect_types()[trial.effect].friction_key:
            size = trial_of(trial.effect).comment.format(value=sized(draft, trial.effect, trial.joint, trial.value))
            comments.append(f"{trial.joint}: {size}, held-out RMS {errors(trial)}")
            value[trial.joint][effect_types()[trial.effect].friction_key] = True
    first = value[draft.joints[0]]
    alike = all(terms == first for terms in value.values())
    return ConfigSection("friction", tuple(comments), first if alike else value)


def errors(trial: Trial) -> str:
    """Held-out error without and with the effect that was tried, in words."""
    return " -> ".join("unknown" if x is None else short_number(x) for x in (trial.before, trial.after))


def sized(draft: Draft, effect: str, joint: str, value: float) -> str:
    """The coefficient of an effect on a joint, with its unit."""
    revolute, prismatic = term_type(effect).units
    return f"{short_number(value)} {prismatic if draft.robot.joints[joint].kind == 'prismatic' else revolute}"
