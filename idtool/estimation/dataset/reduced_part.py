"""`ReducedPart`: what is kept of a part of a log for fits and their evaluation. It does not grow with the log.

Letters: m_j coefficients of row j, Y_j (n, m_j) its columns and tau_j its torque in the band, at n filtered samples of
N at the logged rate; measured: the measured torque in the band; above: the logged torque less that, without what
decimation would fold into the band.
"""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.data.filters import LowPass
from idtool.data.signals import Batch, Signals
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.regrouping import RegroupedModel
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.blocks import merge_reductions
from idtool.estimation.dataset.drawn_rows import DrawnRows, merged_draws
from idtool.estimation.dataset.envelope import Envelope
from idtool.estimation.dataset.extreme_rows import ExtremeRows
from idtool.estimation.dataset.reduction import Factor, Reduction, empty, merge, with_all_columns


@dataclass
class ReducedPart:
    """R-factors, sums and chosen rows of a part of a log, for fitting or for validation.

    Attributes
    ----------
    excluded
        R-factors of [Y_j, tau_j, above_j] of the rows that don't count in a fit.
    posture
        Positions in stretches of time, for drawing.
    extremes
        Rows [Y_j, tau_j, measured_j] in the same stretches of time.
    is_compared
        Mask of the rows of the equation in which measurement and model are compared, shape (nv,).
    torque_sums
        Sums of the measured torque and of its square over the N samples, shape (2, nv).
    squares_above_band
        Sum of squares of the torque above the band over the N samples, shape (nv,).
    drawn
        Rows that were drawn at random; none if no draws were asked for.
    samples, rows
        Number of samples at the logged rate, N, and of filtered ones, n.
    blocks
        R-factors of [Y_j, tau_j, above_j] of the rows that count, by number of the block of time.
    series
        Consecutive rows of some batches, per joint [Y_j, tau_j, measured_j], shape (m_j + 2, n') each.
    """

    excluded: Reduction
    posture: Envelope
    extremes: ExtremeRows
    is_compared: Mask
    torque_sums: Array
    squares_above_band: Array
    drawn: DrawnRows
    samples: int = 0
    rows: int = 0
    blocks: dict[int, Reduction] = field(default_factory=dict)
    series: list[list[Array]] = field(default_factory=list)

    @staticmethod
    def empty(equation: LinearModel, posture: Envelope) -> ReducedPart:
        """A part without samples.

        Parameters
        ----------
        equation
            The torque equation.
        posture
            Stretches of time, for drawing.
        """
        nv = len(equation.joints)
        widths = [len(active) + 2 for active in equation.active()]
        return ReducedPart(
            excluded=empty(np.arange(width - 1) for width in widths),
            posture=posture,
            extremes=ExtremeRows(widths, posture.bins),
            is_compared=np.zeros(nv, dtype=bool),
            torque_sums=np.zeros((2, nv)),
            squares_above_band=np.zeros(nv),
            drawn=DrawnRows.empty(equation.active()),
        )

    @cached_property
    def counted(self) -> Reduction:
        """R-factors of [Y_j, tau_j, above_j] of the rows that count; of the blocks when it is first asked for."""
        return merge_reductions(list(self.blocks.values()))

    def _forget_counted(self) -> None:
        """Drop the cached `counted`, after a change of the blocks."""
        self.__dict__.pop("counted", None)

    @property
    def comparison(self) -> Reduction:
        """R-factors of [Y_j, tau_j, above_j] of all rows."""
        return merge_reductions([self.excluded, self.counted] if self.blocks else [self.excluded])

    def merge(self, other: ReducedPart, drawn_limit: int) -> None:
        """Merge the next batches of the same part of the log into this one, in place.

        Parameters
        ----------
        other
            The batches.
        drawn_limit
            Largest number of rows that are drawn at random from both.
        """
        for number, block in other.blocks.items():
            self.blocks[number] = merge(self.blocks[number], block) if number in self.blocks else block
        self._forget_counted()
        self.excluded = merge(self.excluded, other.excluded)
        self.posture.merge(other.posture)
        self.extremes.merge(other.extremes)
        self.is_compared |= other.is_compared
        self.torque_sums += other.torque_sums
        self.squares_above_band += other.squares_above_band
        self.drawn = merged_draws([self.drawn, other.drawn], drawn_limit)
        self.samples += other.samples
        self.rows += other.rows
        self.series += other.series

    def restore_columns(self, regrouped: RegroupedModel) -> None:
        """Add the columns that were left out, in place.

        Parameters
        ----------
        regrouped
            The model whose equation the part was reduced with.
        """
        self.excluded, *blocks = with_all_columns([self.excluded, *self.blocks.values()], regrouped)
        self.blocks = dict(zip(self.blocks, blocks, strict=True))
        self._forget_counted()  # made of these blocks again, it equals that of a file to the last bit
        self.extremes.rows = [regrouped.all_columns(joint, rows) for joint, rows in enumerate(self.extremes.rows)]
        drawn = [regrouped.all_columns(joint, rows.T).T for joint, rows in enumerate(self.drawn.rows)]
        self.drawn = replace(self.drawn, rows=tuple(drawn))
        for series in self.series:
            series[:] = [regrouped.all_columns(joint, rows.T).T for joint, rows in enumerate(series)]

    def add_batch(
        self, equation: LinearModel, prior: Array, signals: Signals, batch: Batch, series_rows: int
    ) -> tuple[list[Array], Shares]:
        """Add a batch; its rows are returned, to be cut into blocks.

        Parameters
        ----------
        equation
            The torque equation.
        prior
            Coefficients before the fit, shape (p,): rows are kept where their error is largest.
        signals
            The log.
        batch
            A batch of it.
        series_rows
            Number of rows, in the middle of the batch, that are added to the series; 0: none.

        Returns
        -------
        [Y_j, tau_j, above_j] of each joint, shape (m_j + 2, n), and the share of each row that counts, shape (n,).
        """
        motion = batch.motion
        inner = slice(batch.before, len(motion.t) - batch.after)
        row_filter = equation.row_filter(batch)
        columns = equation.filtered_columns(batch, row_filter)
        is_compared = equation.compared_rows(batch, row_filter)

        times = signals.log.start + motion.t[inner]
        in_band = _filtered(motion.tau, batch, signals.full_rate_low_pass)
        above_band = motion.logged_tau[:, inner] - in_band
        self.samples += in_band.shape[1]
        self.is_compared |= is_compared
        self.torque_sums += np.stack([in_band.sum(axis=1), np.square(in_band).sum(axis=1)])
        self.squares_above_band += np.square(above_band).sum(axis=1)
        self.posture.add(times, {"q": motion.q[:, inner]})

        stride = batch.low_pass.stride
        measured = in_band[:, ::stride]
        if signals.anti_aliasing is None:  # nothing is decimated
            above = above_band
        else:
            above = _filtered(motion.logged_tau, batch, signals.anti_aliasing) - measured
        self.rows += measured.shape[1]
        bins = self.posture.bins_of(times[::stride])
        prior_residuals = []
        for own, active in zip(columns, equation.active(), strict=True):
            prior_residuals.append(own[-1] - prior[active] @ own[:-1])
        parts = [(own, torque[None]) for own, torque in zip(columns, measured, strict=True)]
        self.extremes.add(bins, parts, (measured, np.stack(prior_residuals)))
        if series_rows:
            first = max((measured.shape[1] - series_rows) // 2, 0)
            kept = slice(first, first + series_rows)
            pairs = zip(columns, measured, strict=True)
            self.series.append([np.concatenate([own[:, kept], tau[None, kept]]) for own, tau in pairs])

        rows = [np.concatenate([own, torque[None]]) for own, torque in zip(columns, above, strict=True)]
        excluded = []
        for own, share in zip(rows, row_filter.shares, strict=True):
            excluded.append(Factor.from_columns(own[:, ~share.astype(bool)], batch.low_pass.redundancy))
        self.excluded = merge(self.excluded, tuple(excluded))
        return rows, row_filter.shares


def _filtered(x: Array, batch: Batch, low_pass: LowPass) -> Array:
    """A signal of a batch's motion, shape (nv, before + N + after), through another filter than the batch's."""
    before, after = min(batch.before, low_pass.reach), min(batch.after, low_pass.reach)
    surroundings = slice(batch.before - before, x.shape[-1] - batch.after + after)
    return low_pass(x[..., surroundings], before, after)
