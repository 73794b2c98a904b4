"""Which column of a table holds which signal of which joint.

A column is named ``<signal>_<joint>``, or ``<joint>.<field>`` or ``<joint>/<field>`` with the fields of a joint state;
before the joint there may be a topic, as in ``/joint_states/hip/position``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable, suggestion
from idtool.data.logs.log import SIGNALS

_TIMES = ("t", "time", "__time", "timestamp")
_FIELDS = {"position": "q", "velocity": "v", "effort": "tau"}
_CANONICAL = re.compile(rf"({'|'.join(SIGNALS)})_(.+)")
_FIELD = re.compile(rf"(.+)[./]({'|'.join(_FIELDS)})")

Signal = tuple[str, str]  # signal and joint


@dataclass(frozen=True)
class Columns:
    """Places of columns.

    Attributes
    ----------
    time
        That of the time.
    joints
        Names of the joints, in the order of their first columns.
    signals
        Signal to the place for each joint; None where the joint lacks it.
    unused
        Names of the other columns.
    """

    time: int
    joints: tuple[str, ...]
    signals: Mapping[str, Sequence[int | None]]
    unused: tuple[str, ...]


def find_columns(path: Path, header: Sequence[str], topic: str | None, named: Mapping[str, str]) -> Columns:
    """Find the columns of a header.

    Parameters
    ----------
    path
        The file; errors name it.
    header
        The columns' names.
    topic
        The topic that counts, where columns name several.
    named
        Canonical name to a column's name; goes before what the columns' own names say.

    Raises
    ------
    LogError
        If there is no time or no signal, two columns hold the same, or ``named`` names what is not there.
    """
    given = {_canonical(path, name): _place(path, header, column) for name, column in named.items()}
    free = {i: name for i, name in enumerate(header) if i not in given.values()}
    signals = {key: i for key, i in given.items() if isinstance(key, tuple)}
    for i, key in _signals(path, free, topic).items():
        other = signals.setdefault(key, i)
        if other != i and key not in given:
            raise LogError(path, _clash(header[other], header[i], key))
    time = given.get("t")
    if time is None:
        time = next((_place(path, header, name) for name in _TIMES if name in free.values()), None)
    if not signals:
        raise LogError(
            path,
            f"is no log: its first line names no joint signal, but {join_names(header)}; name the columns t, "
            "q_<joint>, v_<joint>, tau_<joint>, or map these to them in log.columns",
        )
    if time is None:
        raise LogError(path, "has no time column; name it t, or set log.columns: {t: <its name>}")
    joints = tuple(dict.fromkeys(joint for (_, joint), _ in sorted(signals.items(), key=lambda item: item[1])))
    if not all(map(str.isprintable, joints)):
        raise LogError(path, "names a joint in characters that cannot be printed")
    used = {time, *signals.values()}
    return Columns(
        time,
        joints,
        {s: [signals.get((s, joint)) for joint in joints] for s in SIGNALS if any(s == name for name, _ in signals)},
        tuple(name for i, name in enumerate(header) if name and i not in used),
    )


def _canonical(path: Path, name: str) -> Signal | str:
    """Key of a canonical name: itself for the time, else signal and joint."""
    match = _CANONICAL.fullmatch(name)
    if not match and name != "t":
        raise LogError(
            path,
            f"log.columns: {printable(name)} is no canonical name; use t or <signal>_<joint> ({join_names(SIGNALS)})",
        )
    return (match[1], match[2]) if match else name


def _place(path: Path, header: Sequence[str], column: str) -> int:
    if column not in header:
        raise LogError(path, f"has no column {printable(column)}; {suggestion(column, header)}")
    if header.count(column) > 1:
        raise LogError(path, f"has {header.count(column)} columns {printable(column)}; rename all but one")
    return header.index(column)


def _signals(path: Path, names: Mapping[int, str], topic: str | None) -> dict[int, Signal]:
    """Place to signal and joint, by the columns' own names."""
    fields = {i: match for i, name in names.items() if (match := _FIELD.fullmatch(name))}
    joints = _joints(path, {match[1] for match in fields.values()}, topic)
    found: dict[int, Signal] = {}
    for i, name in names.items():
        if i in fields:
            if joint := joints[fields[i][1]]:
                found[i] = (_FIELDS[fields[i][2]], joint)
        elif match := _CANONICAL.fullmatch(name):
            found[i] = (match[1], match[2])
    return found


def _joints(path: Path, stems: set[str], topic: str | None) -> dict[str, str | None]:
    """What stands before a field, to the joint's name; None where it is on another topic.

    The topic is ``topic``. Else it is all up to the last slash, where names begin with a slash as those of topics do;
    and what all names have in common, where they do not, as joints' own names may hold slashes.
    """
    rooted = {stem for stem in stems if stem.startswith("/")}
    if topic is not None and rooted:
        before = f"/{topic.strip('/')}/"
        if not any(stem.startswith(before) for stem in rooted):
            raise LogError(path, f"has no columns of topic {topic}; {suggestion(topic, _topics(rooted))}")
        joints = {stem: stem.removeprefix(before) if stem.startswith(before) else None for stem in rooted}
    else:
        joints = {stem: stem.rpartition("/")[2] for stem in rooted}
    others = stems - rooted
    folders = [stem.split("/")[:-1] for stem in others]
    common = len(list(takewhile(lambda parts: len(set(parts)) == 1, zip(*folders, strict=False))))
    return joints | {stem: "/".join(stem.split("/")[common:]) for stem in others}


def _topics(stems: set[str]) -> list[str]:
    return sorted({stem.rpartition("/")[0] for stem in stems})


def _clash(first: str, second: str, key: Signal) -> str:
    if first == second:
        return f"has two columns {printable(first)}; rename or remove one"
    both = f"columns {printable(first)} and {printable(second)}"
    if first.startswith("/") and second.startswith("/"):
        return f"{both} are of different topics; set log.topic to the one to read"
    name = printable("_".join(key))
    return f"{both} both hold {name}; set log.columns: {{{name}: <one of them>}}"
