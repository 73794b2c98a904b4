"""The check of blocks of output finds what is not as printed."""

from __future__ import annotations

import pytest
from doc_outputs import check_output

PRINTED = "head 40 Hz\na 1.00\nb 2.00\n\nhead 20 Hz\na 1.10\nend\n"


@pytest.mark.parametrize(
    "shown",
    [
        PRINTED,
        "head 41 Hz\n  a 1.04\nb 2\nhead 20 Hz\na 1.1\nend",
        "…\nhead 20 Hz\n…",
        "…\nhead 21 Hz\na 1.09\nend",
        "head 40 Hz\n…\nend",
        "head 40 Hz\n…\nb 2\n…\na 1.1\nend",
        "…",
    ],
)
def test_what_was_printed_may_be_shown(shown: str) -> None:
    check_output(shown, PRINTED, "here")


@pytest.mark.parametrize(
    "shown",
    [
        "head 40 Hz",
        "end",
        "a 1.00\n…",
        "…\na 1.00",
        "head 40 Hz\nb 2.00\n…",
        "…\nhead 20 Hz\n…\nb 2.00\n…",
        "…\na 1.3\n…",
        "…\nhead 20 kHz\n…",
        "…\nend\n…\nend",
        PRINTED + "more",
    ],
)
def test_what_was_not_printed_may_not(shown: str) -> None:
    with pytest.raises(AssertionError, match="here"):
        check_output(shown, PRINTED, "here")
