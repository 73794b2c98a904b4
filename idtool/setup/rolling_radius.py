"""Radius of feet that are balls, by how they roll while a robot stands and its base turns.

The point of contact of a ball is a radius r below its centre, so that its velocity is linear in r: v + r x. That of all
feet on the ground is the same (see `foot_kinematics`), which determines r by least squares, because the feet turn by
different angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.data.signals import Signals
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.dataset.foot_kinematics import flagged_feet, foot_motions, without_mean
from idtool.estimation.dataset.foot_slip import SlipSearch
from idtool.robot.config import Contact
from idtool.robot.model import RobotModel

_MARGIN = 0.3  # s, after touchdown and before lift-off, in which a foot does not count as standing: steps are left out
_AVERAGE = 0.2  # s
_BLOCK = 0.5  # s, after which errors are taken as independent
_MIN_FEET = 3
_MIN_SECONDS = 3.0
_ERROR_BY_SOFT_FEET = 0.25  # of the radius: feet of 20 N/mm, which give way sideways, seem to be smaller by so much
_MAX_ERROR = 0.35  # of the radius
_MIN_RADIUS, _MAX_RADIUS = 0.005, 0.2  # m


@dataclass(frozen=True)
class RollingRadius:
    """A radius with its standard error, by noise and soft feet [m]."""

    value: float
    standard_error: float

    @property
    def text(self) -> str:
        """Value and error with their unit."""
        return f"{self.value:.3f} ± {self.standard_error:.3f} m"


@dataclass
class _NormalEquation:
    """Normal equation of the radius, by blocks of time.

    Attributes
    ----------
    xx, xy
        Sums over each block of the squares of x and of its products with −v.
    seconds
        Time that they are from [s].
    """

    xx: list[float] = field(default_factory=list)
    xy: list[float] = field(default_factory=list)
    seconds: float = 0.0

    def solution(self) -> RollingRadius | None:
        """The radius; None if it is not determined."""
        square = sum(self.xx)
        if self.seconds < _MIN_SECONDS or square == 0:
            return None
        value = sum(self.xy) / square
        scores = np.array(self.xy) - value * np.array(self.xx)
        by_noise = float(np.linalg.norm(scores)) / square
        error = float(np.hypot(by_noise, _ERROR_BY_SOFT_FEET * value))
        if not _MIN_RADIUS < value < _MAX_RADIUS or error > _MAX_ERROR * value:
            return None
        return RollingRadius(value, error)


def rolling_radius(experiment: Experiment, names: Sequence[str]) -> RollingRadius | None:
    """The radius that some feet have in common; None if the logs do not determine it, or a foot slips.

    Parameters
    ----------
    experiment
        Of a robot with a floating base, whose logs have the orientation of the base.
    names
        The contacts.
    """
    contacts = [contact for contact in experiment.config.contacts if contact.name in names]
    sums = _NormalEquation()
    for run in experiment.runs:
        feet = flagged_feet(contacts, experiment.model, run.signals.log)
        if len(feet) >= _MIN_FEET and _add_log(sums, run.signals, experiment.model, feet):
            return None
    return sums.solution()


def _add_log(sums: _NormalEquation, signals: Signals, model: RobotModel, feet: Sequence[Contact]) -> bool:
    """Add a log to the sums; True if a foot slips in it."""
    search = SlipSearch([foot.name for foot in feet], signals.log.start)
    points = foot_motions(signals, model, _with_radius(feet, 0.0))
    balls = foot_motions(signals, model, _with_radius(feet, 1.0))  # of 1 m, as the velocity is linear in it
    for point, ball in zip(points, balls, strict=True):
        stands = point.settled(_MARGIN)
        stands &= stands.sum(axis=0) >= _MIN_FEET
        if not stands.any():
            continue
        search.add(point)
        weights = stands.astype(float)
        velocity = without_mean(point.average(point.velocity, _AVERAGE), weights)
        per_radius = without_mean(point.average(ball.velocity - point.velocity, _AVERAGE), weights)
        block = max(round(_BLOCK / point.dt), 1)
        sums.xx += _block_sums(per_radius * per_radius, block)
        sums.xy += _block_sums(-per_radius * velocity, block)
        sums.seconds += point.dt * float(stands.any(axis=0).sum())
    return bool(search.slips())


def _with_radius(feet: Sequence[Contact], radius: float) -> list[Contact]:
    return [foot.model_copy(update={"radius": radius}) for foot in feet]


def _block_sums(x: Array, block: int) -> list[float]:
    """Sums over all but time, and over blocks of samples."""
    by_sample = x.sum(axis=(0, 1))
    starts = np.arange(0, len(by_sample), block)
    return [float(total) for total in np.add.reduceat(by_sample, starts)]
