"""Records of a verdict: ``verdict`` and ``verdict_reasons`` of report.json, validation.json and diagnosis.json."""

from __future__ import annotations

from typing import Literal

from idtool.reporting.results.base import Record, field

VerdictLevel = Literal["good", "torque_only", "do_not_use"]

VERDICT_TEXT = "`good`, `torque_only` (good for torque only) or `do_not_use`; see [Verdict](howto/report.md#verdict)."
REASONS_TEXT = "What was judged, one entry each, problems of the logs first; the verdict is the worst of their levels."


class VerdictReason(Record):
    """One of the things that a verdict depends on."""

    about: Literal["effects", "torque", "motion", "bodies", "data"] = field("What was judged.")
    level: VerdictLevel = field("Best verdict that it allows.")
    figure: float | None = field(
        "`effects`: share of the gap to the noise floor that they close; "
        "`torque`: error over the torque's standard deviation; `motion`: time for which a rollout can be trusted "
        "[s], in closed loop the position error over that of a robot that follows its command; `bodies`: total mass "
        "over that of the URDF; `data`: share of the base parameters that the logs determine. Null: not known."
    )
    text: str = field("The result as a sentence.")
