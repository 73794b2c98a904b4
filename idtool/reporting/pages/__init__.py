"""Results → HTML: one self-contained file for each page, readable without a network; one module for each page."""

from idtool.reporting.pages.adapt import adapt_page
from idtool.reporting.pages.diagnosis import diagnosis_page
from idtool.reporting.pages.fit import fit_page
from idtool.reporting.pages.study import study_page
from idtool.reporting.pages.validation import validation_page

__all__ = ["adapt_page", "diagnosis_page", "fit_page", "study_page", "validation_page"]
