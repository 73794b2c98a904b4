"""A model with a further effect in it, fitted whole, its shape values moved to where they explain most.

Shape values are found by Gauss and Newton's method on what the linear coefficients leave (variable projection; Golub &
Pereyra 1973, in the form of Kaufman 1975): the change of the residual with a shape value is one more column, judged by
`screened` as any other, which gives the step and its standard error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import IdtoolError
from idtool.data.signals import Motion
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.screen import screened
from idtool.diagnosis.survey import survey
from idtool.dynamics.effects import build_effects, effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import Constraint, equality_constraints
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry, Regularization
from idtool.robot.inertia import PI_SIZE

Key = tuple[int, str]  # place in the configuration's effects, and name of a parameter

FAILURES = (IdtoolError, np.linalg.LinAlgError)  # of a model that cannot be fitted

_STEP = 1e-3  # of a shape value, or this where it is small: of a difference
_FAR = 0.3  # of a value that a step goes at the most
_BETTER = 1e-4  # of the squared residual that a step must save
_BEYOND = 2.0  # times the values tried, that a shape value may move
_SCAN = (0.8, 0.86, 0.93, 1.0, 1.07, 1.15, 1.24)  # of a value, that are tried
_AS_GOOD = 0.9  # of the largest gain


def reason_of(failure: Exception) -> str:
    """What a failure says, without the file or key that it is about."""
    return failure.what if isinstance(failure, IdtoolError) else "its equations have no solution"


@dataclass(frozen=True)
class Trial:
    """A model with effects in it.

    Attributes
    ----------
    linearized
        What it leaves.
    errors
        Standard errors of the shape values, by place in the configuration's effects and name.
    ranges
        Within which shape values were moved, by the same.
    """

    linearized: LinearizedFit
    errors: Mapping[Key, float]
    ranges: Mapping[Key, tuple[float, float]]

    @property
    def entries(self) -> tuple[EffectEntry, ...]:
        """The configuration's effects."""
        return self.linearized.experiment.config.effects


def with_effects(experiment: Experiment, entries: Sequence[EffectEntry], theta: Array | None = None) -> Experiment:
    """The same logs and robot, with other effects in the torque equation; inertia that was fixed stays so.

    Parameters
    ----------
    experiment
        Model and data.
    entries
        All effects of the configuration.
    theta
        What the experiment's coefficients are by now, shape (p,), for effects that need to know the model.
    """
    config = experiment.config.model_copy(update={"effects": tuple(entries)})
    now = experiment.equation.operating_point
    if theta is not None:
        now = {c.key: float(x) for c, x in zip(experiment.equation.coefficients, theta, strict=True)}
    equation = LinearModel(experiment.model.names, build_effects(experiment.model, config), now)
    equalities = equality_constraints(config, experiment.model, equation)
    changed = replace(experiment, config=config, equation=equation, equalities=equalities)
    return with_fixed_inertia(changed) if is_fixed(experiment) else changed


_FIXED = "--inertia fixed"


def with_fixed_inertia(experiment: Experiment) -> Experiment:
    """The same with the bodies' parameters known to be those of the URDF."""
    p, equalities = len(experiment.equation.coefficients), experiment.equalities
    prior, count = experiment.equation.prior, PI_SIZE * len(experiment.model.bodies)
    inertia = tuple(Constraint(_FIXED, np.eye(p)[i], float(prior[i])) for i in equalities.free if i < count)
    nothing = Regularization(kind="none", weight=0)  # left for a prior to say
    config = experiment.config.model_copy(update={"constraints": "none", "regularization": nothing})
    others = tuple(c for c in equalities.constraints if c.row[count:].any())  # others speak of what is fixed
    return replace(experiment, config=config, equalities=replace(equalities, constraints=(*others, *inertia)))


def is_fixed(experiment: Experiment) -> bool:
    """Whether the bodies' parameters are the URDF's."""
    return any(constraint.label == _FIXED for constraint in experiment.equalities.constraints)


def tried(
    before: LinearizedFit, entries: Sequence[EffectEntry], moving: Sequence[int], progress: Progress, steps: int = 1
) -> Trial:
    """A model with other effects, fitted with the same weights.

    Parameters
    ----------
    before
        The model that it is compared with.
    entries
        All effects that it has.
    moving
        Indices of those whose shape values are moved.
    progress
        Told how far it has come.
    steps
        How often they are.

    Raises
    ------
    IdtoolError, LinAlgError
        If it cannot be fitted; see `FAILURES`.
    """
    here = linearize_fit(with_effects(before.experiment, entries, before.theta), progress, before)
    errors: dict[Key, float] = {}
    ranges = _ranges(before, entries, moving)
    for i in moving:
        for name in effect_types()[entries[i].effect].grid_parameters():
            here, errors[i, name] = _scanned(here, i, name, progress)
    for _ in range(steps):
        names = [(i, name) for i in moving for name in _moved(here.experiment.config.effects[i])]
        if not names:
            break
        there, found = _step(here, names, ranges, progress)
        errors |= found
        if there is None:
            break
        better = here.left().sum() - there.left().sum() > _BETTER * here.left().sum()
        here = there if there.left().sum() < here.left().sum() else here
        if not better:
            break
    return Trial(here, errors, ranges)


