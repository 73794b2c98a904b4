"""The sections of a first configuration on the robot and its logs: joints, gravity, log, velocity, filter, friction."""

from __future__ import annotations

from typing import Any

from idtool.names import some
from idtool.starting.draft import Draft
from idtool.starting.records import Section, Trial
from idtool.starting.trials import HOLDOUT


def joints(draft: Draft) -> Section:
    """See `Section`."""
    what = "Joints that are identified: actuated, in every log, moving, with a torque or a command (URDF, logs)."
    return Section("joints", (what,), list(draft.joints))


def locked_joints(draft: Draft) -> Section:
    """See `Section`."""
    locked = {name: lock for name, lock in draft.recorded.locked.items() if name in draft.locked}
    what = "Joints that are held still, rad or m: at the logs' median (logs), else at 0 or the limit next to it (URDF)."
    reasons = sorted({lock.why for lock in locked.values()})
    why = tuple(f"{reason}: {some([n for n, lock in locked.items() if lock.why == reason])}" for reason in reasons)
    if not draft.locked:
        return Section("locked_joints", ("Joints that are held still, rad or m (default: none).",), {})
    return Section("locked_joints", (what, *why), draft.locked)


def gravity(draft: Draft) -> Section:
    """See `Section`."""
    what = f"Gravity in the frame of the URDF's root link {draft.robot.root}, m/s² (default: its z points up)."
    return Section("gravity", (what,), list(draft.config.gravity))


def log(draft: Draft) -> Section:
    """See `Section`."""
    seen = draft.recorded
    rates = ", ".join(dict.fromkeys(f"{rate:.4g}" for rate in seen.rates_hz))
    comments = [f"How the logs are read; their rate is {rates} Hz, from their time stamps (logs)."]
    value = None
    if seen.topic is not None:
        comments.append(f"topic: of {some(seen.topics)}, the one with most of the URDF's joints and signals (logs).")
        value = {"topic": seen.topic}
    first = draft.joints[0]
    remark = (
        "scale: N·m per logged unit where that is not N·m, e.g. torque constant × gear ratio; columns: other names."
    )
    template = {"scale": {"tau": {first: None}}, "columns": {f"tau_{first}": None}}
    return Section("log", tuple(comments), value, (remark,), template)


def velocity(draft: Draft) -> Section:
    """See `Section`."""
    what = "Joint velocity: measured, differentiated from q, or auto, the quieter one that can be trusted"
    found = draft.found
    if found is None:
        return Section("velocity", (f"{what} (default).",), "auto")
    if not found.differentiated:
        chose = "the measured one of all joints"
    else:
        chose = f"q, differentiated, of {some(found.differentiated)}"
        chose += "" if len(found.differentiated) == len(draft.joints) else ", the measured one of the others"
    return Section("velocity", (f"{what} (default):", f"on these logs auto takes {chose} (logs)."), "auto")


def low_pass(draft: Draft) -> Section:
    """See `Section`."""
    seen = draft.recorded
    what = "One zero-phase low-pass for every signal alike. cutoff_hz: above what moves the joints, which lies below"
    kinds = "5 times that, from 5 Hz up to 40 Hz or a fifth of the rate (logs); kind and order (default)."
    value = {"kind": "butterworth", "cutoff_hz": seen.cutoff_hz, "order": 4}
    return Section("filter", (f"{what} {seen.motion_hz:.2g} Hz:", kinds), value)


def friction(draft: Draft) -> Section:
    """See `Section`."""
    what = "Friction terms: viscous, Coulomb (default), and offset, a constant"
    found = draft.found
    if found is None:
        return Section("friction", (), None, (f"{what}: not tried, as {draft.untried}.",), _terms(False))
    tried = [trial for trial in found.trials if trial.effect == "torque_offset"]
    held = f"where the held-out torque, the logs' last {HOLDOUT:.0%}, needs it (found by trial)."
    gains = [
        f"{trial.joint}: {trial.value:.3g} {draft.unit(trial.joint, 'torque')}, held-out RMS {gain(trial)}"
        for trial in tried
        if trial.kept and trial.joint is not None
    ]
    if len(found.offsets) in (0, len(draft.joints)):
        return Section("friction", (f"{what},", held, *gains), _terms(bool(found.offsets)))
    value = {name: _terms(name in found.offsets) for name in draft.joints}
    return Section("friction", (f"{what},", held, *gains), value)


def gain(trial: Trial) -> str:
    """The held-out error without and with what was tried, in words."""
    return " -> ".join("unknown" if x is None else f"{x:.3g}" for x in (trial.before, trial.after))


def _terms(offset: bool) -> dict[str, Any]:
    return {"viscous": True, "coulomb": True, "offset": offset}
