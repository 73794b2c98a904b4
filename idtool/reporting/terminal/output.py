"""`Output`: what the results of commands are shown on, a terminal or a notebook."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TypeVar

from idtool.reporting.results.base import NoticeReport
from idtool.reporting.sections.base import Section, Table

STYLE = {"problem": "bold red", "warning": "yellow", "note": "dim", "good": "bold green"}
EMPHASIS_STYLE = {None: "", "good": STYLE["good"], "note": STYLE["warning"], "bad": STYLE["problem"]}

R = TypeVar("R")


class Output(ABC):
    """Sentences, tables and notices, one below the other."""

    @abstractmethod
    def say(self, text: str, style: str | None = None) -> None:
        """Add plain text, usually one line."""

    @abstractmethod
    def show(self, table: Table) -> None:
        """Add a table under its title."""

    def sections(self, sections: Sequence[Section[R]], report: R) -> None:
        """Add the tables of those sections of which the report holds something."""
        for section in sections:
            table = section.table(report)
            if table is not None:
                self.show(table)

    def notices(self, notices: Sequence[NoticeReport]) -> None:
        """Add notices, and below those with the same advice, the advice."""
        for advice, alike in itertools.groupby(notices, key=lambda notice: notice.advice):
            for (severity, message), same in itertools.groupby(
                alike, key=lambda notice: (notice.severity, notice.message)
            ):
                subjects = [notice.subject for notice in same if notice.subject]
                sentence = f"{', '.join(subjects)}: {message}" if subjects else message
                self.say(f"{severity}: {sentence}", STYLE[severity])
            if advice:
                self.say(f"    {advice}")


def without_control_characters(text: str) -> str:
    """The text, which may hold a stranger's names, without characters that steer a terminal or turn text round."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
