"""How far to trust a fit: standard errors, what each number rests on, whether logs agree, and the predicted torque."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import some
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.identified import Identified
from idtool.estimation.uncertainty.bias import BiasCheck, bias_check, estimates
from idtool.estimation.uncertainty.identifiability import Identifiability, identifiability
from idtool.estimation.uncertainty.prediction import Prediction, prediction
from idtool.estimation.uncertainty.repeatability import Repeatability, repeatability
from idtool.estimation.uncertainty.scatter import FEWEST, Scatter, scatter
from idtool.estimation.uncertainty.uncertainty import Uncertainty
from idtool.robot.inertia import SIZE

UNCHECKED = "least squares is not checked for bias: the logs are long, or instruments cannot be had; see --method iv"
_APART = 1.5  # ratio of two standard errors of the same, above which they do not agree


@dataclass(frozen=True)
class Trust:
    """How far to trust a fit.

    Attributes
    ----------
    theta
        The fit's coefficients, shape (p,).
    uncertainty
        Of the coefficients.
    scatter
        What it was found from.
    independent
        How many independent samples the residual holds, by joint.
    prediction
        Of the torque, on what was held out, else on the training data.
    identifiability
        What each number rests on; None: not asked for.
    repeatability
        The logs against each other; None for a single one, or where it was not asked for.
    bias
        Least squares beside instrumental variables; None where it was not asked for or would take long.
    warnings
        What a user should know, a plain sentence each.
    """

    theta: Array
    uncertainty: Uncertainty
    scatter: Scatter
    independent: Mapping[str, float]
    prediction: Prediction
    identifiability: Identifiability | None
    repeatability: Repeatability | None
    bias: BiasCheck | None
    warnings: tuple[str, ...]

    def interval(self, rows: Array) -> Array:
        """95 % intervals of combinations of the coefficients, shape (k, p) to (k, 2); infinite where not determined.

        Around the fit's value and around what the data say without prior and inequalities, which these may hold it away
        from: truth may be as far from either.
        """
        half = self.uncertainty.of(rows) * self.uncertainty.reach(rows)
        free, fitted = rows @ self.scatter.theta, rows @ self.theta
        return np.column_stack([np.minimum(free, fitted) - half, np.maximum(free, fitted) + half])

    @cached_property
    def intervals(self) -> Array:
        """The 95 % interval of every coefficient, shape (p, 2); infinite where not determined."""
        return self.interval(np.eye(len(self.theta)))

    def pull(self, rows: Array) -> Array:
        """How far prior and constraints hold combinations away from what the data say, in standard errors, shape (k,).

        Zero where the data do not determine them.
        """
        errors = self.uncertainty.of(rows)
        apart = np.abs(rows @ (self.scatter.theta - self.theta))
        return np.where(np.isfinite(errors) & (errors > 0), apart / np.maximum(errors, np.finfo(float).tiny), 0.0)


def trust(
    experiment: Experiment,
    solution: Identified,
    independent: Mapping[str, float],
    progress: Progress,
    questioned: bool,
    change: Array | None = None,
) -> Trust:
    """Question a fit.

    Parameters
    ----------
    experiment, solution
        Model and data, and what came of them.
    independent
        How many independent samples the residual holds, by joint.
    progress
        Told the stage and how far it has come.
    questioned
        Whether to ask what each number rests on, logs whether they agree, and whether noise has biased it.
    change
        Of the coefficients by one standard error of what was fitted beforehand, shape (p,); None: nothing was.
    """
    equation, model, known, estimate = experiment.equation, experiment.model, experiment.known, solution.estimate
    rng = np.random.default_rng(experiment.config.seed)
    pair = estimates(experiment, solution, progress) if solution.two_stage or questioned else None
    if pair is not None and solution.two_stage:
        found = pair.iv
    else:
        found = scatter(equation, solution.data, estimate.noise, estimate.theta, known, rng)
    errors = found.uncertainty
    if found.bootstrap is None or found.correlated:
        errors = _counted(errors, independent)
    if change is not None:
        errors = errors.with_error(change)
    held_out = any(run.held_out for run in experiment.runs)
    ahead = prediction(experiment, errors, held_out, progress)
    asked = compared = biased = None
    if questioned:
        asking = partial(progress, "asking what each number rests on")
        asked = identifiability(model, equation, known, solution.reduction, estimate, errors, asking)
        biased = bias_check(pair, asked.base) if pair is not None else None
    if asked is not None and len(solution.data) > 1:
        progress("comparing logs", 0.0)
        noise, theta, base = estimate.noise, estimate.theta, asked.base
        compared = repeatability(equation, solution.data, noise, theta, known, base, solution.theta_of, rng)
    warnings = (
        *_of_blocks(found, solution.data),
        *_of_logs(compared),
        *_of_masses(asked, experiment),
        *_of_bias(biased, solution.two_stage is not None),
        *([UNCHECKED] if questioned and pair is None else []),
        *_of_prediction(ahead, equation.joints),
    )
    return Trust(estimate.theta, errors, found, independent, ahead, asked, compared, biased, warnings)


def _of_masses(asked: Identifiability | None, experiment: Experiment) -> Iterator[str]:
    """Masses that a scale would tell and the torque does not."""
    if asked is None or experiment.config.known.total_mass is not None:
        return
    names = [body.name for body in experiment.model.bodies]
    untold = [name for name, basis in zip(names, asked.bases[::SIZE], strict=True) if basis.on == "prior"]
    if untold:
        yield f"the torque does not tell the mass of {some(untold)}: weigh what moves and give known.total_mass"


def _counted(errors: Uncertainty, independent: Mapping[str, float]) -> Uncertainty:
    """No smaller standard errors than the number of independent samples gives, where blocks are few or short."""
    count, seen = float(np.mean(list(independent.values()))), errors.directions
    wanted = max(seen.independent / count, 1.0) if count else 1.0
    had = float(np.trace(errors.spread)) * seen.worth / max(len(errors.spread), 1)
    return replace(errors, spread=errors.spread * max(wanted / had, 1.0)) if had else errors


def _of_blocks(found: Scatter, data: Sequence[Blocks]) -> list[str]:
    if found.bootstrap is None:
        seconds = sum(len(log) * log.seconds for log in data)
        few = f"{seconds:.2g} s are less than the {FEWEST} blocks it takes to see how the residual scatters"
        return [f"{few}: standard errors follow from its spectrum alone; log for longer"]
    said = []
    if found.correlated:
        long = f"the residual is correlated for longer than the {found.seconds:.2g} s that a block can last here"
        said.append(f"{long}: standard errors may be too small; log for longer, or model what is missing")
    pair = [np.sqrt(np.diag(u.spread)) for u in (found.bootstrap, found.uncertainty)]
    apart = float(np.median(pair[0] / np.maximum(pair[1], np.finfo(float).tiny))) if len(pair[0]) else 1.0
    if not 1 / _APART < apart < _APART:
        said.append(
            f"resampled standard errors are {apart:.2g} times the analytic ones: trust neither to a factor of two"
        )
    return said


def _of_logs(compared: Repeatability | None) -> list[str]:
    if compared is None:
        return []
    copies = compared.copies
    again = [f"data that are given twice make intervals too short; leave out {some(copies)}"] if copies else []
    if compared.agrees.all():
        return again
    count = int(np.count_nonzero(~compared.agrees))
    said = f"{count} of {len(compared.agrees)} base parameters differ between logs by more than their intervals"
    if compared.odd is not None:
        return [*again, f"{said}; the odd one out is {compared.logs[compared.odd]}"]
    return [*again, f"{said}: intervals from these logs together are too short for them"]


def _of_bias(biased: BiasCheck | None, instrumental: bool) -> list[str]:
    if biased is None:
        return []
    unchecked = "instruments are weak, so that least squares is not checked for bias"
    weak = [f"{unchecked}: {some(biased.weak)}"] if biased.weak and not instrumental else []  # else said before
    if not biased.differs.any():
        return weak
    count = int(np.count_nonzero(biased.differs))
    said = f"{count} of {len(biased.differs)} base parameters differ between least squares and instrumental variables"
    advice = "" if instrumental else ": noise in q and v biases them, or the model lacks something; see --method iv"
    return [*weak, f"{said} by more than their intervals{advice}"]


def _of_prediction(ahead: Prediction, joints: Sequence[str]) -> list[str]:
    blind = [name for name, share in zip(joints, ahead.unknown, strict=True) if share > 0.01]
    what = "moves as the fitted logs did not, in directions that their data do not determine"
    return [f"held-out motion of {some(blind)} {what}"] if blind else []