def _ranges(
    before: LinearizedFit, entries: Sequence[EffectEntry], moving: Sequence[int]
) -> dict[Key, tuple[float, float]]:
    """Those about all values that a search tries, of parameters that are sizes."""
    seen, found = survey(before), {}
    for i in moving:
        kind, joint = effect_types()[entries[i].effect], entries[i].joint
        if not issubclass(kind, JointEffect) or joint is None:
            continue
        shapes = list(kind.trial_values(seen, seen.model.names.index(joint)))
        for name in shapes[0] if shapes else ():
            values = [shape[name] for shape in shapes]
            if _is_positive(kind.id, name):
                found[i, name] = (min(values) / _BEYOND, max(values) * _BEYOND)
        found |= {
            (i, held.name): (0.0, held.optional_maximum)
            for held in kind.nonlinear_parameters
            if held.optional_maximum is not None
        }
    return found


def _moved(entry: EffectEntry) -> list[str]:
    names = effect_types()[entry.effect].gradient_parameters()
    return [name for name in names if isinstance(value_of(entry, name), float)]


def value_of(entry: EffectEntry, name: str) -> object:
    """A parameter's value, without its standard error; ``com.0`` is the first of the list ``com``; None without it."""
    name, _, at = name.partition(".")
    given = entry.parameters.get(name)
    given = given["value"] if isinstance(given, Mapping) else given
    return given[int(at)] if at and given is not None else given


def _with(entry: EffectEntry, name: str, value: float) -> EffectEntry:
    name, _, at = name.partition(".")
    given = [value if k == int(at) else x for k, x in enumerate(entry.parameters[name])] if at else value
    return entry.model_copy(update={"parameters": {**entry.parameters, name: given}})


def _step(
    here: LinearizedFit, names: Sequence[Key], ranges: Mapping[Key, tuple[float, float]], progress: Progress
) -> tuple[LinearizedFit | None, dict[Key, float]]:
    """One step of all shape values together, half of it, or none; and their standard errors."""
    entries = list(here.experiment.config.effects)
    values = [float(value_of(entries[i], name)) for i, name in names]  # type: ignore[arg-type]
    steps = [_STEP * max(abs(value), 0.1) for value in values]
    tops = [ranges.get(key, (-np.inf, np.inf))[1] for key in names]
    steps = [step if value + step < top else -step for value, step, top in zip(values, steps, tops, strict=True)]
    (found,) = screened(here, [_difference(here, names, values, steps)], progress, "moving shape values")
    spread = np.sqrt(np.diag(found.covariance))
    errors = {key: float(x) for key, x in zip(names, spread, strict=True)}
    for part in (1.0, 0.3):
        changed = list(entries)
        for (i, name), value, by in zip(names, values, part * found.c, strict=True):
            most = _FAR * max(abs(value), _STEP)
            positive = value > 0 and _is_positive(entries[i].effect, name)
            limited = float(np.clip(by, -most, most)) if positive or abs(value) > 0.1 else by
            moved = np.clip(value + limited, *ranges.get((i, name), (-np.inf, np.inf)))
            changed[i] = _with(changed[i], name, float(moved))
        try:
            there = linearize_fit(with_effects(here.experiment, changed, here.theta), progress, here)
        except FAILURES:
            continue
        if there.left().sum() < here.left().sum():
            return there, errors
    return None, errors


def _scanned(here: LinearizedFit, i: int, name: str, progress: Progress) -> tuple[LinearizedFit, float]:
    """The value about the present one that explains most, how far it may be off, and the model with it."""
    entries = list(here.experiment.config.effects)
    entry, others = entries[i], [*entries[:i], *entries[i + 1 :]]
    without = linearize_fit(with_effects(here.experiment, others, here.theta), progress, here, own_rows=True)
    kind, seen = effect_types()[entry.effect], survey(without)
    joint = here.experiment.equation.joints.index(str(entry.joint))
    values = [ratio * float(value_of(entry, name)) for ratio in _SCAN]  # type: ignore[arg-type]
    shape = {held.name: value_of(entry, held.name) or 0.0 for held in kind.nonlinear_parameters}
    probes = [kind.probe(seen, joint, {**shape, name: value}) for value in values]  # type: ignore[attr-defined]
    gains = [one.gain for one in screened(without, probes, progress, "trying values")]
    best = values[int(np.argmax(gains))]
    near = max(gains) - (1 - _AS_GOOD) * abs(max(gains))
    alike = [value for value, gain in zip(values, gains, strict=True) if gain >= near]
    entries[i] = _with(entry, name, best)
    error = max(max(alike) - min(alike), best * (_SCAN[1] / _SCAN[0] - 1)) / 2
    return linearize_fit(with_effects(here.experiment, entries, here.theta), progress, here), error


def _is_positive(effect: str, name: str) -> bool:
    held = effect_types()[effect].nonlinear_parameters
    return any(one.name == name and one.positive for one in held)


def _difference(here: LinearizedFit, names: Sequence[Key], values: Sequence[float], steps: Sequence[float]) -> Probe:
    """The change of the residual with shape values, as a probe."""
    others = []
    for (i, name), value, step in zip(names, values, steps, strict=True):
        entries = list(here.experiment.config.effects)
        entries[i] = _with(entries[i], name, value + step)
        others.append(with_effects(here.experiment, entries, here.theta).equation)

    def columns(motion: Motion, present: Linearization) -> Mapping[int, Array]:
        change = [
            (present.residual - LinearizedModel(other, here.theta, present.measured_motion).residual) / step
            for other, step in zip(others, steps, strict=True)
        ]
        return {j: np.stack([rows[j] for rows in change]) for j in range(len(motion.q))}

    return Probe("shape", None, None, columns, len(names), lambda c, information: None)
