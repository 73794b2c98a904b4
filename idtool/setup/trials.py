"""Effects that the data may show, by trial: those with an `init_trial`.

Terms of joints are fitted all together; then each is left out, and stays out unless that makes the held-out torque
error of its joint larger, and what is left of it small enough that the log can be believed. Effects on the whole robot
whose value is searched, such as a delay of the torque, come first: they would pass for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.logs import JointLog
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import JointTerm, effect_types
from idtool.dynamics.effects.init_trial import InitSearch, InitTrial
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.experiment import Experiment, Progress, prepare
from idtool.estimation.row_noise import with_row_noise
from idtool.robot.config import Config, EffectEntry, Friction, parse_config
from idtool.robot.urdf.reading import Robot
from idtool.setup.records import Trial
from idtool.setup.trial_evaluator import TrialEvaluator, TrialScore

HOLDOUT = 0.3  # share at the end of every log
_WORTH = 0.02  # share by which held-out RMS must fall: less is no reason for another parameter
_ROUNDS = 12
_NARROWER, _WIDER = 0.4, 2.0
_FURTHEST = 2.0  # steps from the best so far: a parabola tells no more
_ODD = 0.5  # share of a joint's torque, rms, that no mere friction or misfit leaves unexplained
_TINY = 1e-30  # (N·m)², so that nothing is divided by zero

Data = Mapping[str, Any]


@dataclass(frozen=True)
class TrialResults:
    """Results of the trials.

    Attributes
    ----------
    values
        Values of the kept effects, by effect and joint; joint None: the whole robot.
    trials
        The trials.
    rms
        Held-out RMS with viscous and Coulomb friction alone, and with the kept effects, by joint and ``overall``.
    differentiated
        Joints whose velocity ``velocity: auto`` takes from q in some log.
    notices
        Notices for the user.
    """

    values: Mapping[tuple[str, str | None], float]
    trials: tuple[Trial, ...]
    rms: Mapping[str, Mapping[str, float]]
    differentiated: tuple[str, ...]
    notices: tuple[Notice, ...]


@dataclass(frozen=True)
class TrialTerms:
    """Terms of a variant besides rigid bodies, viscous and Coulomb friction.

    Attributes
    ----------
    on_joints
        Effects and joints of terms that are fitted.
    searched
        Effects on the whole robot, with the value of the parameter that is searched; 0: without it.
    """

    on_joints: tuple[tuple[str, str], ...] = ()
    searched: tuple[tuple[str, float], ...] = ()

    def without(self, effect: str, joint: str) -> TrialTerms:
        """A copy without one term of a joint."""
        return replace(self, on_joints=tuple(term for term in self.on_joints if term != (effect, joint)))

    def at(self, effect: str, value: float) -> TrialTerms:
        """A copy with another value of a searched parameter."""
        others = tuple(pair for pair in self.searched if pair[0] != effect)
        return replace(self, searched=(*others, (effect, value)))


def term_type(effect: str) -> type[JointTerm]:
    """Type of an effect that is tried on joints."""
    return cast(type[JointTerm], effect_types()[effect])


def trial_of(effect: str) -> InitTrial:
    """The trial of an effect."""
    return cast(InitTrial, effect_types()[effect].init_trial)


def search_of(effect: str) -> InitSearch:
    """The search for the value of an effect on the whole robot."""
    return cast(InitSearch, trial_of(effect))


class TrialRunner:
    """Variants of a configuration on some logs.

    Parameters
    ----------
    robot
        From the URDF.
    data
        The configuration so far, plain data.
    logs
        The logs.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """

    def __init__(self, robot: Robot, data: Data, logs: Sequence[JointLog], progress: Progress) -> None:
        self.robot, self.data, self.logs, self.progress = robot, data, logs, progress
        self.joints: list[str] = list(data["joints"])
        self._row_noise: Array | None = None

    def config(self, terms: TrialTerms) -> Config:
        """The configuration of a variant."""
        data = dict(self.data)
        entries: list[EffectEntry] = []
        friction = {joint: Friction().model_dump() for joint in self.joints}
        has_friction = False
        for effect, joint in terms.on_joints:
            kind = term_type(effect)
            if kind.friction_key:
                friction[joint][kind.friction_key] = True
                has_friction = True
            else:
                entries.append(kind.zero_entry(joint))
        for effect, value in terms.searched:
            if value:
                entries.append(searched_entry(effect, value))
        if has_friction:
            data["friction"] = friction
        if entries:
            data["effects"] = [*data.get("effects", ()), *(entry.model_dump() for entry in entries)]
        return parse_config(data, "trial")

    def evaluator(self, config: Config) -> TrialEvaluator:
        """A variant's logs, reduced."""
        experiment, _, _ = with_delay(prepare(self.robot, config, self.logs, holdout=HOLDOUT), self.progress)
        return TrialEvaluator(self._with_row_noise(experiment), self.progress)

    def _with_row_noise(self, experiment: Experiment) -> Experiment:
        """The experiment with the noise of its rows, which hardly depends on the variant: the first one tells it."""
        contacts = experiment.equation.contacts
        if contacts is None:
            return experiment
        if self._row_noise is None:
            experiment = with_row_noise(experiment, self.progress)
            self._row_noise = cast(ContactModel, experiment.equation.contacts).noise
            return experiment
        equation = experiment.equation.with_contacts(contacts.with_noise(self._row_noise))
        return replace(experiment, equation=equation)


