"""Uncertainty of a fit: standard errors, information source of each parameter, agreement between logs, prediction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduced_logs import ReducedLog
from idtool.estimation.identification import Identification
from idtool.estimation.uncertainty.bias import BiasCheck, bias_check, paired_estimates
from idtool.estimation.uncertainty.cluster_robust import (
    FEWEST_CLUSTERS,
    ClusterRobustEstimate,
    cluster_robust_estimate,
)
from idtool.estimation.uncertainty.identifiability import Identifiability, identifiability
from idtool.estimation.uncertainty.prediction import Prediction, prediction, reduced_prediction
from idtool.estimation.uncertainty.repeatability import Repeatability, repeatability
from idtool.estimation.uncertainty.standard_errors import Uncertainty
from idtool.robot.inertia import PI_SIZE

_AGREEMENT = 1.5  # ratio of two standard errors of the same coefficient, above which they do not agree
_UNKNOWN_SHARE = 0.01  # of the samples, above which a joint's prediction is warned of
_TINY = float(np.finfo(float).tiny)
_INTERVALS_ALLOW = "the confidence intervals allow"


@dataclass(frozen=True)
class UncertaintyAnalysis:
    """Uncertainty of a fit.

    Attributes
    ----------
    theta
        The fit's coefficients, shape (p,).
    uncertainty
        Standard errors of the coefficients.
    cluster_robust
        The estimate that they were computed from.
    independent
        Number of independent samples that the residual holds, by joint.
    prediction
        Standard errors of the torque, on the held-out data if there are any, else on the training data.
    identifiability
        Information source of each parameter; None: not asked for.
    repeatability
        The logs against each other; None for a single one, or where it was not asked for.
    bias
        Least squares beside instrumental variables; None where it was not asked for, or would take long or much memory.
    notices
        Notices for the user.
    """

    theta: Array
    uncertainty: Uncertainty
    cluster_robust: ClusterRobustEstimate
    independent: Mapping[str, float]
    prediction: Prediction
    identifiability: Identifiability | None
    repeatability: Repeatability | None
    bias: BiasCheck | None
    notices: tuple[Notice, ...]

    def interval(self, rows: Array) -> Array:
        """95 % intervals of combinations of the coefficients, shape (k, p) to (k, 2); infinite where not determined.

        They cover the fit's value and the unregularized estimate's, since prior and constraints may hold the fit away
        from what the data say: truth may be as far from either.
        """
        half_width = self.uncertainty.coverage_factor(rows) * self.uncertainty.of(rows)
        unregularized = rows @ self.cluster_robust.theta
        fitted = rows @ self.theta
        low = np.minimum(unregularized, fitted) - half_width
        high = np.maximum(unregularized, fitted) + half_width
        return np.column_stack([low, high])

    @cached_property
    def intervals(self) -> Array:
        """The 95 % interval of every coefficient, shape (p, 2); infinite where not determined."""
        return self.interval(np.eye(len(self.theta)))

    def pull(self, rows: Array) -> Array:
        """Distance that prior and constraints hold combinations from the data's value, in standard errors, shape (k,).

        Zero where the data do not determine them.
        """
        errors = self.uncertainty.of(rows)
        distance = np.abs(rows @ (self.cluster_robust.theta - self.theta))
        is_determined = np.isfinite(errors) & (errors > 0)
        return np.where(is_determined, distance / np.maximum(errors, _TINY), 0.0)


def uncertainty_analysis(
    experiment: Experiment,
    identification: Identification,
    independent: Mapping[str, float],
    progress: Progress,
    thorough: bool,
    common_error: Array | None = None,
    reduced: Sequence[ReducedLog] | None = None,
) -> UncertaintyAnalysis:
    """Analyze the uncertainty of a fit.

    Parameters
    ----------
    experiment
        Model and data.
    identification
        Their identification.
    independent
        Number of independent samples that the residual holds, by joint.
    progress
        Callback for the stage and its progress, from 0 to 1.
    thorough
        If true, find the information source of each parameter, compare logs, and look for bias by noise.
    common_error
        Change of the coefficients by one standard error of what was fitted beforehand, shape (p,); None: nothing was.
    reduced
        The logs, if they have been reduced.
    """
    equation, equalities = experiment.equation, experiment.equalities
    estimate, data = identification.estimate, identification.data
    is_instrumental = identification.two_stage is not None
    rng = np.random.default_rng(experiment.config.seed)

    pair = None
    if is_instrumental or thorough:
        pair = paired_estimates(experiment, identification, progress)
    if pair is not None and is_instrumental:
        robust = pair.iv
    else:
        robust = cluster_robust_estimate(equation, data, estimate.noise, estimate.theta, equalities, rng)

    uncertainty = robust.uncertainty
    if robust.bootstrap is None or robust.correlated_beyond_clusters:
        uncertainty = _at_least_spectral(uncertainty, independent)
    if common_error is not None:
        uncertainty = uncertainty.with_common_error(common_error)

    held_out = experiment.has_held_out
    if reduced is None:
        torque_errors = prediction(experiment, uncertainty, held_out, progress)
    else:
        torque_errors = reduced_prediction(experiment.equation, reduced, uncertainty, held_out)

    parameters = logs = bias = None
    if thorough:
        tell = partial(progress, "finding the source of each parameter")
        parameters = identifiability(
            experiment.model, equation, equalities, identification.reduction, estimate, uncertainty, tell
        )
        if pair is not None:
            bias = bias_check(pair, parameters.base)
        if len(data) > 1 and experiment.config.pool is None:  # a fleet's logs differ by its robots' friction
            logs = repeatability(
                equation,
                data,
                estimate.noise,
                estimate.theta,
                equalities,
                parameters.base,
                identification.theta_from,
                rng,
                progress,
            )

    notices = (
        *cluster_notices(robust, data),
        *_repeatability_notices(logs),
        *_whole_mass_notice(uncertainty, experiment),
        *_mass_notices(parameters, experiment),
        *_bias_notices(bias, is_instrumental),
        *([_bias_unchecked(experiment)] if thorough and pair is None else []),
        *_prediction_notices(torque_errors, equation.joints),
    )
    return UncertaintyAnalysis(
        theta=estimate.theta,
        uncertainty=uncertainty,
        cluster_robust=robust,
        independent=independent,
        prediction=torque_errors,
        identifiability=parameters,
        repeatability=logs,
        bias=bias,
        notices=notices,
    )


def _at_least_spectral(uncertainty: Uncertainty, independent: Mapping[str, float]) -> Uncertainty:
    """Standard errors no smaller than the residual's spectrum gives, where clusters are few or short."""
    count = float(np.mean(list(independent.values())))
    directions = uncertainty.directions
    covariance = uncertainty.covariance_y
    required = max(directions.independent / count, 1.0) if count else 1.0
    inflation = float(np.trace(covariance)) * directions.independent_per_row / max(len(covariance), 1)
    if not inflation:
        return uncertainty
    return replace(uncertainty, covariance_y=covariance * max(required / inflation, 1.0))


