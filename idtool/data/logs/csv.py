"""CSV logs: a first line that names the columns, then one line per sample."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from idtool.common.exceptions import LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.logs.columns import find_columns
from idtool.data.logs.interleaved import log_of
from idtool.data.logs.log import SIGNALS, Log, truncation
from idtool.data.logs.series import Samples, Series
from idtool.data.logs.table import Table
from idtool.data.logs.times import in_seconds

SUFFIXES = (".csv",)

_BLOCK = 1 << 14  # samples written together
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")


def matches(head: bytes) -> bool:
    """Whether a file that begins with ``head`` is text in UTF-8."""
    try:
        head.decode()
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # else a character that goes on behind the head
            return False
    return not _CONTROL.search(head)


def read(path: Path, topic: str | None, columns: Mapping[str, str]) -> Log:
    """Read a table whose columns are named as the contract says, or by ``columns``; ``topic`` chooses among topics.

    Raises
    ------
    LogError
        If the first line names no signals, or another line does not fit it.
    """
    with path.open("rb") as file:
        table = Table(path, file)
        found = find_columns(path, table.header, topic, columns)
        used = [found.time, *(i for places in found.signals.values() for i in places if i is not None)]
        # a joint that lacks a signal gets it from one more column, at the end, of NaN
        places = {name: [used.index(i) if i is not None else -1 for i in of] for name, of in found.signals.items()}
        series, others = Series(path), 0
        for rows in table.rows(used):
            held = rows[~np.isnan(rows[:, 1:]).all(axis=1)]
            others += len(rows) - len(held)
            wide = np.pad(held, ((0, 0), (0, 1)), constant_values=np.nan)
            signals = {name: wide[:, of] for name, of in places.items()}
            series.append([Samples(np.arange(len(held)), held[:, 0], found.joints, signals)])
    if not len(series):
        raise LogError(path, "has no samples after its first line")
    t, joints, arrays = series.arrays()
    notices: list[Notice] = []
    if found.unused:
        message = f"columns that hold no joint signal were ignored: {join_names(found.unused)}"
        advice = "if one of them does, name it under log.columns in the configuration"
        notices.append(Notice("unused_columns", "note", None, message, advice))
    if others:
        message = f"{others} rows that hold no joint signal were passed over"
        notices.append(Notice("unused_rows", "note", None, message))
    notices += in_seconds(t)
    if table.cut:
        notices.append(truncation("the file", f"{len(t)} samples, up to t = {t[-1]:.3f} s"))
    return log_of(path, t, joints, arrays, tuple(notices))


def write(file: BinaryIO, log: Log) -> None:
    """Write a log under its canonical names, every number to its last digit."""
    columns = [(name, j) for j, joint in enumerate(log.joints) for name in SIGNALS if log.has(name, joint)]
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(["t", *(f"{name}_{log.joints[j]}" for name, j in columns)])
    file.write(header.getvalue().encode())
    for start in range(0, len(log), _BLOCK):
        rows = slice(start, start + _BLOCK)
        table = np.column_stack([log.t[rows], *(log.signals[name][rows, j] for name, j in columns)])
        file.writelines(",".join(map(repr, row)).encode() + b"\n" for row in table.tolist())
