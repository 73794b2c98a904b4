"""The check of blocks of output finds what is not as printed."""

from __future__ import annotations

from pathlib import Path

import pytest
from doc_outputs import check_output, updated_output
from doc_pages import Reader

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


@pytest.mark.parametrize(
    ("shown", "updated"),
    [
        (PRINTED, PRINTED.strip()),
        ("head of the table\na 7\nold\nend", PRINTED.strip()),
        ("…\nhead 30 Hz\na 9\n…", "…\nhead 40 Hz\na 1.00\n…"),
        ("head 41 Hz\nb 3\n…\nthe end", "head 40 Hz\na 1.00\nb 2.00\n…\nend"),
    ],
)
def test_a_block_is_updated_and_then_agrees(shown: str, updated: str) -> None:
    assert updated_output(shown, PRINTED) == updated
    check_output(updated, PRINTED, "here")


def test_a_page_is_updated_and_then_agrees(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    command = "```sh\npython -c \"print('a 1'); print('b 2')\"\n```\n\n"
    page.write_text(f"{command}```text\na 1\nold 3\n```\n")
    for name in ("refuses", "updates", "agrees"):
        (tmp_path / name).mkdir()
    with pytest.raises(AssertionError, match="--update-docs"):
        Reader(tmp_path / "refuses", slow=True).read(page)
    Reader(tmp_path / "updates", slow=True, update=True).read(page)
    assert page.read_text() == f"{command}```text\na 1\nb 2\n```\n"
    Reader(tmp_path / "agrees", slow=True).read(page)
