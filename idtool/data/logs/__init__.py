"""Logs of joint signals. A new format is one new file in this folder.

A format's file gives `SUFFIXES`, the endings it is written under; `matches`, which knows it by a file's first bytes;
`read`; and `write`.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import shlex
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import BinaryIO, Protocol, cast

from idtool.common.exceptions import LogError
from idtool.common.names import suggestion
from idtool.common.provenance import source_from_file
from idtool.data.logs.bag import ROS1, SQLITE, files_of, is_bag, not_mcap, of_ros1
from idtool.data.logs.log import SIGNALS, Log, make_log

__all__ = ["SIGNALS", "Log", "is_bag", "make_log", "read_log", "write_log"]

_HEAD_BYTES = 4096
_GZIP = b"\x1f\x8b"


class _Format(Protocol):
    SUFFIXES: tuple[str, ...]

    def matches(self, head: bytes) -> bool: ...

    def read(self, path: Path, topic: str | None, columns: Mapping[str, str]) -> Log: ...

    def write(self, file: BinaryIO, log: Log) -> None: ...


@cache
def _formats() -> list[_Format]:
    modules = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return [cast(_Format, module) for module in modules if hasattr(module, "SUFFIXES")]


def read_log(
    path: str | os.PathLike[str],
    *,
    topic: str | None = None,
    columns: Mapping[str, str] = {},
    scale: Mapping[str, Mapping[str, float]] = {},
) -> Log:
    """Read a log, whatever its format.

    Parameters
    ----------
    path
        The file, or a rosbag2 folder. What a file holds tells the format, not its name.
    topic
        The topic that carries the joint states, where the log has several.
    columns
        Canonical name (``t``, ``q_hip``, …) to the column of the file that holds it, for CSV.
    scale
        Signal to joint to SI units per logged unit.

    Raises
    ------
    LogError
        If the file cannot be read, or does not hold what the options name.
    """
    path = Path(path)
    try:
        log = _read(path, topic, columns)
        sources = tuple(source_from_file("log", file) for file in files_of(path))
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None
    return _scaled(replace(log, sources=sources), scale)


def _read(path: Path, topic: str | None, columns: Mapping[str, str]) -> Log:
    """The log as its format's file reads it; OSError where that cannot."""
    if path.is_dir():
        from idtool.data.logs.mcap import read

        named = path if path.name or not is_bag(path) else path.resolve()  # the folder one is in
        return read(named, topic, columns)
    if not path.is_file():
        raise LogError(path, "there is no such file")
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        raise LogError(path, "is empty")
    for form in _formats():
        if form.matches(head):
            return form.read(path, topic, columns)
    if head.startswith(SQLITE):
        raise LogError(path, not_mcap(path, "sqlite3"))
    if head.startswith(ROS1):
        raise LogError(path, of_ros1(path))
    if head.startswith(_GZIP):
        raise LogError(path, f"is compressed with gzip; run 'gunzip -k {shlex.quote(str(path))}', give what it makes")
    raise LogError(path, f"is no log that can be read: {' or '.join(_endings())}, CSV in UTF-8")


def write_log(path: str | os.PathLike[str], log: Log) -> None:
    """Write a log in the format that the ending of ``path`` names.

    The file appears only when it is whole; until then what was there stays.

    Raises
    ------
    LogError
        If the ending is not known, or the log cannot be written.
    """
    path = Path(path)
    form = next((form for form in _formats() if path.suffix.lower() in form.SUFFIXES), None)
    if form is None:
        raise LogError(path, f"cannot be written under this ending; use {' or '.join(_endings())}")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            with part.open("wb") as file:
                form.write(file, log)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise LogError(path, f"cannot be written: {error.strerror or error}") from None
    except ValueError as error:
        raise LogError(path, f"cannot be written: {error}") from None


def _endings() -> list[str]:
    return [suffix for form in _formats() for suffix in form.SUFFIXES]


def _scaled(log: Log, scale: Mapping[str, Mapping[str, float]]) -> Log:
    """The log in SI units; its arrays are changed in place."""
    for signal, factors in scale.items():
        if factors and signal not in log.signals:
            raise LogError(log.path, f"log.scale: the log has no {signal}; {suggestion(signal, list(log.signals))}")
        for joint, factor in factors.items():
            if joint not in log.joints:
                raise LogError(
                    log.path, f"log.scale: {signal}: the log has no joint {joint}; {suggestion(joint, log.joints)}"
                )
            log.signals[signal][:, log.joints.index(joint)] *= factor
    return log
