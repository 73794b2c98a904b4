"""Terms that the data may show: offsets, reflected rotor inertia and a delay of the torque, by trial.

All are fitted together; then each is left out, and stays out unless that makes the held-out torque error of its joint
larger, and what is left of it small enough that the log can be believed. A delay is looked for first: it would pass for
the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from idtool.common.names import some
from idtool.common.notice import Notice
from idtool.data.logs import Log
from idtool.dynamics.effects.time_delay import MIN_DELAY_SAMPLES
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.experiment import Experiment, Progress, prepare
from idtool.robot.config import Config, parse_config
from idtool.robot.urdf.reading import Robot
from idtool.setup.records import Trial
from idtool.setup.trial_evaluator import TrialEvaluator, Verdict

HOLDOUT = 0.3  # share at the end of every log
_WORTH = 0.02  # share by which held-out RMS must fall: less is no reason for another parameter
_STEP = 0.05  # periods of the band's edge, of a delay that is tried: the error is a parabola within
_LONGEST = 0.1  # s, of a delay
_ROUNDS = 12
_NARROWER, _WIDER = 0.4, 2.0
_FURTHEST = 2.0  # steps from the best so far: a parabola tells no more
_ODD = 0.5  # share of a joint's torque, rms, that no mere friction or misfit leaves unexplained
_TINY = 1e-30  # (N·m)², so that nothing is divided by zero

Data = Mapping[str, Any]


@dataclass(frozen=True)
class Found:
    """What trials found.

    Attributes
    ----------
    offsets
        Joints with an offset.
    inertia
        Reflected rotor inertia by joint [kg·m² or kg].
    delay
        Of the torque [s]; 0: none.
    trials
        What was tried.
    rms
        Held-out RMS with viscous and Coulomb friction alone, and with what was found, by joint and ``overall``.
    differentiated
        Joints whose velocity ``velocity: auto`` takes from q in some log.
    notices
        What a user should know.
    """

    offsets: tuple[str, ...]
    inertia: Mapping[str, float]
    delay: float
    trials: tuple[Trial, ...]
    rms: Mapping[str, Mapping[str, float]]
    differentiated: tuple[str, ...]
    notices: tuple[Notice, ...]


@dataclass(frozen=True)
class TrialTerms:
    """What a variant has beside rigid bodies, viscous and Coulomb friction: joints by term, and the delay [s]."""

    offsets: tuple[str, ...] = ()
    rotors: tuple[str, ...] = ()
    delay: float = 0.0

    def without(self, effect: str, joint: str) -> TrialTerms:
        """The same less one term of a joint."""
        if effect == "torque_offset":
            return replace(self, offsets=tuple(name for name in self.offsets if name != joint))
        return replace(self, rotors=tuple(name for name in self.rotors if name != joint))


class TrialRunner:
    """Variants of a configuration on some logs.

    Parameters
    ----------
    robot
        From the URDF.
    data
        The configuration so far, plain data.
    logs
        What was read of the logs.
    progress
        Told the stage and how far it has come.
    """

    def __init__(self, robot: Robot, data: Data, logs: Sequence[Log], progress: Progress) -> None:
        self.robot, self.data, self.logs, self.progress = robot, data, logs, progress
        self.joints: list[str] = list(data["joints"])

    def config(self, terms: TrialTerms) -> Config:
        """A variant."""
        data, offsets, rotors, delay = dict(self.data), terms.offsets, terms.rotors, terms.delay
        if offsets:
            data["friction"] = {j: {"viscous": True, "coulomb": True, "offset": j in offsets} for j in self.joints}
        entries = [{"effect": "rotor_inertia", "joint": j, "parameters": {"inertia": 0.0}} for j in rotors]
        if delay:
            entries.append({"effect": "time_delay", "parameters": {"delay": delay}})
        if entries:
            data["effects"] = [*data.get("effects", ()), *entries]
        return parse_config(data, "trial")

    def bench(self, config: Config) -> TrialEvaluator:
        """A variant's logs, reduced."""
        experiment, _, _ = with_delay(prepare(self.robot, config, self.logs, holdout=HOLDOUT), self.progress)
        return TrialEvaluator(experiment, self.progress)


def try_out(shop: TrialRunner, offsets: bool, rotors: Sequence[str], delays: bool) -> Found:
    """Try what the data may show.

    Parameters
    ----------
    shop
        Variants.
    offsets
        Whether offsets are tried.
    rotors
        Joints on which a rotor's inertia is tried.
    delays
        Whether a delay is tried.

    Raises
    ------
    IdtoolError
        If the logs cannot be used, or a problem could not be solved.
    """
    terms = TrialTerms(tuple(shop.joints) if offsets else (), tuple(rotors))
    bench = shop.bench(shop.config(terms))
    base, full = bench.judge(shop.config(TrialTerms())), bench.judge(shop.config(terms))
    trials: list[Trial] = []
    if delays:
        terms, trials, bench = _delay(shop, terms, bench, full)
    kept, more = _pruned(shop, terms, bench)
    plain, last = (bench.judge(shop.config(variant)) for variant in (TrialTerms(delay=kept.delay), kept))
    if last.rms() > plain.rms():
        kept, last, more = TrialTerms(delay=kept.delay), plain, [replace(trial, kept=False) for trial in more]
    return Found(
        offsets=kept.offsets,
        inertia={j: last.values["rotor_inertia", j] for j in kept.rotors},
        delay=kept.delay,
        trials=(*trials, *more),
        rms={"friction": _rms(shop.joints, base), "found": _rms(shop.joints, last)},
        differentiated=_differentiated(bench.experiment),
        notices=(*bench.experiment.notices, *_notices(shop.joints, bench, trials, base, last)),
    )


