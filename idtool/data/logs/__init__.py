"""Logs of joint signals. A new format is one new file in this folder.

A format's file defines `SUFFIXES`, its file name extensions; `matches`, which recognizes the first bytes of a file;
`read`; and `write`. A reader must

- call `convert_to_seconds(t)`, which converts t in place and returns notices;
- check the joint names (`check_names`: printable, each once) and the shapes: t (N,), signals (N, number of joints);
- return `make_log(...)`, or `make_log_of_complete_samples(...)` if some samples lack signals. Arrays are float64 and
  belong to the log, which may change them;
- add a notice for everything that it ignores: data in the file, and the options ``topic``, ``columns`` and
  ``messages`` if the format has no use for them;
- raise `LogError` with one clear line for every kind of damaged file, and bound its memory by the size of the file,
  whatever sizes the file declares (`check_expanded_size`).

`csv` is an example. `SampleBuffer` is for files whose samples are read one after the other; others don't need it. It
keeps the samples of long logs in a file, so whoever goes through a log does so in blocks (`stored_arrays`).

Add the format's name to `LOG_FORMATS` in `idtool/cli/options.py`, which help texts show, and to the pages that list the
formats, and rows to the tables of `tests/data/test_logs_front_door.py` and `test_logs_fuzz.py`.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, BinaryIO, Protocol, cast

from idtool.common.exceptions import LogError
from idtool.common.input_files import REDUCTION_SUFFIX, missing_file_advice
from idtool.common.names import is_url, printable, suggestion, without_secrets
from idtool.common.outputs import OutputError, check_file
from idtool.common.provenance import source_from_file
from idtool.common.threads import BackgroundThread
from idtool.common.urls import local_copy, log_path
from idtool.data.logs.bag import METADATA, ROS1, SQLITE, is_bag, log_files, ros1_message, wrong_storage_message
from idtool.data.logs.log import SIGNALS, JointLog, make_log
from idtool.data.logs.message_options import DEFAULT_MESSAGES, MessageOptions
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.data.logs.stored_arrays import count_arrays

__all__ = ["SIGNALS", "JointLog", "check_log_file", "is_bag", "log_suffixes", "make_log", "read_log", "write_log"]

_HEAD_BYTES = 4096
_GZIP = b"\x1f\x8b"


class _Format(Protocol):
    SUFFIXES: tuple[str, ...]

    def matches(self, head: bytes) -> bool: ...

    def read(
        self,
        path: Path,
        topic: str | None,
        columns: Mapping[str, str],
        sensors: SensorOptions | None = None,
        messages: MessageOptions = DEFAULT_MESSAGES,
    ) -> JointLog: ...

    def write(self, file: BinaryIO, log: JointLog) -> None: ...


@cache
def _formats() -> list[_Format]:
    modules = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return [cast(_Format, module) for module in modules if hasattr(module, "SUFFIXES")]


def read_log(
    path: str | os.PathLike[str],
    *,
    topic: str | None = None,
    columns: Mapping[str, str] = {},
    scale: Mapping[str, Mapping[str, float] | float] = {},
    sensors: SensorOptions | None = None,
    messages: MessageOptions = DEFAULT_MESSAGES,
) -> JointLog:
    """Read a log of any format.

    Parameters
    ----------
    path
        The file, its URL, or a rosbag2 folder. The contents of a file determine the format, not its name.
    topic
        The topic that carries the joint states, if the log has several.
    columns
        Canonical name (``t``, ``q_hip``, …) to the name of the column in the file, for CSV.
    scale
        Signal to joint to SI units per logged unit, or to one number for all joints.
    sensors
        How to read the topics of IMU, contacts and wrenches; None: they are not read.
    messages
        Which fields to read from messages of an MCAP file that are not joint states.

    Raises
    ------
    LogError
        If the file cannot be read, or lacks a topic, column, signal or joint that the options name.
    """
    path = log_path(path)
    if is_url(path):
        return _read_url(path, topic=topic, columns=columns, scale=scale, sensors=sensors, messages=messages)
    try:
        if path.is_file():  # a pipe would never end
            with BackgroundThread(partial(source_from_file, "log", path)) as hashing:
                log = _read(path, topic, columns, sensors, messages)
                sources = [hashing.result()]
        else:
            log = _read(path, topic, columns, sensors, messages)
            files = [source_from_file("log", file) for file in log_files(path)]
            sources = [source_from_file("bag metadata", path / METADATA), *files]
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None
    _apply_scale(log, scale)
    count_arrays([*log.signals.values(), *(channel.x for channel in log.channels.values())])
    return replace(log, sources=tuple(sources))


def _read_url(url: Path, **options: Any) -> JointLog:
    """A log behind a URL, with the options of `read_log`."""
    with local_copy(url) as copy:
        try:
            log = read_log(copy, **options)
        except LogError as error:
            raise LogError(url, error.what) from None
    shown = without_secrets(str(url))
    sources = tuple(replace(source, path=shown) for source in log.sources)
    return replace(log, path=log_path(shown), sources=sources)


def _read(
    path: Path,
    topic: str | None,
    columns: Mapping[str, str],
    sensors: SensorOptions | None,
    messages: MessageOptions,
) -> JointLog:
    """The log in its own units; OSError if a file cannot be read."""
    if path.is_dir():
        from idtool.data.logs.mcap import read

        if not path.name and is_bag(path):  # the working directory
            path = path.resolve()
        return read(path, topic, columns, sensors, messages)
    if not path.is_file():
        raise LogError(path, f"there is no such file; {missing_file_advice(path)}")
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        raise LogError(path, "is empty; check the logger, or give another log")
    for log_format in _formats():
        if log_format.matches(head):
            return log_format.read(path, topic, columns, sensors, messages)
    if head.startswith(SQLITE):
        raise LogError(path, wrong_storage_message(path, "sqlite3"))
    if head.startswith(ROS1):
        raise LogError(path, ros1_message(path))
    if head.startswith(_GZIP):
        raise LogError(path, f"is compressed with gzip; run 'gunzip -k {shlex.quote(str(path))}' first")
    if path.suffix.lower() == REDUCTION_SUFFIX:
        raise LogError(
            path, "is a reduction of a log; give the log (fit, validate, study and diagnose take reductions)"
        )
    raise LogError(path, f"is not a log in a supported format ({' or '.join(log_suffixes())}; CSV must be UTF-8)")


def write_log(path: str | os.PathLike[str], log: JointLog) -> None:
    """Write a log in the format given by the extension of ``path``.

    The file appears only when it is complete; until then an existing one stays.

    Raises
    ------
    LogError
        If the extension is not supported, or the log cannot be written.
    """
    path = Path(path)
    log_format = next((member for member in _formats() if path.suffix.lower() in member.SUFFIXES), None)
    if log_format is None:
        raise LogError(path, f"unsupported log format '{printable(path.suffix)}'; use {' or '.join(log_suffixes())}")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            with temporary.open("wb") as file:
                log_format.write(file, log)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise LogError(path, f"cannot be written: {error.strerror or error}") from None
    except ValueError as error:
        raise LogError(path, f"cannot be written: {error}") from None


def check_log_file(file: Path, inputs: Iterable[Path]) -> None:
    """Check, before the work is done, that a log can be written and is not one of the inputs.

    Raises
    ------
    OutputError
        If it can't, or is, or if logs are not written with its suffix.
    """
    if file.suffix.lower() not in log_suffixes():
        raise OutputError(file, f"unsupported log format '{file.suffix}'; use {' or '.join(log_suffixes())}")
    check_file(file, inputs)


def log_suffixes() -> list[str]:
    """File name extensions of all formats."""
    return [suffix for log_format in _formats() for suffix in log_format.SUFFIXES]


def _apply_scale(log: JointLog, scale: Mapping[str, Mapping[str, float] | float]) -> None:
    """Convert a log to SI units, in place."""
    for signal, factors in scale.items():
        if factors and signal not in log.signals:
            raise LogError(log.path, f"log.scale: the log has no {signal}; {suggestion(signal, list(log.signals))}")
        by_joint = factors if isinstance(factors, Mapping) else dict.fromkeys(log.joints, factors)
        for joint, factor in by_joint.items():
            if joint not in log.joints:
                raise LogError(
                    log.path, f"log.scale: {signal}: the log has no joint {joint}; {suggestion(joint, log.joints)}"
                )
            column = log.signals[signal][:, log.joints.index(joint)]
            for rows in log.blocks():
                column[rows] *= factor
