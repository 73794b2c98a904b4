"""Which of the effects that were fitted whole explains best, what the data cannot tell from it, and why others lost.

A gain counts in squared residual on blocks of time that were not fitted to, in units of the noise. Rows repeat each
other, so it takes ``inflation`` times more of it than of independent rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import Found, screened
from idtool.diagnosis.trial import Trial
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.probe import Probe
from idtool.estimation.dataset.experiment import Progress

Place = tuple[str, ...]

SURE = 5.0  # standard errors of noise that a gain must be worth: some thousand candidates compete
_EACH = 4.0  # more for each further parameter
WORTH = 0.1  # of the squared residual of a joint that an effect must explain
_EQUAL = 2.0  # standard errors within which two gains are the same
_AS_GOOD = 0.03  # of the best gain that a simpler explanation may lack
_GONE = 0.5  # of what a rival explained before, that it may explain with the winner there
_NEARLY = 0.8  # of the better gain, that one which chance may tell from it has
_SAME = 1.1  # of the squared residual that the better of two leaves


@dataclass(frozen=True)
class FittedCandidate:
    """An effect that was fitted whole.

    Attributes
    ----------
    found
        What the screening said.
    trial
        The model with it.
    gains
        What it saves of each block's squared residual, shape (F,).
    """

    found: Found
    trial: Trial
    gains: Array

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return float(self.gains.sum())


@dataclass(frozen=True)
class SelectionStep:
    """The outcome of one round.

    Attributes
    ----------
    here
        The model that it was about.
    winner
        None: nothing pays.
    equals
        What the data cannot tell from it, the best first.
    others
        The other finalists.
    lost
        Why each effect that was tried lost.
    inflation
        How many rows are worth one independent one.
    failed
        Of ``lost``, those that could not be fitted.
    """

    here: LinearizedFit
    winner: FittedCandidate | None
    equals: tuple[FittedCandidate, ...]
    others: tuple[FittedCandidate, ...]
    lost: tuple[Candidate, ...]
    inflation: float
    failed: tuple[Candidate, ...] = ()

    def alternatives(self) -> Iterator[Candidate]:
        """What came near, the best first."""
        for one in (*self.equals, *self.others):
            yield candidate(one, self.here)


def place_of(probe: Probe) -> Place:
    """What an effect is on; other sources are other effects."""
    sources = effect_types()[probe.effect].joint_parameters()
    return (*probe.subject, *(f"{probe.nonlinear_values[name]:g}" for name in sources))


def saved(before: LinearizedFit, after: LinearizedFit) -> Array:
    """What a model saves of another's squared residual on each block, shape (F,); both of the same rows."""
    return np.asarray(before.left() - after.left())


def share(gain: float, here: LinearizedFit, joints: int) -> float:
    """A gain as a share of the squared residual of so many joints."""
    return float(gain / here.left().sum() * here.s.shape[1] / joints)


def chosen(
    here: LinearizedFit,
    fitted: Sequence[FittedCandidate],
    failed: Sequence[Candidate],
    found: Sequence[Found],
    inflation: float,
    progress: Progress,
    worth: float = WORTH,
) -> SelectionStep:
    """The best of the finalists, and what became of the others.

    Parameters
    ----------
    here
        The model that they are to improve.
    fitted
        The finalists, the best first.
    failed
        Those that turned out to be no explanation.
    found
        What the screening said of all.
    inflation
        How many rows are worth one independent one.
    progress
        Told how far it has come.
    worth
        Share of a joint's squared residual that it must explain.
    """
    worthy = [one for one in fitted if _pays(one, here, inflation, worth)]
    known = {(one.effect, one.on) for one in failed} | {named(one.found.probe) for one in fitted}
    screened_out = [one for one in _best_of_all(found).values() if named(one.probe) not in known]
    lost = (*failed, *(_lost(one, here, inflation) for one in screened_out))
    lost = tuple(one for one in lost if is_answer(one.effect))
    if not worthy:
        return SelectionStep(here, None, (), tuple(fitted), lost, inflation)
    top = worthy[0]
    equals = [one for one in worthy if _as_good(one, top)]
    equals = [one for one in equals if not any(_contains(one, other) for other in equals)] or equals
    winner = min(equals, key=lambda one: (one.found.probe.complexity, -one.gain))
    others = [one for one in fitted if one is not winner and is_answer(one.found.probe.effect)]
    rivals = _rivals(others, winner, progress)
    alike = [one for one in rivals if one in worthy and _alike(one, winner) and not _contains(one, winner)]
    return SelectionStep(here, winner, tuple(alike), tuple(x for x in rivals if x not in alike), lost, inflation)


