"""Record of `idtool sample`."""

from __future__ import annotations

from idtool.common.samples import SampleName
from idtool.reporting.results.base import Result, field


class SampleReport(Result):
    """Result of `idtool sample`."""

    sample: SampleName = field("Name of the sample.")
    files: tuple[str, ...] = field("Its files.")
    written: tuple[str, ...] = field("The files that were written; the others were there already.")
    next: str = field("A first command for them.")
