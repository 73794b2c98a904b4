"""`SavedReduction`: reduced logs on disk, from which models are fitted without the logs.

A file is a ZIP archive that is not compressed, so that its size bounds what it takes to read it: ``header.json``, with
the shape of each array by name, and ``arrays.bin``, the numbers of all arrays one after the other, as float64 of the
lowest byte first. Excerpts of the logs, which a diagnosis needs and a fit does not, are in ``excerpts.bin`` likewise.
Its name ends in ``.idr``.
"""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from glob import escape
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.notice import Notice
from idtool.common.outputs import OutputError
from idtool.common.provenance import InputFile
from idtool.common.urls import log_path
from idtool.common.version import VERSION
from idtool.data.logs import SIGNALS, JointLog
from idtool.data.logs.log import Channel
from idtool.estimation.dataset.drawn_rows import DrawnRows
from idtool.estimation.dataset.envelope import Envelope
from idtool.estimation.dataset.extreme_rows import ExtremeRows
from idtool.estimation.dataset.reduced_logs import ReducedLog
from idtool.estimation.dataset.reduced_part import ReducedPart
from idtool.estimation.dataset.reduction import Factor

CoefficientKey = tuple[str, str, str, tuple[float, ...]]  # effect, owner, name and instance

_VERSION = 4  # of the format
_HEADER, _ARRAYS, _EXCERPTS = "header.json", "arrays.bin", "excerpts.bin"
_NUMBER = np.dtype("<f8")
_MAX_HEADER = 64 << 20  # bytes
_EXCLUDED = -1  # in place of the number of a block: the rows that don't count


@dataclass(frozen=True)
class SavedReduction:
    """Logs that were reduced together.

    Attributes
    ----------
    settings
        What their rows depend on; see `row_settings`.
    coefficients
        Keys of the unknowns.
    band_hz
        Cut-off of the low-pass [Hz].
    delay
        Delay of the commands that was fitted [s]; None: none was.
    holdout
        Share at the end of every log that was kept for validation.
    notices
        Notices about the logs.
    files
        The URDF, the configuration and the logs.
    logs
        The logs.
    """

    settings: Mapping[str, Any]
    coefficients: tuple[CoefficientKey, ...]
    band_hz: float
    delay: float | None
    holdout: float
    notices: tuple[Notice, ...]
    files: tuple[InputFile, ...]
    logs: tuple[ReducedLog, ...]


def write_reduction(path: Path, reduction: SavedReduction) -> None:
    """Write a file; an existing one stays until it is complete.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as file:
                _write(file, reduction)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(path, f"cannot be written to ({error.strerror}); give another --out") from None


def unfinished_files(path: Path) -> list[Path]:
    """Temporary files of a file that `write_reduction` began; those of processes that were killed remain."""
    return list(path.parent.glob(f".{escape(path.name)}.*.part"))


def reduction_bytes(reduction: SavedReduction) -> bytes:
    """Content of a file."""
    content = io.BytesIO()
    _write(content, reduction)
    return content.getvalue()


def read_reduction(path: Path, with_excerpts: bool = False) -> SavedReduction:
    """Read a file; its excerpts only if they are asked for.

    Raises
    ------
    LogError
        If it cannot be read, is no such file or damaged, or of a format that this version does not know.
    """
    try:
        with path.open("rb") as file:
            return _parse(path, file, path.stat().st_size, with_excerpts)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None


def parse_reduction(path: Path, content: bytes, with_excerpts: bool = False) -> SavedReduction:
    """Read the content of a file.

    Parameters
    ----------
    path
        The file, for messages.
    content
        Its bytes.
    with_excerpts
        True to read its excerpts too.

    Raises
    ------
    LogError
        If it is not that of such a file or damaged, or of a format that this version does not know.
    """
    return _parse(path, io.BytesIO(content), len(content), with_excerpts)


def _parse(path: Path, file: BinaryIO, size: int, with_excerpts: bool) -> SavedReduction:
    try:
        with zipfile.ZipFile(file) as archive:
            _check_size(size, archive)
            return _read(path, archive, with_excerpts)
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, IndexError, EOFError, NotImplementedError):
        raise LogError(path, "is not a reduction, or is damaged; make it again with idtool reduce") from None


def _write(file: BinaryIO, reduction: SavedReduction) -> None:
    with zipfile.ZipFile(file, "w") as archive:
        shapes = _write_arrays(archive, _ARRAYS, _arrays(reduction))
        excerpt_shapes = _write_arrays(archive, _EXCERPTS, _excerpt_arrays(reduction.logs))
        header = {**_header(reduction), "arrays": shapes, "excerpt_arrays": excerpt_shapes}
        archive.writestr(_HEADER, json.dumps(header, allow_nan=False))


def _write_arrays(
    archive: zipfile.ZipFile, member_name: str, arrays: Iterable[tuple[str, NDArray[Any]]]
) -> dict[str, tuple[int, ...]]:
    """Write arrays one after the other; returns their shapes by name."""
    shapes = {}
    with archive.open(member_name, "w", force_zip64=True) as member:
        for name, array in arrays:
            if array.size:
                member.write(np.ascontiguousarray(array, _NUMBER).data.cast("B"))
            shapes[name] = array.shape
    return shapes


def _check_size(size: int, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that is larger than its file."""
    members = archive.infolist()
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise ValueError
    if sum(member.file_size for member in members) > size:
        raise ValueError


