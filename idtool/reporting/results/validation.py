"""Records of `idtool validate`: validation.json, and the regression."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from idtool.reporting.results.base import (
    ByJoint,
    ByJointOrNone,
    ByKindOrNone,
    Keys,
    OffsetsByLog,
    ReadOnly,
    Record,
    ReproducibleResult,
    Result,
    Sentences,
    Units,
    field,
)
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.results.verdict import REASONS_TEXT, VERDICT_TEXT, VerdictLevel, VerdictReason


class ModelErrors(Record):
    """RMS torque errors by joint, null where nothing is known of its torque; `overall` is the RMS over all others."""

    model: ByJointOrNone = field("Error of the model [N·m or N].")
    prior: ByJointOrNone | None = Field(None, description="Error of the `--prior` URDF; absent without this option.")

    @model_serializer(mode="wrap")
    def _without_absent_prior(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        errors: dict[str, Any] = serialize(self)
        if self.prior is None:
            del errors["prior"]
        return errors


class ModelErrorsByKind(Record):
    """Errors of `rms` by kind of row: `joints` is the RMS over all joints; of a force or moment, of its length."""

    model: ByKindOrNone = field("Error of the model [N·m or N].")
    prior: ByKindOrNone | None = field("Error of the `--prior` URDF; null without this option.")


class ValidationReport(ReproducibleResult):
    """Result of `idtool validate`."""

    verdict: VerdictLevel = field(VERDICT_TEXT)
    verdict_reasons: tuple[VerdictReason, ...] = field(REASONS_TEXT)
    next: Sentences = field("Suggested next steps, one sentence each.")
    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    samples: int = field("Number of samples used.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    rms: ModelErrors = field("RMS torque errors within the filter's band.")
    rms_by_kind: ModelErrorsByKind | None = field(
        "RMS errors of the joints, of the force and moment on a floating base (`base_force`, `base_moment`), and of "
        "each wrench sensor (`<joint>_force`, `<joint>_moment`); null if there are only joints."
    )
    rms_raw: ModelErrors = field("RMS torque errors against the torque as logged.")
    nrms: ByJointOrNone = field("`rms.model` divided by the standard deviation of the measured torque.")
    wrench_sensor_offsets: OffsetsByLog = field(
        "Offsets of the wrench sensors that were estimated from the logs themselves, by the model [N, N·m]."
    )
    simulation: Simulation | None = field(
        "Forward simulation; null with `--no-simulation`, or if the model cannot be simulated."
    )
    bound: ByJoint = field("Bounds of `--max-rms`, by joint or `overall` [N·m or N].")
    ok: Annotated[ReadOnly[bool], Keys("joint")] = field("Whether each bound was met.")


class RegressionCase(Record):
    """One bound of the regression."""

    case: str = field("Case in `sample_logs/manifest.yaml`.")
    joint: str = field("A joint, or `overall`.")
    rms: float = field("RMS torque error [N·m or N].")
    bound: float = field("Its bound.")
    prior: float = field("Error of the original URDF.")
    ok: bool = field("Whether the bound was met.")


class RegressionReport(Result):
    """Result of `idtool validate` without a URDF: the regression."""

    cases: tuple[RegressionCase, ...] = field("All bounds.")
