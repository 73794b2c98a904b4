"""The delay from command to torque, and gains, fitted before it is known what the model lacks."""

from __future__ import annotations

from idtool.common.notice import Notice
from idtool.diagnosis.trial import FAILURES, with_effects
from idtool.dynamics.effects import effect_types, friction_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.estimation.command_delay import with_delay
from idtool.estimation.controller_gains import with_gains
from idtool.estimation.dataset.experiment import Experiment, Progress


def with_unbiased_delay(experiment: Experiment, progress: Progress) -> tuple[Experiment, tuple[Notice, ...]]:
    """Experiment with the gains and the delay from command to torque, where they are to be fitted, and notices.

    A rotor that the model lacks moves the delay by milliseconds, and so it is fitted beside the effects that any joint
    may well have. The same goes for the gains.
    """
    configured = experiment.config.effects
    friction = {(key, joint.name) for joint in experiment.model.joints for key in _friction_of(experiment, joint.name)}
    present = friction | {(entry.effect, entry.joint) for entry in configured}
    commonplace = []
    for kind in effect_types().values():
        if not (kind.is_commonplace and issubclass(kind, JointEffect)):
            continue
        for j, joint in enumerate(experiment.model.joints):
            if (kind.id, joint.name) not in present and kind.may_act_on(experiment.model, j):
                commonplace.append(kind.zero_entry(joint.name))
    try:
        extended = with_effects(experiment, [*configured, *commonplace])
        fitted, notices = _with_controller(extended, progress)
    except FAILURES:
        fitted, notices = _with_controller(experiment, progress)
    return with_effects(fitted, configured), notices


def _with_controller(experiment: Experiment, progress: Progress) -> tuple[Experiment, tuple[Notice, ...]]:
    """The experiment with gains and delay, and notices about them."""
    experiment, gains = with_gains(experiment, progress)
    experiment, delay, _ = with_delay(experiment, progress)
    return experiment, tuple(notice for part in (gains, delay) if part for notice in part.notices)


def _friction_of(experiment: Experiment, joint: str) -> list[str]:
    """Ids of the effects that a joint has as its friction."""
    types = friction_types()
    return [types[key].id for key, setting in experiment.config.friction_of(joint) if setting]