def _header(reduction: SavedReduction) -> dict[str, Any]:
    """All but the arrays, as plain data."""
    return {
        "format": "idtool reduction",
        "version": _VERSION,
        "idtool": VERSION,
        "settings": reduction.settings,
        "coefficients": reduction.coefficients,
        "band_hz": reduction.band_hz,
        "delay": reduction.delay,
        "holdout": reduction.holdout,
        "notices": [asdict(notice) for notice in reduction.notices],
        "files": [asdict(file) for file in reduction.files],
        "logs": [_log_header(log) for log in reduction.logs],
    }


def _log_header(log: ReducedLog) -> dict[str, Any]:
    return {
        "path": str(log.path),
        "unknown_torque": log.unknown_torque,
        "has_commands": log.has_commands,
        "row_step": log.row_step,
        "block_rows": log.block_rows,
        "train": [_part_header(part) for part in log.train],
        "held_out": [_part_header(part) for part in log.held_out],
        "excerpt": None if log.excerpt is None else _excerpt_header(log.excerpt),
    }


def _excerpt_header(excerpt: JointLog) -> dict[str, Any]:
    return {
        "joints": excerpt.joints,
        "signals": list(excerpt.signals),
        "channels": list(excerpt.channels),
        "segments": [[part.start, part.stop] for part in excerpt.segments],
        "dt": excerpt.dt,
        "notices": [asdict(notice) for notice in excerpt.notices],
        "sources": [asdict(file) for file in excerpt.sources],
        "preset": excerpt.preset,
        "is_excerpt": excerpt.is_excerpt,
    }


def _part_header(part: ReducedPart) -> dict[str, Any]:
    posture = part.posture
    return {
        "samples": part.samples,
        "rows": part.rows,
        "posture": {"start": posture.start, "stop": posture.stop, "bins": posture.bins, "curves": list(posture.low)},
        "series": len(part.series),
        "drawn_from": part.drawn.drawn_from,
    }


def _parts(logs: Sequence[ReducedLog]) -> Iterator[tuple[str, ReducedPart]]:
    """Each part of the logs with the name of its arrays."""
    for i, log in enumerate(logs):
        for kind, parts in (("train", log.train), ("held_out", log.held_out)):
            for k, part in enumerate(parts):
                yield f"{i}/{kind}/{k}", part


def _arrays(reduction: SavedReduction) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays with their names."""
    for name, part in _parts(reduction.logs):
        yield f"{name}/is_compared", part.is_compared
        yield f"{name}/torque_sums", part.torque_sums
        yield f"{name}/squares_above_band", part.squares_above_band
        for curve, low in part.posture.low.items():
            yield f"{name}/posture/{curve}", np.stack([low, part.posture.high[curve]])
        yield f"{name}/extremes", part.extremes.extremes
        yield f"{name}/drawn/shares", part.drawn.shares
        yield f"{name}/drawn/worth", part.drawn.worth
        yield f"{name}/drawn/keys", part.drawn.keys
        blocks = {**part.blocks, _EXCLUDED: part.excluded}
        yield f"{name}/blocks", np.array(list(blocks))
        for j in range(len(part.is_compared)):
            factors = [block[j] for block in blocks.values()]
            yield f"{name}/{j}/lengths", np.array([len(factor.R) for factor in factors])
            yield f"{name}/{j}/rows", np.array([factor.rows for factor in factors], dtype=np.float64)
            yield f"{name}/{j}/independent", np.array([factor.independent for factor in factors])
            yield f"{name}/{j}/R", np.concatenate([factor.R for factor in factors])
            yield f"{name}/{j}/extreme_rows", part.extremes.rows[j]
            yield f"{name}/{j}/drawn", part.drawn.rows[j]
            for k, series in enumerate(part.series):
                yield f"{name}/{j}/series_{k}", series[j]


def _excerpt_arrays(logs: Sequence[ReducedLog]) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays of the excerpts with their names."""
    for i, log in enumerate(logs):
        if log.excerpt is None:
            continue
        yield f"{i}/t", log.excerpt.t
        for name, signal in log.excerpt.signals.items():
            yield f"{i}/signals/{name}", signal
        for name, channel in log.excerpt.channels.items():
            yield f"{i}/channels/{name}", np.stack([channel.t, channel.x])