def searched_entry(effect: str, value: float) -> EffectEntry:
    """Configuration entry of an effect on the whole robot at a value of the parameter that is searched."""
    return EffectEntry(effect=effect, parameters={search_of(effect).parameter: value})


def run_trials(runner: TrialRunner, on_joints: Sequence[tuple[str, str]], searched: Sequence[str]) -> TrialResults:
    """Try the effects that the data may show.

    Parameters
    ----------
    runner
        Variants.
    on_joints
        Effects and joints of terms that are tried.
    searched
        Effects on the whole robot that are tried.

    Raises
    ------
    IdtoolError
        If the logs cannot be used, or a problem could not be solved.
    """
    terms = TrialTerms(tuple(on_joints))
    evaluator = runner.evaluator(runner.config(terms))
    base, full = evaluator.score(runner.config(TrialTerms())), evaluator.score(runner.config(terms))
    trials: list[Trial] = []
    for effect in searched:
        terms, trial, evaluator, full = _search_value(runner, terms, evaluator, full, effect)
        trials.append(trial)
    kept, more = _prune(runner, terms, evaluator)
    without_terms = TrialTerms(searched=kept.searched)
    plain, last = (evaluator.score(runner.config(variant)) for variant in (without_terms, kept))
    if last.rms() > plain.rms():
        kept, last, more = without_terms, plain, [replace(trial, kept=False) for trial in more]
    values: dict[tuple[str, str | None], float] = {term: last.values[term] for term in kept.on_joints}
    values |= {(effect, None): value for effect, value in kept.searched}
    return TrialResults(
        values=values,
        trials=(*trials, *more),
        rms={"friction": _rms(runner.joints, base), "found": _rms(runner.joints, last)},
        differentiated=_differentiated(runner.joints, evaluator.experiment),
        notices=(*evaluator.experiment.notices, *_notices(runner.joints, evaluator, trials, base, last)),
    )


def _notices(
    joints: Sequence[str], evaluator: TrialEvaluator, trials: Sequence[Trial], base: TrialScore, last: TrialScore
) -> Iterator[Notice]:
    """Notices about implausible results of the trials."""
    for trial in trials:
        search = trial_of(trial.effect)
        if isinstance(search, InitSearch) and abs(trial.value) >= search.maximum:
            positive, negative = search.at_maximum
            message = positive if trial.value > 0 else negative
            message = message.format(maximum=search.shown(search.maximum))
            yield Notice("implausible_trial", "warning", None, message)
    left, grown = (np.sqrt(last.held_out / np.maximum(x, _TINY)).tolist() for x in (evaluator.torque(), base.held_out))
    odd = [f"{name} {100 * x:.0f} %" for name, x in zip(joints, left, strict=True) if x > _ODD]
    if odd:
        message = f"a large fraction of the held-out torque (rms) is unexplained: {join_names(odd)}"
        advice = "check its sign and unit (log.scale), and that the joints have the same names in log and URDF"
        yield Notice("unexplained_torque", "warning", None, message, advice)
    worse = [name for name, x in zip(joints, grown, strict=True) if x > 1 + _WORTH]
    if worse:
        message = f"the added effects increase the held-out error of {join_names(worse)}"
        meaning = "the same bodies are fitted to all joints, and the other joints improve more"
        yield Notice("joints_worse", "warning", None, message, meaning)


