"""The result of `idtool inspect`."""

from __future__ import annotations

from idtool.common.number_text import short_number
from idtool.reporting.results.inspection import InspectionReport
from idtool.reporting.sections.inspection import JointsSection, SensorsSection
from idtool.reporting.terminal.output import Output


def show_inspection(terminal: Output, inspection: InspectionReport) -> None:
    """Print the contents of a log and the findings."""
    terminal.say(
        f"{inspection.path}: {inspection.samples} samples, {inspection.duration:.2f} s at "
        f"{short_number(inspection.rate_hz, 4)} Hz, "
        f"{inspection.segments} segment{'s' if inspection.segments != 1 else ''} without gaps"
    )
    terminal.sections([JointsSection(), SensorsSection()], inspection)
    terminal.notices(inspection.notices)