def _notices(
    joints: Sequence[str], bench: TrialEvaluator, trials: Sequence[Trial], base: Verdict, last: Verdict
) -> Iterator[Notice]:
    """What speaks against what was found."""
    for trial in trials:
        if trial.effect == "time_delay" and abs(trial.value) >= _LONGEST:
            late = "late" if trial.value > 0 else "early"
            message = (
                f"the torque fits best when {1e3 * _LONGEST:.0f} ms {late} or more, which is no delay of a recording"
            )
            yield Notice("implausible_delay", "warning", None, message)
    left, grown = (np.sqrt(last.held_out / np.maximum(x, _TINY)).tolist() for x in (bench.torque(), base.held_out))
    odd = [f"{name} {x:.0%}" for name, x in zip(joints, left, strict=True) if x > _ODD]
    if odd:
        message = f"of the held-out torque, this share is left unexplained (rms): {some(odd)}"
        advice = "check its sign and unit (log.scale), and that log and URDF name the joints alike"
        yield Notice("unexplained_torque", "warning", None, message, advice)
    worse = [name for name, x in zip(joints, grown, strict=True) if x > 1 + _WORTH]
    if worse:
        message = f"what was found makes the held-out error larger of {some(worse)}"
        meaning = "one set of bodies is fitted to all joints, and the others gained more"
        yield Notice("joints_worse", "warning", None, message, meaning)


def _pruned(shop: TrialRunner, terms: TrialTerms, bench: TrialEvaluator) -> tuple[TrialTerms, list[Trial]]:
    """The terms without those that the held-out torque of their joint does not need, left out one after the other."""
    trials: list[Trial] = []
    full, most = bench.judge(shop.config(terms)), (_ODD * np.sqrt(bench.torque())).tolist()
    for effect, joint in [
        *(("rotor_inertia", j) for j in terms.rotors),
        *(("torque_offset", j) for j in terms.offsets),
    ]:
        shop.progress(f"trying {effect} of {joint}", len(trials) / (len(terms.rotors) + len(terms.offsets)))
        j, value = shop.joints.index(joint), full.values[effect, joint]
        without = terms.without(effect, joint)
        # what is that small is not missed, with the others fitted anew even less
        slight = full.share[effect, joint] ** 2 < ((1 + _WORTH) ** 2 - 1) * full.train[j]
        other = full if slight else bench.judge(shop.config(without))
        before, after = other.rms_of(j), full.rms_of(j)
        keep = before is not None and after is not None and after < min((1 - _WORTH) * before, most[j])
        trials.append(Trial(effect, joint, value, before, after, keep))
        if not keep:
            terms, full = without, other
    return terms, trials


def _delay(
    shop: TrialRunner, terms: TrialTerms, first: TrialEvaluator, full: Verdict
) -> tuple[TrialTerms, list[Trial], TrialEvaluator]:
    """The delay at which the training error is least, where the held-out error says so too."""
    known = {0.0: (first, full)}

    def cost(delay: float) -> float:
        if delay not in known:
            shop.progress("trying a delay of the torque", min(len(known) / (3 * _ROUNDS), 1.0))
            config = shop.config(replace(terms, delay=delay))
            bench = shop.bench(config)
            known[delay] = bench, bench.judge(config)
        return float(np.mean(known[delay][1].train / np.maximum(full.train, _TINY)))

    dt = min(run.signals.log.dt for run in first.experiment.runs)
    best = _least(cost, _STEP / first.experiment.band_hz, dt)
    cost(best)
    bench, other = known[best]
    ratio = float(np.sqrt(np.nanmean(other.held_out / np.maximum(full.held_out, _TINY))))
    believed = other.rms() < _ODD * float(np.sqrt(np.nanmean(bench.torque())))
    kept = MIN_DELAY_SAMPLES * dt < abs(best) < _LONGEST and ratio < 1 - _WORTH and believed
    trial = Trial("time_delay", None, best, full.rms(), other.rms(), kept)
    return (replace(terms, delay=best), [trial], bench) if kept else (terms, [trial], first)


def _least(cost: Callable[[float], float], step: float, dt: float) -> float:
    """Where the cost is least, by parabolas through three values around the best so far; to 10 µs.

    Friction that may not be negative gives way to a delay on one side only, so that the parabola is bent: it is made
    narrower until that matters no more, at half a sample time ``dt`` [s]; and wider as long as it leads further away.
    """
    best = 0.0
    for _ in range(_ROUNDS):
        a, b, c = (cost(round(best + k * step, 5)) for k in (-1, 0, 1))
        bend = a - 2 * b + c
        shift = 0.5 * (a - c) / bend if bend > 0 else (_FURTHEST if c < a else -_FURTHEST)
        shift = float(np.clip(shift, -_FURTHEST, _FURTHEST))
        best = round(float(np.clip(best + step * shift, -_LONGEST, _LONGEST)), 5)
        if abs(shift) < 1:
            step *= _NARROWER
        elif abs(shift) == _FURTHEST:
            step *= _WIDER
        if step < 0.5 * dt or abs(best) < 0.5 * dt:
            break
    return best


def _rms(joints: Sequence[str], verdict: Verdict) -> dict[str, float]:
    known = {name: x for j, name in enumerate(joints) if (x := verdict.rms_of(j)) is not None}
    return {**known, "overall": verdict.rms()}


def _differentiated(experiment: Experiment) -> tuple[str, ...]:
    flags = np.any([run.signals.differentiated for run in experiment.runs], axis=0)
    return tuple(name for name, flag in zip(experiment.equation.joints, flags, strict=True) if flag)