def _read(path: Path, archive: zipfile.ZipFile, with_excerpts: bool) -> SavedReduction:
    header = json.loads(archive.read(_HEADER))
    if header["format"] != "idtool reduction":
        raise ValueError
    if header["version"] != _VERSION:
        what = f"has version {header['version']} of the format; this is idtool {VERSION}, which reads {_VERSION}"
        raise LogError(path, f"{what}: make it again with idtool reduce")

    arrays = _read_arrays(archive, _ARRAYS, header["arrays"])
    excerpt_arrays = _read_arrays(archive, _EXCERPTS, header["excerpt_arrays"]) if with_excerpts else {}
    logs = []
    for i, log in enumerate(header["logs"]):
        parts: dict[str, list[ReducedPart]] = {"train": [], "held_out": []}
        for kind, of_kind in parts.items():
            for k, part in enumerate(log[kind]):
                of_kind.append(_PartReader(f"{i}/{kind}/{k}", arrays).part(part))
        logs.append(
            ReducedLog(
                path=_path(log["path"]),
                unknown_torque=tuple(log["unknown_torque"]),
                has_commands=bool(log["has_commands"]),
                row_step=float(log["row_step"]),
                block_rows=int(log["block_rows"]),
                train=tuple(parts["train"]),
                held_out=tuple(parts["held_out"]),
                excerpt=_excerpt(i, log, excerpt_arrays) if with_excerpts else None,
            )
        )
    return SavedReduction(
        settings=dict(header["settings"]),
        coefficients=tuple(map(_coefficient_key, header["coefficients"])),
        band_hz=float(header["band_hz"]),
        delay=None if header["delay"] is None else float(header["delay"]),
        holdout=float(header["holdout"]),
        notices=tuple(Notice(**notice) for notice in header["notices"]),
        files=tuple(InputFile(**file) for file in header["files"]),
        logs=tuple(logs),
    )


def _excerpt(number: int, log: Mapping[str, Any], arrays: Mapping[str, Array]) -> JointLog | None:
    """The excerpt of the log of a number, of which the header is given; ValueError or KeyError if it does not fit."""
    header = log["excerpt"]
    if header is None:
        return None
    t = arrays[f"{number}/t"]
    joints = tuple(map(str, header["joints"]))
    signals = {name: arrays[f"{number}/signals/{name}"] for name in header["signals"]}
    segments = [slice(int(start), int(stop)) for start, stop in header["segments"]]
    ends = [0, *(end for part in segments for end in (part.start, part.stop)), len(t)]
    have_one_length = all(values.shape == (len(t), len(joints)) for values in signals.values())
    are_known = "q" in signals and set(signals) <= set(SIGNALS)
    have_times = (
        header["dt"] > 0 and bool(np.isfinite(t).all()) and all(part.stop - part.start > 1 for part in segments)
    )
    if not (segments and ends == sorted(ends) and have_one_length and are_known and have_times):
        raise ValueError
    channels = {}
    for name in header["channels"]:
        times, values = arrays[f"{number}/channels/{name}"]
        channels[str(name)] = Channel(times, values)
    return JointLog(
        path=_path(log["path"]),
        joints=joints,
        t=t,
        signals=signals,
        segments=tuple(segments),
        dt=float(header["dt"]),
        notices=tuple(Notice(**notice) for notice in header["notices"]),
        sources=tuple(InputFile(**file) for file in header["sources"]),
        channels=channels,
        unknown_torque=tuple(log["unknown_torque"]),
        preset=header["preset"],
        is_excerpt=bool(header["is_excerpt"]),
    )


