"""`decide`: a trajectory on which two explanations of a log differ most.

T-optimality (Atkinson & Fedorov, The design of experiments for discriminating between two rival models, Biometrika 62,
1975): if one explanation is true, the other is fitted to its torque as well as it can be, with all parameters of the
model free, and with its own to first order. What remains is the difference, squared in units of each joint's noise and
summed over independent samples. The design maximizes the smaller one of the two, so that neither explains the other's
data.

The torque of some effects depends on the path that led to a sample, so that there is no gradient sample by sample as
for the standard errors. Instead, segments are exchanged: all begin and end at rest in the same pose, and their
triangular factors merge, so that a trajectory with another segment costs no more than the factor of that segment.

Letters: r base parameters of the model without the explanations, k_a and k_b rows of each explanation (its derivatives
by its parameters, and its torque).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, IdtoolError
from idtool.common.linear_algebra import least_squares
from idtool.data.signals import Batch, Signals, default_cutoff
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import equality_constraints
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import empty, reduce_blocks
from idtool.estimation.uncertainty.base_parameters import structural_base_parameters
from idtool.excitation.criteria import BaseColumns
from idtool.excitation.design import Design, DesignOptions, design, predicted_signals, with_trajectory
from idtool.excitation.explanations import Explanation, ExplanationTorque, without_effects
from idtool.excitation.feasibility import scale_to_limits
from idtool.excitation.logged_data import LoggedData
from idtool.excitation.patterns import (
    PATTERNS,
    Pattern,
    PatternSpec,
    SlowSweeps,
    Standstill,
    Trajectory,
    TrajectorySegment,
)
from idtool.excitation.task import DesignTask
from idtool.robot.config import Config

_SEGMENT = 5.0  # s, about, of each segment
_MAX_SEGMENTS = 8  # that differ; a longer trajectory repeats them
_SAMPLES_PER_PERIOD = 8.0  # of the filter's cut-off, at which a segment is evaluated during the search
_KINDS = (0.6, 0.3, 0.1)  # shares of the pattern, of slow sweeps and of standstill among new segments
_MIN_SHARE = 0.01  # of a joint's largest motion in a new segment
_MIN_CHANGE = 0.03  # of a segment by a random one
_NEW = 0.5  # share of new segments; the others change one of the trajectory
_MAX_FAILURES = 50  # segments in a row for which no scale is within the limits
_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_ROUNDING = 1e-5  # of a torque: what is left of one that the model contains


@dataclass(frozen=True)
class Separation:
    """Difference of two explanations, after the one that is not true is fitted to the other.

    Attributes
    ----------
    rms
        By joint, shape (nv,) [N·m or N].
    significance
        Of all joints, in standard errors.
    relative
        Share of the true explanation's torque that remains, rms in units of the noise.
    """

    rms: Array
    significance: float
    relative: float


@dataclass(frozen=True)
class Decision:
    """Separation of two explanations on a designed trajectory, and on what it is compared with.

    Attributes
    ----------
    a, b
        The explanations.
    design, ordinary, logged
        Separation on the design, on the trajectory for the standard errors, and on the existing logs, None without any.
        With logs, the first two are those of the logs and the trajectory together.
    """

    a: Explanation
    b: Explanation
    design: Separation
    ordinary: Separation
    logged: Separation | None


class Discrimination:
    """Difference of two explanations on any data.

    Parameters
    ----------
    task
        Robot and noise.
    config
        Configuration, which may contain the explanations.
    a, b
        The explanations.
    """

    def __init__(self, task: DesignTask, config: Config, a: Explanation, b: Explanation) -> None:
        model = task.model
        common = without_effects(config, model, (*a.keys, *b.keys))
        self.config = config
        self.noise = task.noise
        self.equation = LinearModel(model.names, build_effects(model, common))
        equalities = equality_constraints(common, model, self.equation)
        base = structural_base_parameters(model, self.equation, equalities)
        self._columns = BaseColumns(self.equation, base, equalities)
        self._explanations = tuple(ExplanationTorque(model, common, explanation) for explanation in (a, b))

    def rows(self, signals: Iterable[Signals]) -> DataRows:
        """The rows of logs, reduced."""
        size_a, size_b = self._sizes
        counts = [np.arange(len(active) + size_a + size_b - 1) for active in self.equation.active()]
        reduction = empty(counts)
        for log in signals:
            reduction = reduce_blocks(map(self._block, log.batches()), reduction, log.low_pass.redundancy)
        parts = []
        for j, factor in enumerate(reduction):
            weight = np.sqrt(factor.independent / max(factor.rows, 1)) / self.noise[j]
            count = len(self.equation.active()[j])
            W = np.zeros((len(factor.R), self._columns.size + size_a + size_b))
            W[:, self._columns.joint_columns[j]] = self._columns.project(j, factor.R[:, :count].T).T
            W[:, self._columns.size :] = factor.R[:, count:]
            parts.append(weight * W)
        return DataRows(tuple(parts), np.array([factor.independent for factor in reduction]))

    def separation(self, data: Sequence[DataRows]) -> Separation:
        """The smaller one of the two differences, of all data together."""
        joints = range(len(self.noise))
        parts = [np.concatenate([rows.parts[j] for rows in data]) for j in joints]
        independent = np.sum([rows.independent for rows in data], axis=0)
        r = self._columns.size
        size_a, size_b = self._sizes
        common = np.arange(r)
        columns_a = np.arange(r, r + size_a)
        columns_b = np.arange(r + size_a, r + size_a + size_b)
        a_is_true = self._difference(parts, independent, np.append(common, columns_b), int(columns_a[-1]))
        b_is_true = self._difference(parts, independent, np.append(common, columns_a), int(columns_b[-1]))
        return min(a_is_true, b_is_true, key=lambda difference: difference.significance)

    def _difference(self, parts: Sequence[Array], independent: Array, fitted: Indices, true_torque: int) -> Separation:
        """Difference that remains of the true explanation's torque after other columns are fitted to it.

        Parameters
        ----------
        parts, independent
            Rows, and number of independent samples, as in `DataRows`.
        fitted
            Indices of the columns that are fitted: those of the model and of the other explanation.
        true_torque
            Index of the column of the true explanation's torque.
        """
        remaining = _residual(parts, fitted, true_torque)
        squares = np.array([np.square(part).sum() for part in remaining])
        rms = np.sqrt(squares / np.maximum(independent, 1.0)) * self.noise
        significance = float(np.sqrt(squares.sum()))
        torque = float(np.sqrt(sum(np.square(part[:, true_torque]).sum() for part in parts)))
        return Separation(rms, significance, significance / max(torque, 1e-300))

    @property
    def _sizes(self) -> tuple[int, int]:
        """Numbers of rows of the explanations, k_a and k_b."""
        a, b = self._explanations
        return a.size, b.size

    def _block(self, batch: Batch) -> list[Array]:
        """Filtered rows of each joint, (m_j + k_a + k_b, n), at the samples that a diagnosis uses."""
        motion = batch.motion
        torque = self.equation.torque(motion, self.equation.prior)
        rows = np.concatenate([explanation.rows(motion, torque) for explanation in self._explanations])
        columns = self.equation.columns(motion)
        blocks = []
        for j, mask in enumerate(self.equation.clean_samples(batch)):
            block = np.concatenate([columns[j][:-1], rows[:, j]])
            blocks.append(batch.filter(block)[:, mask])
        return blocks


@dataclass(frozen=True)
class DataRows:
    """Reduced rows of data in units of noise.

    Attributes
    ----------
    parts
        By joint, shape (rows, r + k_a + k_b).
    independent
        Number of independent samples by joint, shape (nv,).
    """

    parts: tuple[Array, ...]
    independent: Array

    def repeated(self, count: int) -> DataRows:
        """The rows of the same data a number of times."""
        return DataRows(tuple(np.sqrt(count) * part for part in self.parts), count * self.independent)


def _residual(parts: Sequence[Array], columns: Indices, target: int) -> list[Array]:
    """Residual of the target column after a least-squares fit of other columns, part by part."""
    rows = np.concatenate(parts)
    X = rows[:, columns]
    norms = np.linalg.norm(X, axis=0)
    norms[norms == 0] = 1.0
    X = X / norms
    solution = least_squares(X, rows[:, target], _RANK)[0]
    remaining = rows[:, target] - X @ solution
    return np.split(remaining, np.cumsum([len(part) for part in parts])[:-1])


def check_decidable(separation: Separation, a: Explanation, b: Explanation) -> None:
    """Check that the explanations differ at all.

    Raises
    ------
    ConfigError
        If one of them has no torque that the rest of the model and the other one do not have.
    """
    if separation.relative < _ROUNDING:
        what = f"the rest of the model with one of {a.name} and {b.name} explains all torque of the other on any motion"
        raise ConfigError("--decide", f"{what}; no log can decide between them")


def decide(
    ordinary: Design,
    config: Config,
    options: DesignOptions,
    logged: LoggedData | None,
    experiment: Experiment | None,
    explanations: tuple[Explanation, Explanation],
    progress: Progress,
) -> tuple[Design, Decision]:
    """Find a trajectory on which two explanations differ most.

    Parameters
    ----------
    ordinary
        The trajectory for the standard errors. It is kept if no other is found that decides better.
    config, options, logged
        As for `design`.
    experiment
        The existing logs, if any.
    explanations
        The two explanations.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    IdtoolError
        If nothing can decide between them.
    """
    task = ordinary.task
    discrimination = Discrimination(task, config, *explanations)
    progress("comparing the explanations", 0.0)
    existing: list[DataRows] = []
    logged_separation = None
    if experiment is not None:
        existing.append(discrimination.rows(run.signals for run in experiment.runs))
        logged_separation = discrimination.separation(existing)
    ordinary_rows = discrimination.rows([predicted_signals(task, config, ordinary.trajectory, task.rate)])
    check_decidable(discrimination.separation([ordinary_rows]), *explanations)
    ordinary_separation = discrimination.separation([*existing, ordinary_rows])

    search = _SegmentSearch(ordinary, config, options, discrimination, existing)
    trajectory, interrupted = search.run(progress)
    progress("predicting the standard errors", 0.0)
    rows = discrimination.rows([predicted_signals(task, config, trajectory, task.rate)])
    separation = discrimination.separation([*existing, rows])
    if separation.significance <= ordinary_separation.significance:
        trajectory, separation = ordinary.trajectory, ordinary_separation
    decision = Decision(*explanations, separation, ordinary_separation, logged_separation)
    designed = replace(
        with_trajectory(ordinary, config, trajectory, logged),
        evaluations=ordinary.evaluations + search.evaluations,
        interrupted=ordinary.interrupted or interrupted,
    )
    return designed, decision


class _SegmentSearch:
    """Search for the segments of a trajectory, one exchange after the other.

    Parameters
    ----------
    ordinary
        The trajectory for the standard errors, with the same pose at both ends.
    config, options
        The configuration, and the options of the design.
    discrimination, existing
        The criterion, and the rows of the existing logs.
    """

    def __init__(
        self,
        ordinary: Design,
        config: Config,
        options: DesignOptions,
        discrimination: Discrimination,
        existing: Sequence[DataRows],
    ) -> None:
        self.evaluations = 0
        self._task = ordinary.task
        self._config = config
        self._options = options
        self._discrimination = discrimination
        self._existing = list(existing)
        self._home = ordinary.trajectory.segments[0].pattern.home
        self._rng = np.random.default_rng(options.seed)
        self._cycles = int(np.ceil(options.duration / (_MAX_SEGMENTS * _SEGMENT)))
        cycle = options.duration / self._cycles
        self._count = int(np.clip(round(cycle / _SEGMENT), 1, _MAX_SEGMENTS))
        self._duration = cycle / self._count
        lowest = min(2 / self._duration, ordinary.max_frequency)
        self._frequencies = (lowest, ordinary.max_frequency)
        band = config.filter.cutoff_hz or default_cutoff(1 / self._task.rate)
        self._rate = min(self._task.rate, _SAMPLES_PER_PERIOD * band)

    def run(self, progress: Progress) -> tuple[Trajectory, bool]:
        """The best trajectory, and True if the search was interrupted."""
        # From many parameters, little is learnt by chance: begin with what determines them all.
        options = replace(self._options, duration=self._duration, friction_share=0.0)
        start = design(self._task, self._config, options, None, progress)
        segments = [start.trajectory.segments[0]] * self._count
        interrupted = start.interrupted
        if not interrupted:
            try:
                self._exchange(segments, progress)
            except KeyboardInterrupt:
                interrupted = True
        return Trajectory(tuple(segments) * self._cycles), interrupted

    def _exchange(self, segments: list[TrajectorySegment], progress: Progress) -> None:
        """Exchange segments in place, each for the proposal with which the explanations differ more."""
        rows = [self._rows(segments[0])] * self._count
        best = self._significance(rows)
        for i in range(self._options.iterations):
            progress("deciding", i / self._options.iterations)
            changed = None if self._rng.random() < _NEW else segments[self._rng.integers(self._count)]
            segment, own_rows = self._proposal(changed)
            exchanged = [[*rows[:k], own_rows, *rows[k + 1 :]] for k in range(self._count)]
            values = [self._significance(option) for option in exchanged]
            k = int(np.argmax(values))
            if values[k] > best:
                best = values[k]
                segments[k] = segment
                rows[k] = own_rows

    def _significance(self, rows: Sequence[DataRows]) -> float:
        data = [own_rows.repeated(self._cycles) for own_rows in rows]
        return self._discrimination.separation([*self._existing, *data]).significance

    def _proposal(self, changed: TrajectorySegment | None) -> tuple[TrajectorySegment, DataRows]:
        """A random segment, or a change of one, within all limits, and its rows."""
        for attempt in range(_MAX_FAILURES):
            proposal = self._random_segment() if changed is None else self._change(changed)
            try:
                segment = scale_to_limits(self._task, proposal)
            except IdtoolError:
                if attempt == _MAX_FAILURES - 1:
                    raise
                continue
            return segment, self._rows(segment)
        raise AssertionError

    def _rows(self, segment: TrajectorySegment) -> DataRows:
        self.evaluations += 1
        signals = predicted_signals(self._task, self._config, Trajectory((segment,)), self._rate)
        return self._discrimination.rows([signals])

    def _random_segment(self) -> TrajectorySegment:
        """A segment of random kind, frequencies and size."""
        kinds = (PATTERNS[self._options.pattern], SlowSweeps, Standstill)
        kind = kinds[self._rng.choice(len(kinds), p=_KINDS)]
        low, high = np.log(self._frequencies)
        spec = PatternSpec(
            model=self._task.model,
            limits=self._task.limits,
            home=self._home,
            duration=self._duration,
            max_frequency=float(np.exp(self._rng.uniform(low, high))),
            tip=self._options.tip,
        )
        pattern = kind(spec)
        return TrajectorySegment(pattern, self._random_motion(pattern))

    def _random_motion(self, pattern: Pattern) -> Array:
        """A motion of a pattern; half of them reduced, each joint by another factor."""
        x = pattern.draw(self._rng)
        if self._rng.random() < 0.5:
            return x
        exponents = self._rng.uniform(0, 1, len(self._home))
        return pattern.scaled(x, _MIN_SHARE**exponents)

    def _change(self, segment: TrajectorySegment) -> TrajectorySegment:
        """A segment, of which a random share is replaced by another motion of the same pattern."""
        share = _MIN_CHANGE ** self._rng.uniform(0, 1)
        x = (1 - share) * segment.x + share * self._random_motion(segment.pattern)
        return TrajectorySegment(segment.pattern, x)
