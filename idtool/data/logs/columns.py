"""The columns of a table by signal and joint.

A column is named ``<signal>_<joint>``, or ``<joint>.<field>`` or ``<joint>/<field>`` with the fields of a joint state;
a topic may precede the joint, as in ``/joint_states/hip/position``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import closest_name, join_names, printable, suggestion
from idtool.data.logs.log import SIGNALS
from idtool.data.logs.sensor_channels import SENSOR_CHANNEL

_TIME_NAMES = ("t", "time", "__time", "timestamp")
_FIELDS = {"position": "q", "velocity": "v", "effort": "tau"}
_CANONICAL = re.compile(rf"({'|'.join(SIGNALS)})_(.+)")
_FIELD = re.compile(rf"(.+)[./]({'|'.join(_FIELDS)})")

JointSignal = tuple[str, str]  # signal and joint


@dataclass(frozen=True)
class ColumnMap:
    """Indices of the columns of a table.

    Attributes
    ----------
    time
        Index of the time column.
    joints
        Joint names, in the order of their first columns.
    signals
        Signal to the index of its column for each joint; None for a joint that lacks it.
    unused
        Names of the other columns.
    channels
        Channel of a sensor to the index of its column; see `sensor_channels`.
    """

    time: int
    joints: tuple[str, ...]
    signals: Mapping[str, Sequence[int | None]]
    unused: tuple[str, ...]
    channels: Mapping[str, int]


def find_columns(path: Path, header: Sequence[str], topic: str | None, mapping: Mapping[str, str]) -> ColumnMap:
    """Find the columns of a header.

    Parameters
    ----------
    path
        The file; errors name it.
    header
        Names of the columns.
    topic
        The topic to read, if columns of several topics are in the table.
    mapping
        Canonical name to the name of a column; takes precedence over the canonical names in the header.

    Raises
    ------
    LogError
        If there is no time or no signal, two columns have the same signal, or ``mapping`` names a missing column.
    """
    mapped = {_parse_canonical(path, name): _column_index(path, header, column) for name, column in mapping.items()}
    unmapped = {i: name for i, name in enumerate(header) if i not in mapped.values()}
    columns = {key: i for key, i in mapped.items() if isinstance(key, tuple)}
    channels = {key: i for key, i in mapped.items() if isinstance(key, str) and key != "t"}
    for i, name in unmapped.items():
        if SENSOR_CHANNEL.fullmatch(name):
            channels.setdefault(name, i)
    for i, key in _recognize(path, unmapped, topic).items():
        other = columns.setdefault(key, i)
        if other != i and key not in mapped:
            raise LogError(path, _conflict_message(header[other], header[i], key))
    time = mapped.get("t")
    if time is None:
        for name in _TIME_NAMES:
            if time is None and name in unmapped.values():
                time = _column_index(path, header, name)
    if not columns:
        raise LogError(
            path,
            f"is not a log: its first line has no joint signal (columns: {join_names(header)}); name the columns t, "
            "q_<joint>, v_<joint>, tau_<joint>, or map them in log.columns",
        )
    if time is None:
        raise LogError(path, "has no time column; name it t, or set log.columns: {t: <its name>}")
    in_order = sorted(columns, key=lambda key: columns[key])
    joints = tuple(dict.fromkeys(joint for _, joint in in_order))
    if not all(map(str.isprintable, joints)):
        raise LogError(path, "has a joint name with characters that cannot be printed")
    present = {signal for signal, _ in columns}
    signals = {name: [columns.get((name, joint)) for joint in joints] for name in SIGNALS if name in present}
    used = {time, *columns.values(), *channels.values()}
    unused = tuple(name for i, name in enumerate(header) if name and i not in used)
    return ColumnMap(time, joints, signals, unused, channels)


def _parse_canonical(path: Path, name: str) -> JointSignal | str:
    """Signal and joint of a canonical name; that of the time or of a sensor's channel is returned as it is."""
    match = _CANONICAL.fullmatch(name)
    if not match and name != "t" and not SENSOR_CHANNEL.fullmatch(name):
        raise LogError(path, f"log.columns: {printable(name)} is not a canonical name; {_canonical_hint(name)}")
    return (match[1], match[2]) if match else name


def _canonical_hint(name: str) -> str:
    """Hint for a name that is not canonical: the most similar one that is, or how they are made."""
    word, separator, joint = name.partition("_")
    if separator:
        signal = _FIELDS.get(word) or closest_name(word, SIGNALS)
        closest = f"{signal}_{joint}" if signal else None
    else:
        closest = closest_name(name, ["t"])
    if closest:
        return f"did you mean {printable(closest)}?"
    return f"use t or <signal>_<joint> ({join_names(SIGNALS)})"


def _column_index(path: Path, header: Sequence[str], column: str) -> int:
    if column not in header:
        raise LogError(path, f"has no column {printable(column)}; {suggestion(column, header)}")
    if header.count(column) > 1:
        raise LogError(path, f"has {header.count(column)} columns {printable(column)}; rename all but one")
    return header.index(column)


def _recognize(path: Path, names: Mapping[int, str], topic: str | None) -> dict[int, JointSignal]:
    """Signal and joint of each column with a canonical name or a joint state's field, by index."""
    fields = {i: match for i, name in names.items() if (match := _FIELD.fullmatch(name))}
    joints = _joint_names(path, {match[1] for match in fields.values()}, topic)
    recognized: dict[int, JointSignal] = {}
    for i, name in names.items():
        if i in fields:
            prefix, field = fields[i].groups()
            if joint := joints[prefix]:
                recognized[i] = (_FIELDS[field], joint)
        elif match := _CANONICAL.fullmatch(name):
            recognized[i] = (match[1], match[2])
    return recognized


def _joint_names(path: Path, prefixes: set[str], topic: str | None) -> dict[str, str | None]:
    """Joint name for each text before a field; None if it is on another topic.

    The topic is ``topic``, if given. Otherwise, it is everything up to the last slash in names that begin with a slash,
    as topics do, and the common part of all names that do not, as joint names may have slashes of their own.
    """
    rooted = {prefix for prefix in prefixes if prefix.startswith("/")}
    joints: dict[str, str | None] = {}
    if topic is not None and rooted:
        topic_prefix = f"/{topic.strip('/')}/"
        if not any(prefix.startswith(topic_prefix) for prefix in rooted):
            topics = sorted({prefix.rpartition("/")[0] for prefix in rooted})
            raise LogError(path, f"has no columns of topic {topic}; {suggestion(topic, topics)}")
        for prefix in rooted:
            joints[prefix] = prefix.removeprefix(topic_prefix) if prefix.startswith(topic_prefix) else None
    else:
        for prefix in rooted:
            joints[prefix] = prefix.rpartition("/")[2]
    others = prefixes - rooted
    folders = [prefix.split("/")[:-1] for prefix in others]
    common = len(list(takewhile(lambda parts: len(set(parts)) == 1, zip(*folders, strict=False))))
    for prefix in others:
        joints[prefix] = "/".join(prefix.split("/")[common:])
    return joints


def _conflict_message(first: str, second: str, key: JointSignal) -> str:
    if first == second:
        return f"has two columns {printable(first)}; rename or remove one"
    both = f"columns {printable(first)} and {printable(second)}"
    if first.startswith("/") and second.startswith("/"):
        return f"{both} are of different topics; set log.topic to the one to read"
    name = printable("_".join(key))
    return f"{both} both match {name}; set log.columns: {{{name}: <one of them>}}"
