"""What was set differently for two results: configuration, robot, logs and versions."""

from __future__ import annotations

import json
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
    of_a, of_b = _all_settings(a), _all_settings(b)
    if a.config is not None and b.config is not None:
        of_a.update(_config_settings(a.config))
        of_b.update(_config_settings(b.config))
    names = dict.fromkeys([*of_a, *of_b])
    settings = [Setting(name=name, a=of_a.get(name), b=of_b.get(name)) for name in names]
    return [setting for setting in settings if setting.a != setting.b]


def shared_logs(a: FitReport, b: FitReport) -> list[str]:
    """Logs of the first result whose content is that of a log of the second, by their hashes."""
    hashes = {source.sha256 for source in b.inputs if source.kind == "log" and source.sha256 is not None}
    return [source.path for source in a.inputs if source.kind == "log" and source.sha256 in hashes]


def _all_settings(result: StoredFit) -> dict[str, str]:
    """Versions, files and what the report says of the settings."""
    report = result.report
    settings = {"idtool": report.idtool}
    settings |= {f"version of {name}": version for name, version in report.versions.items()}
    for kind in ("URDF", "mesh"):
        files = [source for source in report.inputs if source.kind == kind]
        if files:
            hashes = ", ".join(sorted((source.sha256 or "")[:_HASH_LENGTH] for source in files))
            settings[f"content of the {kind} (SHA-256)"] = _shortened(hashes)
    settings["method"] = report.method
    settings["filter.cutoff_hz, as used"] = f"{number(report.band_hz, 4)} Hz"
    settings["regularization, as used"] = f"{report.regularization.kind}, weight {number(report.regularization.weight)}"
    sets = [f"{name} {body.constraints}" for name, body in report.bodies.items()]
    kinds = dict.fromkeys(body.constraints for body in report.bodies.values())
    settings["constraints, as used"] = _shortened(", ".join(kinds if len(kinds) == 1 else sets))
    if report.controller is not None:
        given = report.controller.given
        settings["controller.delay, as given"] = "auto" if given is None else f"{number(given)} s"
    for value in report.known:
        settings[f"known: {value.what}"] = number(value.value, 5)
    return settings


def _config_settings(config: Config) -> dict[str, str]:
    """Keys of the configuration and their values, without what the fit has written there."""
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
    data["friction"] = _without_values(data["friction"])
    for effect in data["effects"]:
        effect["parameters"] = _without_values(effect["parameters"])
    return dict(_flattened("", data))


def _without_values(value: Any) -> Any:
    """Settings with True in place of values that have been identified."""
    if not isinstance(value, Mapping):
        return value
    if "value" in value:
        return True
    return {key: _without_values(inner) for key, inner in value.items()}


def _flattened(path: str, value: Any) -> Iterator[tuple[str, str]]:
    """The keys within a value, each with its value as text."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flattened(f"{path}.{key}" if path else str(key), inner)
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for name, item in zip(_item_names(value), value, strict=True):
            yield from _flattened(f"{path}[{name}]", item)
    elif value is not None and value != []:
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        yield path, _shortened(Path(text).name if path.endswith(".file") else text)


def _item_names(items: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of the items of a list: what they are called, or their numbers."""
    names = []
    for i, item in enumerate(items):
        parts = [str(item[key]) for key in ("name", "effect", "joint", "link", "body") if item.get(key)]
        names.append(" ".join(parts) or str(i + 1))
    return names if len(set(names)) == len(names) else [f"{i + 1} {name}" for i, name in enumerate(names)]


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_LENGTH else f"{text[: _MAX_LENGTH - 1]}…"