def cluster_notices(robust: ClusterRobustEstimate, data: Sequence[Blocks]) -> list[Notice]:
    """Notices about standard errors that are too small, or were computed from few data."""
    if robust.bootstrap is None:
        seconds = sum(len(log) * log.seconds for log in data)
        few = (
            f"{short_number(seconds, 2)} s of data are too short for the {FEWEST_CLUSTERS} blocks that "
            "standard errors need"
        )
        message = f"{few}: the standard errors are computed from the residual's spectrum alone"
        return [Notice("few_blocks", "warning", None, message, "log for longer")]
    notices = []
    if robust.correlated_beyond_clusters:
        long = f"the residual is correlated over more than the {short_number(robust.cluster_seconds, 2)} s"
        message = f"{long} of the longest possible block: standard errors may be too small"
        advice = "log for longer; if the model lacks effects, idtool diagnose finds them"
        notices.append(Notice("correlated_residual", "warning", None, message, advice))
    ratio = robust.bootstrap_ratio
    if ratio is not None and not 1 / _AGREEMENT < ratio < _AGREEMENT:
        message = f"resampled standard errors are {short_number(ratio, 2)} times the analytic ones"
        advice = "both may be wrong by a factor of two"
        notices.append(Notice("standard_errors_disagree", "warning", None, message, advice))
    return notices


