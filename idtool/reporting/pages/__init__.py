"""Results → HTML: one file each that needs nothing else, readable without a network. One file here a page."""

from idtool.reporting.figures import by_unit, metres, number, percent, with_error
from idtool.reporting.pages.adapt import adapt_page
from idtool.reporting.pages.diagnosis import diagnosis_page
from idtool.reporting.pages.fit import fit_page
from idtool.reporting.pages.study import study_page
from idtool.reporting.pages.validation import validation_page

__all__ = [
    "adapt_page",
    "by_unit",
    "diagnosis_page",
    "fit_page",
    "metres",
    "number",
    "percent",
    "study_page",
    "validation_page",
    "with_error",
]
