"""`effect_profile`: residual of a joint by the cause of an effect, such as the velocity, before and after the step."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.diagnosis.records import EffectProfile
from idtool.diagnosis.regions import distance_since_reversal
from idtool.diagnosis.residual_maps import STATE_BINS, TIME_BINS, bin_means, uniform_edges, velocity_edges
from idtool.diagnosis.residual_series import ResidualSeries, residual_series
from idtool.diagnosis.trial import with_effects
from idtool.dynamics.effects import NamedEffect, effect_from_entry
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.named_effect import Cause
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry

_MAX_SCATTER = 0.2  # of the effect's power about its means, up to which it is a function of its cause
_FIRST_BIN = 0.05  # quantile of the distances since reversals at which the first bin ends
_DISTANCE_BINS = 40


def effect_profile(
    entry: EffectEntry,
    before: Experiment,
    theta_before: Array,
    after: Experiment,
    theta_after: Array,
    progress: Progress,
) -> EffectProfile:
    """Profile of an effect, on training and held-out parts together.

    Samples at which the sign of the joint's friction is not known are left out.

    Parameters
    ----------
    entry
        The effect, one of those of ``after``.
    before, after
        Model and data without and with the effect; the logs are the same.
    theta_before, theta_after
        Coefficients, shape (p,) each.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    effect = effect_from_entry(entry, after.model)
    without = _without_effect(effect, after, theta_after)
    models = [(before.equation, theta_before), without, (after.equation, theta_after)]
    series = residual_series(before, models, progress, "mapping the explained residual")

    joints = after.equation.joints
    j = int(effect.joint) if isinstance(effect, JointEffect) else _most_improved_joint(series)
    source = j if effect.cause_joint is None else effect.cause_joint
    cause_kind = _cause_of(effect, series, source)
    cause = _cause_values(cause_kind, effect.cause_period, series, source)
    valid = series.valid[j] & np.isfinite(cause)
    residual_before, residual_without, residual_after = series.residuals[:, j]
    torques = np.stack([residual_before, residual_after, residual_without - residual_after])
    if effect.follows_direction:
        torques = torques * np.sign(series.v[j])
    values, mean, deviation = _binned_torques(cause_kind, cause, torques, valid)
    effect_torque = None
    if _is_function(torques[2, valid], np.interp(cause[valid], values, mean[2])):
        effect_torque = mean[2]
    return EffectProfile(
        joint=joints[j],
        cause=cause_kind,
        cause_joint=joints[source],
        period=effect.cause_period,
        in_direction_of_motion=effect.follows_direction,
        values=values,
        mean_before=mean[0],
        deviation_before=deviation[0],
        mean_after=mean[1],
        deviation_after=deviation[1],
        effect_torque=effect_torque,
    )


def _without_effect(effect: NamedEffect, after: Experiment, theta: Array) -> tuple[LinearModel, Array]:
    """Torque equation without an effect, and its coefficients: all others as they are with it."""
    others = [other for other in after.config.effects if effect_from_entry(other, after.model).key != effect.key]
    equation = with_effects(after, others, theta).equation
    values = {c.key: x for c, x in zip(after.equation.coefficients, theta, strict=True)}
    return equation, np.array([values[c.key] for c in equation.coefficients])


def _most_improved_joint(series: ResidualSeries) -> int:
    """Joint whose squared residual the last model reduces most, relative to what is left."""
    squares = np.square(series.residuals)
    before = np.sum(squares[0], axis=-1, where=series.valid)
    after = np.sum(squares[-1], axis=-1, where=series.valid)
    return int(np.argmax(before / np.maximum(after, np.finfo(float).tiny)))


def _cause_of(effect: NamedEffect, series: ResidualSeries, j: int) -> Cause:
    """Cause of an effect's torque; of a force on a floating base, whose position is not measured, its acceleration."""
    has_position = bool(series.q[j].any())
    return effect.cause if has_position or effect.cause != "position" else "acceleration"


def _cause_values(cause: Cause, period: float | None, series: ResidualSeries, j: int) -> Array:
    """Values of a cause at all samples, such as the velocity, shape (n,); infinite where not known."""
    match cause:
        case "position":
            q = series.q[j] if period is None else series.q[j] % period
            return np.asarray(q)
        case "velocity":
            return np.asarray(series.v[j])
        case "acceleration":
            return np.asarray(series.a[j])
        case "torque":
            return np.asarray(series.tau[j])
        case "torque_rate":
            return _rate(series.tau[j], series)
        case "distance_since_reversal":
            return distance_since_reversal(series, j)
        case "time":
            return series.t


def _rate(x: Array, series: ResidualSeries) -> Array:
    """Derivative by time within each segment, shape (n,); infinite in segments of one sample."""
    rate = np.full(len(x), np.inf)
    for part in series.segments:
        if part.stop - part.start > 1:
            rate[part] = np.gradient(x[part]) / series.dt[part]
    return rate


def _binned_torques(cause: Cause, values: Array, torques: Array, valid: Mask) -> tuple[Array, Array, Array]:
    """Mean cause in k bins, shape (k,); mean and standard deviation of the torques in them, shape (3, k) each."""
    x = values[valid]
    edges = _edges(cause, x)
    _, mean_cause, _ = bin_means(x, edges, x)
    means = []
    deviations = []
    for torque in torques[:, valid]:
        _, mean, rms = bin_means(x, edges, torque)
        means.append(mean)
        deviations.append(np.sqrt(np.maximum(np.square(rms) - np.square(mean), 0.0)))
    return mean_cause, np.array(means), np.array(deviations)


def _edges(cause: Cause, x: Array) -> Array:
    """Edges of the bins; near zero velocity, and after a reversal, they are close together."""
    match cause:
        case "velocity":
            return velocity_edges(x)
        case "distance_since_reversal" if len(x) and x.max() > 0:
            first = max(float(np.quantile(x, _FIRST_BIN)), 1e-4 * float(x.max()))
            return np.concatenate([[0.0], np.geomspace(first, x.max(), _DISTANCE_BINS)])
        case "time":
            return uniform_edges(x, TIME_BINS)
        case _:
            return uniform_edges(x, STATE_BINS)


def _is_function(torque: Array, mean: Array) -> bool:
    """True if a torque differs little from its mean at the same value of the cause, shape (n,) each."""
    power = float(np.sum(np.square(torque)))
    return power > 0 and float(np.sum(np.square(torque - mean))) < _MAX_SCATTER * power