def _read_arrays(archive: zipfile.ZipFile, member_name: str, shapes: Mapping[str, Sequence[int]]) -> dict[str, Array]:
    """The arrays of a member by name; ValueError if there are not as many numbers as their shapes say."""
    numbers = np.empty(archive.getinfo(member_name).file_size // _NUMBER.itemsize, _NUMBER)
    with cast("io.BufferedIOBase", archive.open(member_name)) as member:
        bytes_read = member.readinto(numbers.data.cast("B"))
        if bytes_read != numbers.nbytes or member.read(1):  # at the end, its checksum is checked
            raise ValueError
    return _split_arrays(shapes, numbers)


def _split_arrays(shapes: Mapping[str, Sequence[int]], numbers: Array) -> dict[str, Array]:
    """The arrays by name; ValueError if there are not as many numbers as their shapes say."""
    arrays = {}
    first = 0
    for name, shape in shapes.items():
        count = math.prod(shape)
        if min(shape, default=0) < 0 or first + count > len(numbers):
            raise ValueError
        arrays[name] = numbers[first : first + count].reshape(shape)
        first += count
    if first != len(numbers):
        raise ValueError
    return arrays


def _path(text: str) -> Path:
    """Path of a log; that of a URL which cannot be opened here is only a name."""
    try:
        return log_path(text)
    except LogError:
        return Path(text)


def _coefficient_key(plain: Sequence[Any]) -> CoefficientKey:
    effect, owner, name, instance = plain
    return str(effect), str(owner), str(name), tuple(map(float, instance))


class _PartReader:
    """Reader of a part of a log.

    Parameters
    ----------
    name
        Name of the part, with which those of its arrays begin.
    arrays
        All arrays by name.
    """

    def __init__(self, name: str, arrays: Mapping[str, Array]) -> None:
        self._name = name
        self._arrays = arrays

    def part(self, header: Mapping[str, Any]) -> ReducedPart:
        """The part; ValueError or KeyError if something does not fit."""
        is_compared = self._numbers("is_compared").astype(bool)
        nv = len(is_compared)
        posture = Envelope.of_stretches(**{key: header["posture"][key] for key in ("start", "stop", "bins")})
        for curve in header["posture"]["curves"]:
            posture.low[curve], posture.high[curve] = self._numbers(f"posture/{curve}")
        numbers = self._numbers("blocks").astype(int).tolist()
        factors = [self._factors(j) for j in range(nv)]
        blocks = {}
        for number, *of_joints in zip(numbers, *factors, strict=True):
            blocks[number] = tuple(of_joints)
        excluded = blocks.pop(_EXCLUDED)
        rows = [self._numbers(f"{j}/extreme_rows") for j in range(nv)]
        extremes = ExtremeRows([own.shape[2] for own in rows], posture.bins)
        extremes.rows, extremes.extremes = rows, self._numbers("extremes")
        series = [[self._numbers(f"{j}/series_{k}") for j in range(nv)] for k in range(header["series"])]
        return ReducedPart(
            excluded=excluded,
            posture=posture,
            extremes=extremes,
            is_compared=is_compared,
            torque_sums=self._numbers("torque_sums"),
            squares_above_band=self._numbers("squares_above_band"),
            drawn=self._drawn_rows([own.shape[2] - 1 for own in rows], int(header["drawn_from"])),
            samples=int(header["samples"]),
            rows=int(header["rows"]),
            blocks=blocks,
            series=series,
        )

    def _numbers(self, name: str) -> Array:
        return self._arrays[f"{self._name}/{name}"]

    def _drawn_rows(self, widths: Sequence[int], drawn_from: int) -> DrawnRows:
        """Rows drawn at random, of as many numbers for each joint."""
        rows = tuple(self._numbers(f"{j}/drawn") for j in range(len(widths)))
        shares, worth, keys = (self._numbers(f"drawn/{name}") for name in ("shares", "worth", "keys"))
        has_one_length = {len(keys), len(worth)} == {own.shape[1] for own in (*rows, shares)} == {len(keys)}
        if not has_one_length or [len(own) for own in rows] != list(widths) or len(keys) > drawn_from:
            raise ValueError
        return DrawnRows(rows, shares, worth, keys, drawn_from)

    def _factors(self, joint: int) -> list[Factor]:
        """The factors of a joint, block after block."""
        lengths = self._numbers(f"{joint}/lengths").astype(int)
        R = self._numbers(f"{joint}/R")
        if (lengths < 0).any() or lengths.sum() != len(R):
            raise ValueError
        triangles = np.split(R, np.cumsum(lengths)[:-1])
        rows, independent = self._numbers(f"{joint}/rows"), self._numbers(f"{joint}/independent")
        factors = []
        for triangle, count, worth in zip(triangles, rows.tolist(), independent.tolist(), strict=True):
            factors.append(Factor(triangle, count, worth))
        return factors
