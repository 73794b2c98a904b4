"""The verdict on a model, above all else that `fit`, `validate` and `diagnose` print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from idtool.reporting.results.verdict import VerdictLevel, VerdictReason
from idtool.reporting.terminal.output import STYLE, Output
from idtool.reporting.verdict import LEVEL_TEXTS

_MARKS: Mapping[VerdictLevel, str] = {"good": "✓", "torque_only": "!", "do_not_use": "✗"}
_STYLES: Mapping[VerdictLevel, str] = {
    "good": STYLE.get("good", "green"),
    "torque_only": STYLE["warning"],
    "do_not_use": STYLE["problem"],
}


def show_verdict(
    terminal: Output, level: VerdictLevel, reasons: Sequence[VerdictReason], next_steps: Sequence[str] = ()
) -> None:
    """The verdict, its reasons, and what to do next, one a line."""
    terminal.say(f"Verdict: {LEVEL_TEXTS[level]}", _STYLES[level])
    for reason in reasons:
        style = None if reason.level == "good" else _STYLES[reason.level]
        terminal.say(f"{_MARKS[reason.level]} {reason.about}: {reason.text}", style)
    for text in next_steps:
        terminal.say(f"next: {text}")
    terminal.say("")
