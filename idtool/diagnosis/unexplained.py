"""Residual that the effects found do not explain: its structure, its noise floor, and the joints where it is more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.diagnosis.candidate_fit import MIN_SHARE_OF_TORQUE
from idtool.diagnosis.error_summary import NEGLIGIBLE_SHARE
from idtool.diagnosis.generic_probes import UNKNOWN, generic_probes
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import MIN_SIGNIFICANCE, explained_share
from idtool.diagnosis.noise_floor import NoiseFloor, estimate_noise_floor
from idtool.diagnosis.records import Candidate, ErrorSummary
from idtool.diagnosis.residual_series import residual_series
from idtool.diagnosis.screen import ScreenedProbe, screen_probes
from idtool.diagnosis.summarize_data import summarize_data
from idtool.estimation.dataset.experiment import Progress
from idtool.estimation.evaluation.torque_errors import overall_rms

_STRUCTURED_SHARE = 0.1  # of a joint's squared residual, explained by a generic function: it has structure
_SLOW_POWER = 25.0  # ratio of the residual's power to the noise's at the motion's frequencies: it has structure
_MAX_FLOOR_RATIO = 1.3  # of the noise floor, up to which a residual is explained
_NEAR_NOISE = 1.5  # times the noise, up to which a residual counts as noise


@dataclass(frozen=True)
class RemainingResidual:
    """Residual of the model with all effects, those included that are only fitted and not reported.

    Attributes
    ----------
    errors
        Torque errors of the model.
    structure
        Its `residual_structure`.
    floor
        Its noise floor.
    is_known
        True if structure and floor were determined; otherwise, all of the residual counts as noise.
    """

    errors: ErrorSummary
    structure: Sequence[Candidate]
    floor: NoiseFloor
    is_known: bool = True

    def reported_floor(self, reported: ErrorSummary) -> dict[str, float]:
        """Noise floor of the model without the effects that are not reported, by joint and ``overall`` [N·m or N].

        What these effects explain is added, since the reported model cannot go below it. A floor above the error that
        the reported model has is no floor: where an effect is undefined, its error depends on chance.

        Parameters
        ----------
        reported
            Errors of the reported model.
        """
        squares = {}
        for name, rms in zip(_joint_names(self.errors.torque), self.floor.rms.tolist(), strict=True):
            reached = reported.torque[name] ** 2
            explained = reached - self.errors.torque[name] ** 2
            squares[name] = min(rms**2 + max(explained, 0.0), reached)
        floor = {name: float(np.sqrt(square)) for name, square in squares.items()}
        return floor | {"overall": overall_rms(floor.values())}

    def floor_by_joint(self) -> dict[str, float]:
        """Its noise floor by joint, NaN if there is no error, and ``overall`` [N·m or N]."""
        rms = np.where(np.isnan(_by_joint(self.errors.torque)), np.nan, self.floor.rms)
        floor = dict(zip(_joint_names(self.errors.torque), rms.tolist(), strict=True))
        return floor | {"overall": overall_rms(floor.values())}

    def is_unexplained(self, rms_torque: Array) -> Mask:
        """Mask of the joints whose residual is more than noise, shape (nv,).

        Parameters
        ----------
        rms_torque
            Rms of each joint's torque, shape (nv,) [N·m or N].
        """
        negligible = NEGLIGIBLE_SHARE * rms_torque
        has_structure = np.array([candidate.score > _STRUCTURED_SHARE for candidate in self.structure])
        has_slow_power = self.floor.slow_power_ratio > _SLOW_POWER
        is_above_noise = self.floor.residual > np.maximum(_NEAR_NOISE * self.floor.noise, negligible)
        rms = _by_joint(self.errors.torque)
        is_above_floor = (rms > _MAX_FLOOR_RATIO * self.floor.rms) & (rms > negligible)
        return has_structure | (has_slow_power & is_above_noise) | is_above_floor


def residual_structure(current: LinearizedFit, inflation: float, progress: Progress) -> list[Candidate]:
    """Unknown effect of each joint, whose score is the share of its residual that generic functions explain.

    Parameters
    ----------
    current
        The model.
    inflation
        Number of rows that are worth one independent one.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    One candidate a joint; its score is 0 if chance explains it, or if it is negligible.
    """
    stage = "looking for unknown effects"
    equation = current.experiment.equation
    residual = residual_series(current.experiment, [(equation, current.theta)], progress, stage)
    probes = list(generic_probes(summarize_data(current), residual))
    screened = screen_probes(current, probes, progress, stage)
    structure = []
    for j, name in enumerate(equation.joints):
        own = [candidate for candidate in screened if candidate.probe.joint == name]
        best = max(own, key=lambda candidate: candidate.gain)
        score = error = 0.0
        if _is_structure(best, current, j, inflation):
            score = min(explained_share(best.gain, current, 1), 1.0)
            error = explained_share(best.standard_error, current, 1)
        structure.append(Candidate(UNKNOWN, name, None, score, error, 0))
    return structure


def no_structure(joints: Sequence[str]) -> list[Candidate]:
    """`residual_structure` where none was found."""
    return [Candidate(UNKNOWN, name, None, 0.0, 0.0, 0) for name in joints]


def _is_structure(screened: ScreenedProbe, current: LinearizedFit, joint: int, inflation: float) -> bool:
    """True if what a probe explains of a joint's residual is neither chance nor negligible."""
    rows = max(current.row_counts[:, joint].sum(), 1.0)
    explained_rms = np.sqrt(max(screened.gain, 0.0) / rows) * current.noise[joint]
    is_significant = screened.gain > MIN_SIGNIFICANCE**2 * inflation
    return bool(is_significant and explained_rms / current.rms_torque[joint] > MIN_SHARE_OF_TORQUE)


def structured_noise_floor(current: LinearizedFit, structure: Sequence[Candidate], progress: Progress) -> NoiseFloor:
    """Noise floor of a model whose residual has a known structure.

    Parameters
    ----------
    current
        The model.
    structure
        Its `residual_structure`.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    floor = estimate_noise_floor(current.experiment, current.estimate.theta, progress, current.reversal_margin)
    scores = np.array([candidate.score for candidate in structure])
    return floor.without_structure(scores).with_coloured_noise(scores == 0)


def residual_as_floor(errors: ErrorSummary) -> NoiseFloor:
    """Noise floor that is not known: all of the residual may be noise."""
    rms = _by_joint(errors.torque)
    return NoiseFloor(rms, rms, rms, np.ones(len(rms)), is_estimated=False)


def _joint_names(errors: Mapping[str, float]) -> list[str]:
    """Joints that there are errors of."""
    return [name for name in errors if name != "overall"]


def _by_joint(errors: Mapping[str, float]) -> Array:
    """Errors of the joints, shape (nv,)."""
    return np.array([errors[name] for name in _joint_names(errors)])
