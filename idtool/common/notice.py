"""`Notice`: something that a user should know about a log, a model or a result."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Literal

from idtool.common.dataclass import dataclass

Severity = Literal["note", "warning", "problem"]
SEVERITIES: tuple[Severity, ...] = ("problem", "warning", "note")  # the worst first


@dataclass(frozen=True)
class Notice:
    """Something that a user should know about a log, a model or a result.

    Attributes
    ----------
    code
        What it is, one word for programs; docs/pages/notices.md lists all codes.
    severity
        ``note``: nothing has to be done; ``warning``: the result may be worse for it; ``problem``: what it is about
        can't be used as it is.
    subject
        The joint, link, file or setting it is about; None: all of them, or several, which the message names.
    message
        What is to be known of the subject, with figures: one sentence without a full stop.
    advice
        What it means and what to do about it, without a full stop; empty where the message is enough. Notices of one
        cause have the same advice.
    """

    code: str
    severity: Severity
    subject: str | None
    message: str
    advice: str = ""

    def about(self, subject: str) -> Notice:
        """A copy of the notice with another subject."""
        return replace(self, subject=subject)

    def in_log(self, log: str) -> Notice:
        """A copy of the notice about a log, whose message names what it was about."""
        message = self.message if self.subject in (None, log) else self.sentence
        return replace(self, subject=log, message=message)

    @property
    def sentence(self) -> str:
        """Subject and message."""
        return f"{self.subject}: {self.message}" if self.subject else self.message

    @property
    def text(self) -> str:
        """Subject, message and advice."""
        return f"{self.sentence}; {self.advice}" if self.advice else self.sentence


def unique(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """The notices without duplicates, in their order."""
    return tuple(dict.fromkeys(notices))
