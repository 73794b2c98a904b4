"""`StoredFit`: the result of an `idtool fit`, read from its files. They may be a stranger's, or another version's."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, from_json

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.input_files import read_error_text
from idtool.common.names import printable
from idtool.common.provenance import InputFile, source_from_bytes
from idtool.common.units import POSITION_UNITS
from idtool.reporting.results.base import SCHEMA_VERSION
from idtool.reporting.results.fit import FitReport
from idtool.robot.config import Config, read_config
from idtool.robot.inertia import PI_SIZE

REPORT, CONFIG = "report.json", "model.yaml"
_MAX_BYTES = 64 << 20  # of a report; one of a robot with 24 bodies has half a MiB
_MAX_VERSION_DIFFERENCES = 1000  # keys that another version has and this one lacks, or the other way round
_MAX_ADAPTATIONS = (
    3  # the report as it is, with None for what is missing, and with an empty collection where one must be
)
_EMPTY: dict[str, Any] = {"dict_type": {}, "tuple_type": [], "list_type": []}  # by the error of None in its place
_OWN_KEYS = ("rms", "bodies", "solver")  # which the files of other commands do not have together


@dataclass(frozen=True)
class StoredFit:
    """The result of an `idtool fit`.

    Attributes
    ----------
    path
        Its report.json, as given; a name if it was not read from a file.
    report
        The content of report.json.
    config
        The configuration of the identified model; None: it is not there.
    sources
        The files that were read.
    """

    path: str
    report: FitReport
    config: Config | None
    sources: tuple[InputFile, ...] = ()


def read_fit(path: Path) -> StoredFit:
    """Read the result of an `idtool fit`.

    Parameters
    ----------
    path
        The folder that it wrote, or the report.json in it; model.yaml is read if it is beside it.

    Raises
    ------
    IdtoolError
        If a file cannot be read, is too large, or is not the result of `idtool fit`.
    """
    file = path
    if path.is_dir():
        file = path / REPORT
        if not file.exists():
            raise ModelError(path, f"contains no {REPORT}; give a folder that idtool fit wrote")
    data = _read_bytes(file)
    report = _parse_report(file, data)
    _check_consistency(file, report)
    sources = [source_from_bytes("report", file, data)]
    config = None
    config_file = file.parent / CONFIG
    if config_file.is_file():
        config = read_config(config_file)
        if config.source is not None:
            sources.append(config.source)
    return StoredFit(str(file), report, config, tuple(sources))


def _read_bytes(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ModelError(file, read_error_text(file, error)) from None
    if len(data) > _MAX_BYTES:
        raise ModelError(file, f"is larger than {_MAX_BYTES >> 20} MiB; give a {REPORT} of idtool fit")
    return data


def _parse_report(file: Path, data: bytes) -> FitReport:
    """The report, without keys that only other versions have; those that they lack are None or empty."""
    try:
        content = from_json(data, allow_inf_nan=False)
    except ValueError as error:
        raise ModelError(file, f"is not JSON ({error}); give a {REPORT} of idtool fit") from None
    if not isinstance(content, dict) or not all(key in content for key in _OWN_KEYS):
        raise ModelError(file, f"is not the result of idtool fit; give its {REPORT} or its folder")
    if not _is_finite(content):
        raise ModelError(file, "has numbers that are not finite; fit again")
    if content.get("schema") != SCHEMA_VERSION:
        raise ModelError(file, "has another schema version; compare with the idtool that wrote it")
    for _ in range(_MAX_ADAPTATIONS):
        try:
            return FitReport.model_validate(content)
        except ValidationError as error:
            differences = error.errors(include_url=False, include_input=False, include_context=False)
        if len(differences) > _MAX_VERSION_DIFFERENCES:
            break
        for difference in differences:
            with suppress(KeyError, IndexError, TypeError):  # what is not adapted is refused below
                _adapt_key(content, difference)
    key = printable(".".join(map(str, differences[0]["loc"])))
    what = f"is damaged, or of an idtool that differs too much ({key}: {differences[0]['msg']})"
    raise ModelError(file, f"{what}; fit again")


def _check_consistency(file: Path, report: FitReport) -> None:
    """Refuse a report whose parts do not belong together, as no `idtool fit` writes it."""
    rows = {*report.joints, *report.friction}
    is_consistent = rows <= report.units.keys() and set(report.units.values()) <= POSITION_UNITS.keys()
    for rms in (report.rms.train, report.rms.validation):
        is_consistent &= rms is None or {*report.joints, "overall"} <= rms.keys()
    for body in report.bodies.values():
        parts = body.pi, body.standard_error, body.interval, body.rests_on or body.pi
        is_consistent &= all(len(part) == PI_SIZE for part in parts)
        is_consistent &= len(body.com) == 3 and len(body.inertia_com) == 6
    if report.whole_robot is not None:
        is_consistent &= len(report.whole_robot.com) == 3
    if not is_consistent:
        raise ModelError(file, "is damaged: its joints, bodies and errors do not belong together; fit again")


def _is_finite(content: Any) -> bool:
    """True if no number in plain data is infinite, as 1e999 is read; the parser limits the depth."""
    if isinstance(content, dict):
        return all(map(_is_finite, content.values()))
    if isinstance(content, list):
        return all(map(_is_finite, content))
    return not isinstance(content, float) or math.isfinite(content)


def _adapt_key(content: Any, difference: ErrorDetails) -> None:
    """Remove a key that is unknown; add None for one that is missing, and replace it if it has to be a collection."""
    *parents, key = difference["loc"]
    for parent in parents:
        content = content[parent]
    kind = difference["type"]
    if kind == "extra_forbidden":
        del content[key]
    elif kind == "missing":
        content[key] = None
    elif kind in _EMPTY and content[key] is None:
        content[key] = _EMPTY[kind]
