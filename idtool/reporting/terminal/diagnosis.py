"""The result of `idtool diagnose`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from idtool.reporting.diagnosis_words import UNKNOWN, on, position_units, together
from idtool.reporting.pages import number
from idtool.reporting.pages.diagnosis import parameter_texts, score_text
from idtool.reporting.results.diagnosis import DiagnosisReport, StepReport
from idtool.reporting.terminal.base import STYLE, Terminal, new_table
from idtool.reporting.terminal.tables import Words

_STYLES = {"explained": "bold green", "no_disagreement": "bold green", "unexplained": STYLE["problem"]}


def show_diagnosis(
    terminal: Terminal, report: DiagnosisReport, folder: Path, files: Sequence[str], explain: bool
) -> None:
    """The verdict, what was found and how sure it is, errors before and after, and what to do next.

    Parameters
    ----------
    terminal
        Where to.
    report
        The content of diagnosis.json.
    folder, files
        What was written.
    explain
        Whether to tell why each rejected candidate lost.
    """
    for fault in sorted(report.data_faults, key=lambda fault: bool(fault.undone)):
        on_joint = f"{fault.joint}: " if fault.joint else ""
        kind, style = ("note on", "note") if fault.undone else ("fault of", "problem")
        what = fault.fault.replace("_", " ")
        terminal.say(f"{kind} the data: {on_joint}{what}: {fault.detail}", STYLE[style])
    terminal.say(report.summary, _STYLES.get(report.verdict, f"bold {STYLE['warning']}"))
    terminal.say("")
    _show_steps(terminal, report)
    _show_errors(terminal, report)
    if explain:
        _show_rejected(terminal, report.steps)
    for text in report.next:
        terminal.say(f"next: {text}")
    terminal.notices(report.further_notices)
    terminal.say(f"written: {folder}/{', '.join(files)}")


def _show_steps(terminal: Terminal, report: DiagnosisReport) -> None:
    """One line a step, and a sentence each below."""
    named = [(i, step) for i, step in enumerate(report.steps, 1) if step.effect != UNKNOWN]
    if named:
        torque, length = together(report.units), together(position_units(report.units))
        data = "held-out torque" if report.before.validation else "torque"
        table = new_table(
            "What the model lacks, step by step",
            "step",
            (Words("effect"), Words("on")),
            Words("parameters"),
            *(f"{data} RMS, {torque}", f"rollout, {length}"),
            ("explains", "in se"),
            Words("or"),
        )
        for i, step in named:
            table.add_row(str(i), *_row(step))
        terminal.show(table)
    for i, step in enumerate(report.steps, 1):
        _tell(terminal, i, step, report.units)
    for text in report.removed:
        terminal.say(f"taken out again: {text}")
    if report.steps or report.removed:
        terminal.say("")


def _row(step: StepReport) -> list[str]:
    """The cells of a step but for its number."""
    found = step.evidence
    rival = step.alternatives[0] if found.pair and step.alternatives else None
    return [
        step.effect,
        on(step),
        ", ".join(parameter_texts(step)),
        _change(step.validation_rms_before, step.validation_rms_after),
        _change(found.simulation_before, found.simulation_after),
        score_text(found.score, found.standard_error),
        number(found.significance, 2),
        f"{rival.effect} {on(rival)}" if rival else "",
    ]


def _change(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None, name: str = "overall") -> str:
    return f"{number(before[name])} → {number(after[name])}" if before and after else "–"


def _tell(terminal: Terminal, index: int, step: StepReport, units: Mapping[str, str]) -> None:
    """A step in a sentence; what speaks against it in colour."""
    found = step.evidence
    terminal.say(f"{index}. {found.sentence}", STYLE["warning"] if step.effect == UNKNOWN else None)
    if found.pair and step.alternatives:
        rival = step.alternatives[0]
        terminal.say(
            f"   cannot be told from {rival.effect} on {on(rival)} by these data: explains "
            f"{score_text(found.score, found.standard_error)} against "
            f"{score_text(rival.score, rival.standard_error)}",
            STYLE["warning"],
        )
    if worse := found.rollout_worse:
        lengths = {**position_units(units), "overall": together(position_units(units))}
        errors = (
            f"{name} {_change(found.simulation_before, found.simulation_after, name)} {lengths[name]}" for name in worse
        )
        terminal.say(f"   its rollouts got worse while the torque got better: {', '.join(errors)}", STYLE["problem"])


def _show_errors(terminal: Terminal, report: DiagnosisReport) -> None:
    """Errors by joint, before, after and at the noise floor."""
    held_out = report.before.validation is not None
    first, last = report.before, report.after
    before = first.validation or first.train
    after = last.validation or last.train
    simulated = (first.simulation, last.simulation) if first.simulation and last.simulation else None
    torque = ("before", "after", "noise floor", "gap closed")
    title = f"RMS torque error{' on held-out data' if held_out else ''}, {together(report.units)}"
    if simulated:
        title += f"; rollouts' position error, {together(position_units(report.units))}"
    table = new_table(title, "joint", torque, *([("rollout before", "after")] if simulated else []))
    for name in (*report.joints, "overall"):
        share = report.gap_closed[name]
        cells: list[str | Text] = [number(errors[name]) for errors in (before, after, report.noise_floor)]
        cells.append("–" if share is None else f"{100 * share:.0f} %")
        if simulated:
            worse = name in report.rollout_worse
            error = number(simulated[1][name])
            cells += [number(simulated[0][name]), Text(f"{error} worse", STYLE["problem"]) if worse else error]
        table.add_row(name, *cells)
    terminal.show(table)
    if "overall" in report.rollout_worse:
        terminal.say("The rollouts got worse while the torque got better: do not simulate with it.", STYLE["problem"])


def _show_rejected(terminal: Terminal, steps: Sequence[StepReport]) -> None:
    """Why each candidate that was not taken lost."""
    for i, step in enumerate(steps, 1):
        others = [*step.alternatives, *step.rejected]
        if not others:
            continue
        said = ("explains", "parameters", Words("why not"))
        table = new_table(f"Step {i}: what else was tried", ("effect", "on"), *said)
        for one in others:
            score = score_text(one.score, one.standard_error)
            table.add_row(one.effect, on(one), score, str(one.parameters), one.reason)
        terminal.show(table)