def _pays(one: FittedCandidate, here: LinearizedFit, inflation: float, worth: float) -> bool:
    probe = one.found.probe
    least = max(worth, effect_types()[probe.effect].min_explained_share)
    return worthwhile(one.gain, here, inflation, probe.joint is not None, probe.complexity, least)


def worthwhile(
    gain: float, here: LinearizedFit, inflation: float, on_joint: bool, parameters: int, worth: float = WORTH
) -> bool:
    """Whether a gain is no chance, and large enough to have an effect for it."""
    least = inflation * (SURE**2 + _EACH * (parameters - 1))
    return gain > least and share(gain, here, 1 if on_joint else here.s.shape[1]) > worth


def _as_good(one: FittedCandidate, top: FittedCandidate) -> bool:
    """Whether a contender is as good as the best but for what chance explains."""
    return top.gain - one.gain <= _AS_GOOD * top.gain and not _apart(one, top)


def _alike(one: FittedCandidate, other: FittedCandidate) -> bool:
    """Whether the data do not tell two contenders apart, by chance or since both leave as good as the same."""
    left = sorted(float(x.trial.linearized.left().sum()) for x in (one, other))
    near = min(one.gain, other.gain) > _NEARLY * max(one.gain, other.gain)
    return (near and not _apart(one, other)) or left[1] < _SAME * left[0]


def _rivals(others: Sequence[FittedCandidate], winner: FittedCandidate, progress: Progress) -> list[FittedCandidate]:
    """Those that explain the same: with the winner in the model, most of what they explained is gone."""
    if not others:
        return []
    again = screened(winner.trial.linearized, [one.found.probe for one in others], progress, "comparing explanations")
    return [one for one, now in zip(others, again, strict=True) if now.gain < _GONE * one.found.gain]


def _contains(one: FittedCandidate, other: FittedCandidate) -> bool:
    """Whether one can take the place of the other, and so explains no less by itself."""
    a, b = one.found.probe, other.found.probe
    return a.joint == b.joint and b.effect in effect_types()[a.effect].generalizes


def _apart(one: FittedCandidate, other: FittedCandidate) -> bool:
    difference = other.gains - one.gains
    error = np.sqrt(len(difference)) * difference.std(ddof=1)
    return bool(abs(difference.sum()) > _EQUAL * error)


def _best_of_all(found: Iterable[Found]) -> dict[tuple[str, ...], Found]:
    best: dict[tuple[str, ...], Found] = {}
    for one in found:
        place = place_of(one.probe)
        if place not in best or one.gain > best[place].gain:
            best[place] = one
    return best


def _lost(one: Found, here: LinearizedFit, inflation: float) -> Candidate:
    """Why a candidate did not come further, as far as the screening tells."""
    probe = one.probe
    part = share(one.gain, here, 1 if probe.joint else here.s.shape[1])
    if not probe.is_feasible(one.c):
        reason = "comes out with a sign or size that physics does not allow"
    elif one.entry is None:
        reason = "comes out beyond what such an effect can be"
    elif one.gain < SURE**2 * inflation:
        reason = "explains no more of data it was not fitted to than chance would"
    else:
        reason = f"explains {100 * part:.2g} % of what is left on its joint, less than another"
    return recorded(one, here, reason)


def is_answer(effect: str) -> bool:
    """Whether an effect is one that a diagnosis names."""
    return effect_types()[effect].reportable


def named(probe: Probe) -> tuple[str, str]:
    """A probe's effect and what it acts on, as a `Candidate` has them."""
    return probe.effect, probe.joint or probe.link or "all joints"


def recorded(one: Found, here: LinearizedFit, reason: str) -> Candidate:
    """A candidate that was only screened, for the record."""
    probe = one.probe
    score, error = _scores(one.gain, one.standard_error, probe, here)
    return Candidate(probe.effect, probe.joint, probe.link, score, error, probe.complexity, reason)


def _scores(gain: float, error: float, probe: Probe, here: LinearizedFit) -> tuple[float, float]:
    """A gain and its standard error as shares of what is left of the joints that it reaches, 1 at the most."""
    joints = 1 if probe.joint else here.s.shape[1]
    parts = share(gain, here, joints), share(error, here, joints)
    most = max(parts[0], 1.0)
    return parts[0] / most, parts[1] / most


def candidate(one: FittedCandidate, here: LinearizedFit) -> Candidate:
    """A contender for the record."""
    probe = one.found.probe
    error = float(np.sqrt(len(one.gains)) * one.gains.std(ddof=1))
    score, error = _scores(one.gain, error, probe, here)
    return Candidate(probe.effect, probe.joint, probe.link, score, error, probe.complexity)
