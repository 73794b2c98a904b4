"""Settings that differ between two results: configuration, robot, logs and versions."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from idtool.common.number_text import number
from idtool.reporting.results.comparison import Setting
from idtool.reporting.results.fit import FitReport
from idtool.reporting.stored_fit import StoredFit
from idtool.robot.config import Config

_MAX_LENGTH = 80  # characters of a value
_HASH_LENGTH = 8  # characters of a hash that is shown


def changed_settings(a: StoredFit, b: StoredFit) -> list[Setting]:
    """Settings, files and versions that differ.

    Parameters
    ----------
    a, b
        The results.
    """
    settings = list(_differences("", _reported_settings(a.report), _reported_settings(b.report)))
    if a.config is not None and b.config is not None:
        settings += _differences("", _config_settings(a.config), _config_settings(b.config))
    return settings


def shared_logs(a: FitReport, b: FitReport) -> list[str]:
    """Logs of the first result whose content is that of a log of the second, by their hashes."""
    hashes = {source.sha256 for source in b.inputs if source.kind == "log" and source.sha256 is not None}
    return [source.path for source in a.inputs if source.kind == "log" and source.sha256 in hashes]


def _reported_settings(report: FitReport) -> dict[str, Any]:
    """Versions, files and what a report says of the settings."""
    settings: dict[str, Any] = {"idtool": report.idtool}
    settings |= {f"version of {name}": version for name, version in report.versions.items()}
    for kind in ("URDF", "mesh"):
        files = [source for source in report.inputs if source.kind == kind]
        if files:
            hashes = ", ".join(sorted((source.sha256 or "")[:_HASH_LENGTH] for source in files))
            settings[f"content of the {kind} (SHA-256)"] = hashes
    settings["method"] = report.method
    settings["filter.cutoff_hz, as used"] = f"{number(report.band_hz, 4)} Hz"
    settings["regularization, as used"] = f"{report.regularization.kind}, weight {number(report.regularization.weight)}"
    set_of_body = {name: body.constraints for name, body in report.bodies.items()}
    is_uniform = len(set(set_of_body.values())) == 1
    settings["constraints, as used"] = next(iter(set_of_body.values())) if is_uniform else set_of_body
    if report.controller is not None:
        given = report.controller.given
        settings["controller.delay, as given"] = "auto" if given is None else f"{number(given)} s"
    for value in report.known:
        settings[f"known: {value.what}"] = number(value.value, 5)
    return settings


def _config_settings(config: Config) -> dict[str, Any]:
    """A configuration as plain data, without what the fit has written there."""
    data = config.model_dump(mode="json", by_alias=True)
    data["filter"].pop("cutoff_hz")  # the report has the one that was used
    data["base"].pop("noise")
    if data["controller"] is not None:
        data["controller"].pop("delay")
    for contact in data["contacts"]:
        contact.pop("compliance")
    for sensor in data["wrench_sensors"]:
        sensor.pop("offset")
    for rotor in data["rotors"].values():
        rotor.pop("inertial")
    for shapes in data["bounding_shapes"].values():
        for shape in shapes:
            if shape.get("file") is not None:
                shape["file"] = Path(shape["file"]).name  # else relative to the folder of the result
    data["friction"] = _without_values(data["friction"])
    for effect in data["effects"]:
        effect["parameters"] = _without_values(effect["parameters"])
    return data


def _without_values(value: Any) -> Any:
    """Settings with True in place of values that have been identified."""
    if not isinstance(value, Mapping):
        return value
    if "value" in value:
        return True
    return {key: _without_values(inner) for key, inner in value.items()}


def _differences(path: str, a: Any, b: Any) -> Iterator[Setting]:
    """The keys of which two values differ; one for a part that only one of them has."""
    if a == b:
        return
    if _is_list_of_parts(a) and _is_list_of_parts(b):
        a, b = _by_name(a), _by_name(b)
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            yield from _differences(f"{path}.{key}" if path else str(key), a.get(key), b.get(key))
    else:
        yield Setting(name=path, a=_value_text(a), b=_value_text(b))


def _is_list_of_parts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, Mapping) for item in value)


def _by_name(items: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The items of a list, by what they are called; the second of a name has a 2 behind it, and so on."""
    named: dict[str, Mapping[str, Any]] = {}
    count: Counter[str] = Counter()
    for item in items:
        name = " ".join(str(item[key]) for key in ("name", "effect", "joint", "link", "body") if item.get(key))
        count[name] += 1
        is_first = name and count[name] == 1
        named[name if is_first else f"{name} {count[name]}".strip()] = item
    return named


def _value_text(value: Any) -> str | None:
    """A value as text, its parts without those that are not set; None if it is not set."""
    if value in (None, [], {}):
        return None
    if isinstance(value, str):
        return _shortened(value)
    return _shortened(json.dumps(_without_unset(value), ensure_ascii=False))


def _without_unset(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_unset(inner) for key, inner in value.items() if inner not in (None, [], {})}
    return value


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_LENGTH else f"{text[: _MAX_LENGTH - 1]}…"
