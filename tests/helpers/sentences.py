"""Notices as the sentences that a user reads."""

from __future__ import annotations

from collections.abc import Iterable

from idtool.common.notice import Notice


def sentences(notices: Iterable[Notice]) -> tuple[str, ...]:
    """Subject and message of every notice."""
    return tuple(notice.sentence for notice in notices)


def texts(notices: Iterable[Notice]) -> tuple[str, ...]:
    """Subject, message and advice of every notice."""
    return tuple(notice.text for notice in notices)
