"""Whether noise in q and v has biased a fit: least squares beside an estimate by instrumental variables.

Both are made from the same rows, so that what moves one moves the other; the error of their difference is the scatter
of the difference of their blocks' influences: Hausman's test (1978) without his assumption that one of them is
efficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from scipy import stats

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ModelError
from idtool.estimation.dataset.blocks import Blocks, together
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.identified import Identified
from idtool.estimation.instruments import Instruments, Kind, instrumented_rows, instruments
from idtool.estimation.two_stage import unprojected, weak_joints
from idtool.estimation.uncertainty.base import BaseParameters
from idtool.estimation.uncertainty.scatter import Scatter, scatter

_RANK = 1e-8  # of the largest singular value of scaled columns: less is rounding
_LONGEST = 60.0  # s of closed loop that are simulated only to see whether least squares is biased
_LONGEST_SMOOTHED = 600.0  # s that are smoothed for it: they are held in memory
_FALSE = 0.05  # of the parameters that are said to differ


@dataclass(frozen=True)
class BiasCheck:
    """Two estimates of the base parameters, without prior and inequalities; r of them.

    Attributes
    ----------
    kind
        What the instruments are.
    iterations
        How often they were made.
    ls, iv
        Least squares and instrumental variables, shape (r,); NaN where the data do not determine one of them.
    standard_error
        Of their difference, shape (r,).
    differs
        Whether it is more than chance explains, and least squares outside the other's 95 % interval; shape (r,).
    weak
        Joints whose instruments tell too little for a difference to be seen.
    """

    kind: Kind
    iterations: int
    ls: Array
    iv: Array
    standard_error: Array
    differs: Mask
    weak: tuple[str, ...] = ()


@dataclass(frozen=True)
class Pair:
    """Two estimates from the same blocks, what instruments are, how often they were made and where they are weak."""

    ls: Scatter
    iv: Scatter
    kind: Kind
    iterations: int
    weak: tuple[str, ...]


def estimates(experiment: Experiment, solution: Identified, progress: Progress) -> Pair | None:
    """Least squares and instrumental variables; None where instruments would take long or there are none.

    Parameters
    ----------
    experiment, solution
        Model and data, and what came of them.
    progress
        Told the stage and how far it has come.
    """
    found, theta, noise = solution.two_stage, solution.estimate.theta, solution.estimate.noise
    if found is not None:
        made = found.instruments
    elif _seconds(experiment) > (_LONGEST if experiment.config.controller else _LONGEST_SMOOTHED):
        return None
    else:
        try:
            made = tuple(instruments(experiment, run, theta, progress) for run in experiment.runs if run.train)
        except ModelError:  # which the report on the simulation says
            return None
    data = instrumented(experiment, made, progress)
    iv = scattered(experiment, data, "iv", noise, theta)
    ls = scattered(experiment, data, "ls", noise, theta, iv.joined)
    kind: Kind = "smoothed" if any(one.kind == "smoothed" for one in made) else "closed_loop"
    weak = weak_joints(experiment.equation, together([log.total for log in data]), noise, theta)
    return Pair(ls, iv, kind, found.iterations if found else 1, tuple(weak))


def _seconds(experiment: Experiment) -> float:
    """How long the training data are [s]."""
    return float(sum((part.stop - part.start) * run.signals.log.dt for run in experiment.runs for part in run.train))


def instrumented(experiment: Experiment, made: Sequence[Instruments], progress: Progress) -> tuple[Blocks, ...]:
    """The training data as R-factors of [Z_j, Y_j, tau_j] of consecutive blocks, log by log."""
    of_run = {id(one.run): one for one in made}
    return experiment.blocks(lambda run: instrumented_rows(experiment, of_run[id(run)], progress))


def scattered(
    experiment: Experiment,
    data: Sequence[Blocks],
    method: Literal["ls", "iv"],
    noise: Array,
    theta: Array,
    joined: int | None = None,
) -> Scatter:
    """Standard errors from blocks of [Z_j, Y_j, tau_j]; see `scatter`."""
    known, equation = experiment.known, experiment.equation
    ask = partial(scatter, equation, noise=noise, theta=theta, known=known, joined=joined)
    rng = np.random.default_rng(experiment.config.seed)
    if method == "iv":
        return ask(data, rng=rng, first_stage=_nearest(together([log.total for log in data])))
    return ask([log.of(unprojected) for log in data], rng=rng)


def _nearest(stacked: Reduction) -> list[Array]:
    """By joint, what Z_j is multiplied with to come nearest to Y_j, shape (m_j, m_j)."""
    found = []
    for factor in stacked:
        Z, Y = np.split(factor.R[:, :-1], 2, axis=1)
        size = np.linalg.norm(Z, axis=0)
        size[size == 0] = 1.0
        found.append(np.linalg.lstsq(Z / size, Y, rcond=_RANK)[0] / size[:, None])
    return found


def bias_check(pair: Pair, base: BaseParameters) -> BiasCheck:
    """Compare two estimates, base parameter by base parameter."""
    rows, ls, iv = base.B, pair.ls, pair.iv
    sees = np.isfinite(ls.uncertainty.of(rows)) & np.isfinite(iv.uncertainty.of(rows))
    values = [np.where(sees, rows @ one.theta, np.nan) for one in (ls, iv)]
    error = np.sqrt(np.square((ls.influence - iv.influence) @ rows.T).sum(axis=0))
    error *= np.sqrt(ls.blocks / max(ls.blocks - 1, 1))
    apart = np.abs(values[0] - values[1])
    freedom = np.minimum(ls.uncertainty.freedom(rows), iv.uncertainty.freedom(rows))
    t = apart / np.where(error > 0, error, np.inf)
    differs = np.zeros(len(rows), dtype=bool)
    if sees.any():
        differs[sees] = stats.false_discovery_control(2 * stats.t.sf(t[sees], freedom[sees])) < _FALSE
    differs &= apart > iv.uncertainty.reach(rows) * iv.uncertainty.of(rows)
    return BiasCheck(pair.kind, pair.iterations, values[0], values[1], error, differs, pair.weak)