def _repeatability_notices(logs: Repeatability | None) -> list[Notice]:
    if logs is None:
        return []
    notices = []
    if logs.duplicates:
        advice = f"leave out {join_names(logs.duplicates)}"
        notices.append(
            Notice("duplicate_data", "warning", None, "duplicate data make the intervals too narrow", advice)
        )
    if logs.agrees.all():
        return notices
    count = int(np.count_nonzero(~logs.agrees))
    verb = "differs" if count == 1 else "differ"
    differ = f"{count} of {len(logs.agrees)} base parameters {verb} between logs by more than {_INTERVALS_ALLOW}"
    if logs.outlier is not None:
        outlier = logs.logs[logs.outlier]
        return [
            *notices,
            Notice("logs_disagree", "warning", None, f"{differ}; the log that differs from the others is {outlier}"),
        ]
    message = f"{differ}: the intervals of these parameters from all logs together are too narrow"
    return [*notices, Notice("logs_disagree", "warning", None, message)]


def _whole_mass_notice(uncertainty: Uncertainty, experiment: Experiment) -> Iterator[Notice]:
    """Notice that unknown contact forces can carry any weight of a robot with a floating base."""
    if not experiment.model.has_floating_base:
        return
    mass = np.zeros(len(experiment.equation.coefficients))
    mass[: PI_SIZE * len(experiment.model.bodies) : PI_SIZE] = 1.0
    if not uncertainty.directions.determines(mass[None]).all():
        message = "the logs do not determine the robot's mass: contacts of unknown force can carry any weight"
        advice = "give every contact a flag and log walking too, or weigh the robot and set known.total_mass"
        yield Notice("mass_undetermined", "warning", None, message, advice)


def _mass_notices(parameters: Identifiability | None, experiment: Experiment) -> Iterator[Notice]:
    """Masses that the torque does not tell, but a scale would."""
    if parameters is None or experiment.config.known.total_mass is not None:
        return
    names = [body.name for body in experiment.model.bodies]
    masses = parameters.sources[::PI_SIZE]
    unknown = [name for name, source in zip(names, masses, strict=True) if source.information_source == "prior"]
    if unknown:
        message = f"the logs do not determine the mass of {join_names(unknown)}"
        yield Notice("mass_undetermined", "warning", None, message, "weigh the moving parts and set known.total_mass")


def _bias_notices(bias: BiasCheck | None, is_instrumental: bool) -> list[Notice]:
    if bias is None:
        return []
    notices = []
    if bias.weak and not is_instrumental:  # instrumental variables have said so before
        message = f"instruments are weak, so least squares was not checked for bias: {join_names(bias.weak)}"
        notices.append(Notice("weak_instruments", "note", None, message))
    if not bias.differs.any():
        return notices
    count = int(np.count_nonzero(bias.differs))
    verb = "differs" if count == 1 else "differ"
    differ = f"{count} of {len(bias.differs)} base parameters {verb} between least squares and instrumental variables"
    advice = ""
    if not is_instrumental:
        advice = "noise in q and v biases them, or the model lacks something; see --method iv"
    message = f"{differ} by more than {_INTERVALS_ALLOW}"
    return [*notices, Notice("biased_parameters", "warning", None, message, advice)]


def _bias_unchecked(experiment: Experiment) -> Notice:
    """Notice that least squares was not checked for bias, and why."""
    if not experiment.has_only_joints:
        what = "least squares was not checked for bias: this needs a fixed base and no wrench sensors"
        return Notice("bias_unchecked", "note", None, what)
    if not experiment.runs:
        what = "least squares was not checked for bias: this needs the logs, of which a reduction has no samples"
        return Notice("bias_unchecked", "note", None, what)
    reason = "it would take too long or too much memory, or no instruments are available"
    what = f"least squares was not checked for bias: {reason}"
    return Notice("bias_unchecked", "note", None, what, "see --method iv")


def _prediction_notices(torque_errors: Prediction, joints: Sequence[str]) -> list[Notice]:
    shares = zip(joints, torque_errors.unknown, strict=True)
    unknown = [name for name, share in shares if share > _UNKNOWN_SHARE]
    if not unknown:
        return []
    what = "excites combinations of parameters that the logs of the fit do not determine"
    return [Notice("new_motion_held_out", "warning", None, f"the held-out motion of {join_names(unknown)} {what}")]
