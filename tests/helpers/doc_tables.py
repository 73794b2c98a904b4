"""What the reference pages name in the first column of their tables."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from doc_pages import PAGES

Path = tuple[str, ...]


def section(page: str, heading: str) -> str:
    """What stands below a heading, up to the next of its level."""
    text = (PAGES / page).read_text()
    level = heading.split()[0]
    body = text.partition(f"\n{heading}\n")[2]
    assert body, f"{page} has no {heading}"
    return re.split(rf"^#{{1,{len(level)}}} ", body, flags=re.M)[0]


def rows(text: str) -> Iterator[list[str]]:
    """The cells of the tables' rows, but for their heads."""
    for line in text.splitlines():
        if line.startswith("| ") and not re.match(r"\| (key|---|\|)", line):
            yield [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def codes(cell: str) -> list[str]:
    """What is set as code in a cell."""
    return re.findall(r"`([^`]+)`", cell)


def keys(text: str) -> list[str]:
    """The keys that tables document."""
    return [key for row in rows(text) for key in codes(row[0])]


def leaves(x: Any, at: Path = ()) -> Iterator[tuple[Path, bool]]:
    """Where plain data end, and whether with nothing; ``[]`` behind a list of objects."""
    if isinstance(x, dict) and x:
        for key, value in x.items():
            yield from leaves(value, (*at, key))
    elif isinstance(x, list) and x and isinstance(x[0], dict):
        for value in x:
            yield from leaves(value, (*at[:-1], at[-1] + "[]"))
    else:
        yield at, x in (None, [], {})


def begin_alike(documented: str, real: Path, names: Mapping[str, set[str]]) -> bool:
    """Whether a key of the documentation and a real one are the same as far as the shorter one goes.

    ``<joint>`` is one of ``names["joint"]``.
    """
    for key, name in zip(documented.split("."), real, strict=False):
        part, found = key.removesuffix("[]"), name.removesuffix("[]")
        if named := re.fullmatch(r"<(\w+)>", part):
            if named[1] in names and found not in names[named[1]]:
                return False
        elif part != found:
            return False
    return True


def misfits(text: str, reports: Sequence[Any], names: Mapping[str, set[str]], whole: Collection[str]) -> list[str]:
    """Keys of reports that tables do not name, and the other way round.

    Parameters
    ----------
    text
        The tables.
    reports
        Plain data.
    names
        What placeholders stand for.
    whole
        Keys that are documented with all they hold.
    """
    documented = keys(text)
    real = {leaf for one in reports for leaf in leaves(one)}
    found = []
    for leaf, empty in real:
        alike = [len(key.split(".")) for key in documented if begin_alike(key, leaf, names)]
        exact = len(leaf) in alike or (leaf[0].removesuffix("[]") in whole and 1 in alike)
        if not (exact or (empty and max(alike, default=0) > len(leaf))):
            found.append(f"{'.'.join(leaf)} is not documented")
    for key in documented:
        if not any(len(key.split(".")) <= len(leaf) and begin_alike(key, leaf, names) for leaf, _ in real):
            found.append(f"there is no {key}")
    return sorted(set(found))
