"""Online identification: the parameters updated row by row, within the chosen sets, without a look ahead.

A row is what the filter's decimation leaves: about four a period of its cut-off, however fast the log was sampled.

Composite adaptation (Slotine & Li 1989) drives the parameters by the error of the filtered torque's prediction and by
the tracking error of a controller that uses them. A log cannot react to a controller, so only the first part has a role
here, in the form of bounded-gain forgetting: `RecursiveFit` on the samples of `causal_batches`.

Unknown contact forces are eliminated by the noise of the rows in the configuration, or by a guess from the torque: to
determine it takes a fit to the whole log.

Letters: p coefficients theta, m variables x of the problem, nv joints; T reported times.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.linear_algebra import svd
from idtool.data.causal import causal_batches
from idtool.estimation.dataset.experiment import Experiment, Progress, Run, tracked
from idtool.estimation.online.recursive import RecursiveFit
from idtool.estimation.problem.problem import Problem
from idtool.robot.sets import ConstraintSet

FORGETTING = 20.0  # s
_REPORTED = 2000  # rows
_NOISE_PERIODS = 40.0  # of the band, over which a joint's noise is averaged: about eighty independent samples
_CHUNK = 1 << 21  # numbers in memory at a time
_RANK = 1e-9  # of the largest singular value: what lies below is not determined


@dataclass(frozen=True)
class Adaptation:
    """Parameters over time.

    Attributes
    ----------
    t
        Seconds of log since its first sample in the band, at which the row's last sample was there; logs one after the
        other. The first time is 0, before any data. Shape (T,).
    theta
        The coefficients then, SI, shape (T, p).
    estimate
        The last of them, shape (p,).
    units
        Typical size of each coefficient, shape (p,).
    squares, predicted
        Sum of the squared errors of the prediction one sample ahead, made before the sample was used, and number of
        such predictions; shape (nv,) each.
    forgetting
        Time constant [s].
    sets
        The constraint set of each body.
    problem
        Variables x and their constraints.
    information, pull
        The last estimate minimises ½ xᵀ information x − pullᵀ x; shapes (m, m) and (m,).
    samples
        Number of rows that were used.
    update_hz
        Rows, and so updates, per second of log; the lowest of the logs' [Hz].
    seconds
        Wall time.
    """

    t: Array
    theta: Array
    estimate: Array
    units: Array
    squares: Array
    predicted: Indices
    forgetting: float
    sets: tuple[ConstraintSet, ...]
    problem: Problem
    information: Array
    pull: Array
    samples: int
    update_hz: float
    seconds: float

    def prediction_rms(self, joints: Sequence[str]) -> dict[str, float]:
        """Root mean square error of the prediction one sample ahead by joint, and ``overall`` [N·m or N].

        It is NaN for a joint of which nothing was predicted.
        """
        squares = np.where(self.predicted > 0, self.squares / np.maximum(self.predicted, 1), np.nan)
        overall = float(np.sqrt(self.squares.sum() / max(int(self.predicted.sum()), 1)))
        return {**dict(zip(joints, np.sqrt(squares).tolist(), strict=True)), "overall": overall}


def adapt(
    experiment: Experiment, sets: Sequence[ConstraintSet], forgetting: float = FORGETTING, *, progress: Progress
) -> Adaptation:
    """Process the training parts of the logs once, sample by sample.

    Parameters
    ----------
    experiment
        Model and data.
    sets
        One set per body.
    forgetting
        Time constant with which samples lose their weight [s]; infinite: never.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    ConfigError
        If the time constant is not positive.
    LogError
        If the logs hold no sample that the filters leave.
    SolverError
        If nothing fulfils the sets and exact constraints.
    """
    if not forgetting > 0:
        raise ConfigError(
            "--forgetting", f"{forgetting:g} s is not a time constant; give a positive one, or inf for none"
        )
    started = time.perf_counter()
    kind = experiment.config.regularization.kind
    fit = RecursiveFit(experiment.equation, experiment.model, sets, kind, experiment.equalities)
    rows = _ReportedRows(experiment, fit.theta)
    for run in experiment.runs:
        low_pass = run.signals.low_pass
        step = run.signals.log.dt * low_pass.stride
        gamma, lately = float(np.exp(-step / forgetting)), min(step * run.signals.band_hz / _NOISE_PERIODS, 1.0)
        for t, W, tau, shares in _samples(experiment, run, fit.T, progress):
            for k in range(len(t)):
                fit.update(W[k], tau[k], shares[k], gamma, lately, 1 / low_pass.redundancy)
                rows.add(t[k], step, fit)
        rows.end()
    if not fit.samples:
        raise LogError(experiment.runs[0].signals.log.path, "is too short for the filters; log for longer")
    t, theta = rows.all(fit.theta)
    update_hz = min(1 / (run.signals.log.dt * run.signals.low_pass.stride) for run in experiment.runs)
    information, pull = fit.normal()
    return Adaptation(
        t=t,
        theta=theta,
        estimate=theta[-1],
        units=fit.units,
        squares=fit.squares,
        predicted=fit.predicted,
        forgetting=forgetting,
        sets=tuple(sets),
        problem=fit.problem,
        information=information,
        pull=pull,
        samples=fit.samples,
        update_hz=update_hz,
        seconds=time.perf_counter() - started,
    )


def _samples(
    experiment: Experiment, run: Run, T: Array, progress: Progress
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """A log's samples in the band: times (n,), rows on x (n, nv, m), torque (n, nv), and their shares (n, nv)."""
    equation = experiment.equation
    transform = [T[active] for active in equation.active()]
    size = max(_CHUNK // (len(transform) * T.shape[1]), 1)
    batches = causal_batches(run.signals, experiment.config.filter.order, run.train)
    for batch in tracked(batches, run.train, progress, f"adapting to {run.signals.log.path.name}"):
        t, (blocks, counted) = batch.t + run.signals.log.start, equation.counted_rows(batch)
        shares = np.stack(counted, axis=1).astype(float)
        for start in range(0, len(t), size):
            part = slice(start, start + size)
            W = np.stack([block[:-1, part].T @ to_x for block, to_x in zip(blocks, transform, strict=True)], axis=1)
            yield t[part], W, np.stack([block[-1, part] for block in blocks], axis=1), shares[part]


class _ReportedRows:
    """The estimates that are reported, of bounded number."""

    def __init__(self, experiment: Experiment, theta: Array) -> None:
        expected = sum(
            (part.stop - part.start) // run.signals.low_pass.stride + 1 for run in experiment.runs for part in run.train
        )
        self._every = max(-(-expected // _REPORTED), 1)
        self._t, self._theta = [0.0], [theta]
        self._now = self._earlier = 0.0
        self._first: float | None = None

    def add(self, t: float, step: float, fit: RecursiveFit) -> None:
        """Note the estimate after a sample [s] of a log sampled every ``step`` [s]."""
        self._first = t - step if self._first is None else self._first
        self._now = self._earlier + t - self._first
        if fit.samples % self._every == 0:
            self._t.append(self._now)
            self._theta.append(fit.theta)

    def end(self) -> None:
        """Note the end of a log."""
        self._earlier, self._first = self._now, None

    def all(self, theta: Array) -> tuple[Array, Array]:
        """Times, shape (T,), and estimates, shape (T, p), the last one included."""
        if self._t[-1] < self._now:
            self._t.append(self._now)
            self._theta.append(theta)
        return np.array(self._t), np.array(self._theta)


def convergence(adaptation: Adaptation, target: Array, rows: Array) -> Array:
    """Distance from the target over time, relative to that at the start, shape (T,).

    It is measured in the parameters' typical sizes, in the directions that the data determine, all of them alike: the
    error of the parameters, not of the torque.

    Parameters
    ----------
    adaptation
        The parameters over time.
    target
        The coefficients to come to, shape (p,).
    rows
        Rows of data on the coefficients, shape (rows, p), such as `weighted_rows` without the last column: what they
        have in their kernel has no say.
    """
    _, s, Vt = svd(rows * adaptation.units)
    B = Vt[s > _RANK * s[0]] / adaptation.units
    error = np.linalg.norm((adaptation.theta - target) @ B.T, axis=1)
    return np.asarray(error / error[0])


def time_to(t: Array, error: Array, level: float = 0.1) -> float | None:
    """The first of the times t (T,) from which on an error, shape (T,), stays at or below a level; None: never."""
    above = np.flatnonzero(error > level)
    last = int(above[-1]) + 1 if len(above) else 0
    return float(t[last]) if last < len(t) else None
