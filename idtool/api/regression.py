"""`regression`: every case of a manifest, fitted and compared with its recorded bounds."""

from __future__ import annotations

from idtool.api.results import Progress, ignore_progress
from idtool.estimation.regression import find_manifest, read_manifest, run_case
from idtool.reporting.results.validation import RegressionCase, RegressionReport


def regression(progress: Progress | None = None) -> RegressionReport:
    """Run the regression; `idtool validate` without arguments.

    Parameters
    ----------
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If there is no manifest, or a file in it cannot be used.
    """
    manifest = find_manifest()
    cases = []
    for case in read_manifest(manifest):
        for outcome in run_case(case, manifest.parent, progress or ignore_progress):
            cases.append(RegressionCase(**vars(outcome), ok=outcome.ok))
    return RegressionReport(cases=cases)
