"""Logs of a prescribed motion: sums of sines, and the torque that they take according to Pinocchio.

Letters: q, v, a positions, velocities, accelerations, tau torque; shape (N, nv) in a log. Units: rad, s, N·m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray
from spatial_arm import ARM, RATE

from idtool.estimation.dataset.experiment import Experiment

Array = NDArray[np.float64]
Log = dict[str, Array]

_HERTZ, _SIZE = (0.13, 2.6), 0.45  # of the slowest sine and the fastest; of the slowest [rad]
_SINES = 5


def prescribed_motion(seconds: float, text: str = ARM, seed: int = 0, tree: pin.Model | None = None) -> Log:
    """A prescribed motion of a robot with revolute joints, and the torque that it takes: t (N,), the others (N, nv).

    Parameters
    ----------
    seconds
        Duration.
    text
        The URDF.
    seed
        Seed of the sines' phases.
    tree
        Bodies in place of the URDF's.
    """
    tree = pin.buildModelFromXML(text) if tree is None else tree
    t = np.arange(round(seconds * RATE)) / RATE
    q, v, a = sines(t, tree.nv, seed)
    data = tree.createData()
    tau = np.array([pin.rnea(tree, data, *state) for state in zip(q, v, a, strict=True)])
    return {"t": t, "q": q, "v": v, "a": a, "tau": tau}


def sines(t: Array, nv: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations at times (N,), shape (N, nv) each."""
    rng = np.random.default_rng(seed)
    hertz = np.geomspace(*_HERTZ, _SINES)[:, None] * rng.uniform(0.85, 1.15, (_SINES, nv))
    w, size = 2 * np.pi * hertz, _SIZE * np.sqrt(_HERTZ[0] / hertz)
    angle = w * t[:, None, None] + rng.uniform(0, 2 * np.pi, (_SINES, nv))
    return (
        np.asarray((size * np.sin(angle)).sum(axis=1)),
        np.asarray((size * w * np.cos(angle)).sum(axis=1)),
        np.asarray((-size * w * w * np.sin(angle)).sum(axis=1)),
    )


def with_torque(log: Log, joint: int, extra: Array) -> Log:
    """The motion with additional torque on a joint, shape (N,)."""
    tau = log["tau"].copy()
    tau[:, joint] += extra
    return {**log, "tau": tau}


def with_noise(log: Log, size: float, seed: int = 1) -> Log:
    """The motion with white noise on all torques [N·m]."""
    return {**log, "tau": log["tau"] + size * np.random.default_rng(seed).normal(size=log["tau"].shape)}


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


@dataclass(frozen=True)
class Stacked:
    """All rows of an experiment's training data, those of all joints one after the other, in units of their noise.

    Attributes
    ----------
    Y, tau
        Columns, shape (M, p), and torque, (M,).
    block
        The block of time that each row is in, shape (M,).
    """

    Y: Array
    tau: Array
    block: NDArray[np.intp]

    def left(self, *columns: Array, keep: Array | slice = slice(None)) -> tuple[Array, Array]:
        """Least squares with further columns, (M,) each, on all blocks but one, and that again for every block.

        Returns
        -------
        Squared residuals of the block left out, shape (F,), and the columns' coefficients, (F, k).
        """
        A = np.column_stack([self.Y[:, keep], *columns])
        size = np.linalg.norm(A, axis=0)
        A = A[:, size > 0] / size[size > 0]
        squares, coefficients = [], []
        for f in range(self.block.max() + 1):
            out = self.block == f
            x = np.linalg.lstsq(A[~out], self.tau[~out], rcond=1e-9)[0]
            squares.append(np.square(self.tau[out] - A[out] @ x).sum())
            coefficients.append((x / size[size > 0])[len(x) - len(columns) :])
        return np.array(squares), np.array(coefficients)


def stacked(tried: Experiment, noise: Array, length: int) -> Stacked:
    """The rows of an experiment, in blocks of so many samples, which begin anew with every log."""
    Y, tau, block, earlier = [], [], [], 0
    for run in tried.runs:
        first = 0
        for batch in run.signals.batches(run.train):
            blocks, kept = tried.equation.filtered_rows(batch)[0], tried.equation.clean_samples(batch)
            count = blocks[0].shape[1]
            for rows, keep, active, sigma in zip(blocks, kept, tried.equation.active(), noise, strict=True):
                own = np.zeros((count, len(tried.equation.coefficients)))
                own[:, active] = rows[:-1].T
                Y.append(own[keep] / sigma)
                tau.append(rows[-1][keep] / sigma)
                block.append(earlier + (first + np.flatnonzero(keep)) // length)
            first += count
        earlier += -(-first // length)
    return Stacked(np.concatenate(Y), np.concatenate(tau), np.concatenate(block))
