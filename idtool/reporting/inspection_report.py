"""The record of an inspection."""

from __future__ import annotations

from idtool.common.notice import Notice
from idtool.data.inspection import Inspection, data_fault
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.inspection import FindingReport, InspectionReport


def inspection_report(inspection: Inspection) -> InspectionReport:
    """The content that `idtool inspect` prints as JSON."""
    figures = inspection.to_dict()
    del figures["findings"], figures["reading"]
    return InspectionReport(
        **figures,
        findings=[_finding(finding) for finding in inspection.findings],
        notices=notice_fields([*inspection.findings, *inspection.reading])["notices"],
        warnings=notice_fields(inspection.reading)["warnings"],
    )


def _finding(finding: Notice) -> FindingReport:
    fault = data_fault(finding)
    return FindingReport(
        severity=finding.severity,
        joint=finding.subject,
        what=finding.message,
        meaning=finding.advice,
        fault=fault,
        undone=fault is not None and finding.severity == "note",
    )
