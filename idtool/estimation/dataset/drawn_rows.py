"""`DrawnRows`: rows of the torque equation that are drawn at random from data of any length.

Every row has a random key. The rows with the least keys are kept. Those of several parts of the data, merged, are those
of the whole: a bottom-k sketch (Cohen & Kaplan, Summarizing data using bottom-k sketches, 2007). A key follows from the
log and the number of the row, so that it does not matter which process reads the row.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.data.logs.log import JointLog
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.reduction import Factor, Reduction


@dataclass(frozen=True)
class DrawnRows:
    """Rows of all joints at the same samples, in the order of their keys.

    Attributes
    ----------
    rows
        Per joint, columns and torque in the band [Y_j, tau_j], shape (m_j + 1, n).
    shares
        Share of each row that counts in a fit, from 0 to 1, shape (nv, n).
    worth
        Number of independent samples that each is worth, shape (n,).
    keys
        Random keys, ascending, shape (n,).
    drawn_from
        Number of samples that these were drawn from.
    """

    rows: tuple[Array, ...]
    shares: Array
    worth: Array
    keys: Array
    drawn_from: int

    @staticmethod
    def empty(active: Sequence[Indices]) -> DrawnRows:
        """No rows, of joints with these coefficients."""
        rows = tuple(np.zeros((len(columns) + 1, 0)) for columns in active)
        return DrawnRows(rows, np.zeros((len(rows), 0)), np.zeros(0), np.zeros(0), 0)

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def are_all(self) -> bool:
        """True if these are all samples that they were drawn from."""
        return len(self) == self.drawn_from

    def with_rows(self, rows: Sequence[Array], shares: Shares, worth: float, keys: Array, limit: int) -> DrawnRows:
        """Draw from further samples, too.

        Parameters
        ----------
        rows
            Per joint [Y_j, tau_j], shape (m_j + 1, n).
        shares
            Per joint, the share of each row that counts, shape (n,).
        worth
            Number of independent samples that each is worth.
        keys
            Their keys, shape (n,).
        limit
            Largest number of samples to keep.
        """
        count = len(keys)
        is_full = 0 < limit <= len(self)
        candidates = np.flatnonzero(keys < self.keys[limit - 1]) if is_full else np.arange(count)
        if not len(candidates):
            return replace(self, drawn_from=self.drawn_from + count)
        new = DrawnRows(
            rows=tuple(own[:, candidates] for own in rows),
            shares=np.stack([own[candidates].astype(float) for own in shares]),
            worth=np.full(len(candidates), worth),
            keys=keys[candidates],
            drawn_from=count,
        )
        return merged_draws([self, new], limit)

    def least(self, limit: int) -> DrawnRows:
        """The samples with the least keys, up to a number of them."""
        return self if len(self) <= limit else self._subset(np.arange(limit))

    def below(self, key: float) -> DrawnRows:
        """The samples with keys of at most ``key``."""
        return self._subset(np.flatnonzero(self.keys <= key))

    def _subset(self, indices: Indices) -> DrawnRows:
        """Some of the samples, of as many as before."""
        return replace(
            self,
            rows=tuple(own[:, indices] for own in self.rows),
            shares=self.shares[:, indices],
            worth=self.worth[indices],
            keys=self.keys[indices],
        )

    def reduction(self, indices: Indices) -> Reduction:
        """The R-factors of some of the samples."""
        worth = self.worth[indices]
        factors = []
        for rows, shares in zip(self.rows, self.shares[:, indices], strict=True):
            factor = Factor.from_shares(rows[:, indices], shares)
            factors.append(replace(factor, independent=float(worth @ shares)))
        return tuple(factors)


def merged_draws(draws: Sequence[DrawnRows], limit: int) -> DrawnRows:
    """The samples with the least keys of several draws, up to a number of them."""
    keys = np.concatenate([draw.keys for draw in draws])
    order = np.argsort(keys, kind="stable")[:limit]
    rows_by_joint = zip(*(draw.rows for draw in draws), strict=True)
    return DrawnRows(
        rows=tuple(np.concatenate(rows, axis=1)[:, order] for rows in rows_by_joint),
        shares=np.concatenate([draw.shares for draw in draws], axis=1)[:, order],
        worth=np.concatenate([draw.worth for draw in draws])[order],
        keys=keys[order],
        drawn_from=sum(draw.drawn_from for draw in draws),
    )


def uniform_draw(draws: Sequence[DrawnRows], limit: int) -> DrawnRows:
    """A draw in which every sample is as likely as any other, from draws of logs of different length.

    What was left out of a draw has higher keys than its last one. Up to the lowest of these, all samples are known.

    Parameters
    ----------
    draws
        Those of the logs.
    limit
        Largest number of samples to keep.
    """
    known_up_to = min((draw.keys[-1] for draw in draws if len(draw) and not draw.are_all), default=np.inf)
    return merged_draws([draw.below(known_up_to) for draw in draws], limit)


def log_identity(log: JointLog) -> str:
    """Hashes of a log's files: other logs may have its name, as in the folders of a fleet. Without files, its name."""
    return " ".join(source.sha256 or source.path for source in log.sources) or log.path.name


def row_keys(identity: str, first: int, count: int) -> Array:
    """Random keys of consecutive rows of a log, uniform from 0 to 1, shape (count,).

    Parameters
    ----------
    identity
        What identifies the log, or a part of it.
    first
        Number of rows before them.
    count
        Number of rows.
    """
    generator = np.random.PCG64(zlib.crc32(identity.encode(errors="replace")))
    return np.random.Generator(generator.advance(first)).random(count)
