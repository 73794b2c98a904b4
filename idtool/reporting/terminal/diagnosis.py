"""The result of `idtool diagnose`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from idtool.reporting.diagnosis_text import (
    UNKNOWN,
    effect_name,
    is_correctable,
    owner_name,
    step_title,
    worse_motion,
    worse_motion_sentence,
)
from idtool.reporting.results.diagnosis import DiagnosisReport, StepReport
from idtool.reporting.sections.against import ChangesSection, SimulatorGapSection
from idtool.reporting.sections.diagnosis import (
    CandidatesSection,
    ErrorsBeforeAfterSection,
    StepsSection,
    score_text,
)
from idtool.reporting.terminal.output import STYLE, Output
from idtool.reporting.terminal.verdict import show_verdict

_MODEL_FILES = ("identified.urdf", "model.yaml")


def show_diagnosis(
    terminal: Output,
    report: DiagnosisReport,
    folder: Path | None = None,
    files: Sequence[str] = (),
    explain: bool = False,
) -> None:
    """The verdict, what was found and how sure it is, errors before and after, and what to do next.

    Parameters
    ----------
    terminal
        The terminal, or a notebook.
    report
        The content of diagnosis.json.
    folder, files
        Files that were written; None: there are none.
    explain
        True to list the rejected candidates with reasons.
    """
    show_verdict(terminal, report.model_verdict, report.verdict_reasons, report.next)
    _show_data_faults(terminal, report)
    _show_steps(terminal, report)
    _show_errors(terminal, report)
    if explain:
        _show_rejected(terminal, report.steps)
    if report.against is not None:
        terminal.say(report.against.summary, STYLE["warning"] if report.against.inconclusive else "bold")
        terminal.say("")
        terminal.sections([ChangesSection(), SimulatorGapSection()], report)
    terminal.notices(report.further_notices)
    if folder is not None:
        _show_files(terminal, folder, files)


def _show_files(terminal: Output, folder: Path, files: Sequence[str]) -> None:
    """Print the files that were written, and those of an earlier run beside them."""
    terminal.say(f"written: {folder}/{', '.join(files)}")
    older = [name for name in _MODEL_FILES if name not in files and (folder / name).exists()]
    if older:
        terminal.say(f"warning: not of this run, but of an earlier one: {', '.join(older)}", STYLE["warning"])


def _show_data_faults(terminal: Output, report: DiagnosisReport) -> None:
    """Print the faults of the data that the verdict does not name, those first that idtool does not correct."""
    for fault in report.lesser_faults:
        on_joint = f" ({fault.joint})" if fault.joint else ""
        kind, style = "data fault", "problem" if is_correctable(fault) else "warning"
        if fault.undone:
            kind, style = "note on the data", "note"
        terminal.say(f"{kind}{on_joint}: {fault.detail}", STYLE[style])
    if report.lesser_faults:
        terminal.say("")


def _show_steps(terminal: Output, report: DiagnosisReport) -> None:
    """Print the table of the steps, and a sentence for each below."""
    terminal.sections([StepsSection()], report)
    for i, step in enumerate(report.steps, 1):
        _show_step(terminal, i, step, report)
    for text in report.removed:
        terminal.say(text)
    if report.steps or report.removed:
        terminal.say("")


def _show_step(terminal: Output, index: int, step: StepReport, report: DiagnosisReport) -> None:
    """Print a step as a sentence, and what speaks against it in colour."""
    evidence = step.evidence
    terminal.say(
        f"{index}. {step_title(step)}. {evidence.sentence}", STYLE["warning"] if step.effect == UNKNOWN else None
    )
    if evidence.pair and step.alternatives:
        rival = step.alternatives[0]
        name = effect_name(rival.effect)
        terminal.say(
            f"   these data cannot distinguish it from {name} on {owner_name(rival)}: it explains "
            f"{score_text(evidence.score, evidence.standard_error)} of the residual, and {name} explains "
            f"{score_text(rival.score, rival.standard_error)}",
            STYLE["warning"],
        )
    if worse_motion(step):
        terminal.say(f"   {worse_motion_sentence(step, report)}", STYLE["problem"])


def _show_errors(terminal: Output, report: DiagnosisReport) -> None:
    """Print the errors by joint, before, after and at the noise floor."""
    terminal.sections([ErrorsBeforeAfterSection()], report)


def _show_rejected(terminal: Output, steps: Sequence[StepReport]) -> None:
    """Print the reason why each candidate was rejected."""
    for i, step in enumerate(steps, 1):
        terminal.sections([CandidatesSection(f"Step {i}: rejected candidates")], step)