def _prune(runner: TrialRunner, terms: TrialTerms, evaluator: TrialEvaluator) -> tuple[TrialTerms, list[Trial]]:
    """Leave out, one after the other, the terms that the held-out torque of their joint does not need."""
    trials: list[Trial] = []
    full, most = evaluator.score(runner.config(terms)), (_ODD * np.sqrt(evaluator.torque())).tolist()
    count = len(terms.on_joints)
    for effect, joint in terms.on_joints:
        runner.progress(f"trying {effect} of {joint}", len(trials) / count)
        j, value = runner.joints.index(joint), full.values[effect, joint]
        without = terms.without(effect, joint)
        # what is that small is not missed, with the others fitted anew even less
        slight = full.share[effect, joint] ** 2 < ((1 + _WORTH) ** 2 - 1) * full.train[j]
        other = full if slight else evaluator.score(runner.config(without))
        before, after = other.rms_of(j), full.rms_of(j)
        keep = before is not None and after is not None and after < min((1 - _WORTH) * before, most[j])
        trials.append(Trial(effect, joint, value, before, after, keep))
        if not keep:
            terms, full = without, other
    return terms, trials


def _search_value(
    runner: TrialRunner, terms: TrialTerms, first: TrialEvaluator, full: TrialScore, effect: str
) -> tuple[TrialTerms, Trial, TrialEvaluator, TrialScore]:
    """Search the value of an effect with the least training error; keep it if the held-out error confirms it."""
    kind = effect_types()[effect]
    search = search_of(effect)
    known = {0.0: (first, full)}

    def cost(value: float) -> float:
        if value not in known:
            runner.progress(f"trying a {search.heading}", min(len(known) / (3 * _ROUNDS), 1.0))
            config = runner.config(terms.at(effect, value))
            evaluator = runner.evaluator(config)
            known[value] = evaluator, evaluator.score(config)
        return float(np.nanmean(known[value][1].train / np.maximum(full.train, _TINY)))

    dt = min(run.signals.log.dt for run in first.experiment.runs)
    best = _minimize(cost, search.step / first.experiment.band_hz, dt, search.maximum)
    cost(best)
    evaluator, other = known[best]
    ratio = float(np.sqrt(np.nanmean(other.held_out / np.maximum(full.held_out, _TINY))))
    believed = other.rms() < _ODD * float(np.sqrt(np.nanmean(evaluator.torque())))
    is_real = not kind.is_background(searched_entry(effect, best), dt) and abs(best) < search.maximum
    kept = is_real and ratio < 1 - _WORTH and believed
    trial = Trial(effect, None, best, full.rms(), other.rms(), kept)
    return (terms.at(effect, best), trial, evaluator, other) if kept else (terms, trial, first, full)


def _minimize(cost: Callable[[float], float], step: float, dt: float, maximum: float) -> float:
    """Minimize a cost by parabolas through three values around the best so far, to 10 µs.

    Friction that may not be negative gives way to a delay on one side only, so that the parabola is bent: it is made
    narrower until that matters no more, at half a sample time ``dt`` [s]; and wider as long as it leads further away.
    """
    best = 0.0
    for _ in range(_ROUNDS):
        a, b, c = (cost(round(best + k * step, 5)) for k in (-1, 0, 1))
        bend = a - 2 * b + c
        shift = 0.5 * (a - c) / bend if bend > 0 else (_FURTHEST if c < a else -_FURTHEST)
        shift = float(np.clip(shift, -_FURTHEST, _FURTHEST))
        best = round(float(np.clip(best + step * shift, -maximum, maximum)), 5)
        if abs(shift) < 1:
            step *= _NARROWER
        elif abs(shift) == _FURTHEST:
            step *= _WIDER
        if step < 0.5 * dt or abs(best) < 0.5 * dt:
            break
    return best


def _rms(joints: Sequence[str], verdict: TrialScore) -> dict[str, float]:
    known = {name: x for j, name in enumerate(joints) if (x := verdict.rms_of(j)) is not None}
    return {**known, "overall": verdict.rms()}


def _differentiated(joints: Sequence[str], experiment: Experiment) -> tuple[str, ...]:
    flags = np.any([run.signals.velocity_from_position for run in experiment.runs], axis=0)
    return tuple(name for name, flag in zip(joints, flags, strict=True) if flag)
