"""`compare`: two results of a fit side by side."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.notebook import Displayable
from idtool.api.results import SavableResult, notice_lines, table_lines
from idtool.common.outputs import as_json
from idtool.reporting.compare_report import compare_report
from idtool.reporting.results.comparison import ComparisonReport
from idtool.reporting.sections.compare import ComparedBaseParametersSection
from idtool.reporting.stored_fit import StoredFit, read_fit

if TYPE_CHECKING:
    from idtool.api.fit import FitResult
    from idtool.reporting.terminal.output import Output

    FitSource = FitResult | str | os.PathLike[str]


class ComparisonResult(ComparisonReport, SavableResult, Displayable):
    """Comparison of two results of a fit. The fields are those of comparison.json."""

    _made_by: str

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages.compare import comparison_page

        return {"comparison.json": as_json(self.to_json()), "comparison.html": comparison_page(self, made_by)}

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.compare import show_comparison

        show_comparison(output, self)

    def __repr__(self) -> str:
        lines = [f"ComparisonResult: {self.summary}"]
        table = ComparedBaseParametersSection().table(self)
        if table is not None:
            head = [column.heading for column in table.columns]
            lines += table_lines(head, [[cell.text for cell in row] for row in table.rows])
        lines += notice_lines(self.notices)
        return "\n".join(lines)


def compare(a: FitSource, b: FitSource) -> ComparisonResult:
    """Compare two results of a fit, like `idtool compare`: two runs, two robots of a type, or two versions.

    Parameters
    ----------
    a, b
        The results: what `idtool.fit` returned, the folder that a fit was saved to, or the report.json in it.

    Raises
    ------
    IdtoolError
        If a file cannot be read, or is not the result of a fit.
    """
    result = ComparisonResult.from_result(compare_report(_stored_fit(a, "a"), _stored_fit(b, "b")))
    result._made_by = f"idtool.compare({_source_text(a)}, {_source_text(b)})"
    return result


def _stored_fit(source: FitSource, name: str) -> StoredFit:
    """A result as it is stored."""
    if isinstance(source, str | os.PathLike):
        return read_fit(Path(source))
    return StoredFit(name, source, source.model.settings, source._fit.experiment.sources)


def _source_text(source: FitSource) -> str:
    return repr(os.fspath(source)) if isinstance(source, str | os.PathLike) else "FitResult"
