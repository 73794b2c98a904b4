"""First configurations: arms that Pinocchio moves, their logs as CSV, and what `idtool init` makes of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from commands import idtool
from prescribed_motions import Log, prescribed_motion, with_noise
from recordings import State
from spatial_arm import ARM, JOINTS

from idtool.robot.config import Config, parse_config, read_config

SECONDS, NOISE = 12.0, 0.02  # s; N·m
TEMPLATES = ("log", "friction", "rotors", "armature", "effects", "bounding_ellipsoids", "controller", "known")


def arm(seconds: float = SECONDS, **changes: np.ndarray[Any, Any]) -> Log:
    """The arm of `spatial_arm` moved, with noise on its torque, and other signals in place of some or beside them."""
    return (
        with_noise({**prescribed_motion(seconds), **changes}, NOISE)
        if "tau" not in changes
        else {**prescribed_motion(seconds), **changes}
    )


def as_csv(path: Path, log: Mapping[str, Any], names: Sequence[str] = JOINTS, signals: Sequence[str] = ()) -> Path:
    """Write some signals of some joints, the first of those that there are; all signals where none are named."""
    kept = signals or [name for name in ("q", "v", "tau", "qcmd") if name in log]
    head = [f'"{signal}_{name}"' for signal in kept for name in names]
    table = np.column_stack([log["t"], *(log[signal][:, : len(names)] for signal in kept)])
    np.savetxt(path, table, delimiter=",", header=",".join(["t", *head]), comments="", fmt="%.9g")
    return path


def as_states(log: Mapping[str, Any]) -> list[State]:
    """The same as joint states."""
    rows = zip(*(log[name].tolist() for name in ("q", "v", "tau")), strict=True)
    return [State(10**9 + 10**6 * i, JOINTS, *row, "", 10**9 + 10**6 * i) for i, row in enumerate(rows)]


def robot(folder: Path, text: str = ARM) -> Path:
    """Write a URDF."""
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def init(urdf: Path, *arguments: object) -> dict[str, Any]:
    """The report of an `idtool init` that succeeds; what it wrote is YAML that can be read as a configuration."""
    done = idtool("init", urdf, *arguments, "--json")
    assert done.code == 0, done.err
    report = done.json
    file = Path(report["file"])
    assert yaml.safe_load(file.read_text()) == report["config"]
    assert read_config(file).model_dump() == parse_config(report["config"], "report").model_dump()
    return report


def filled(text: str, number: float = 1.0) -> Config:
    """The configuration with its templates taken out of their comments and a number in each place left empty."""
    data = yaml.safe_load(text)
    for block in text.split("\n\n"):
        lines = block.splitlines()
        at = next(
            (i for i, line in enumerate(lines) if re.fullmatch(rf"# ({'|'.join(TEMPLATES)}):.*", line)), len(lines)
        )
        data |= _numbered(yaml.safe_load("\n".join(line.removeprefix("# ") for line in lines[at:])) or {}, number)
        more = [line.removeprefix("# ") if line.startswith("#   ") else line for line in lines[:at]]  # entries of a key
        data |= _numbered(yaml.safe_load("\n".join(more)) or {}, number)
    return parse_config(data, "filled in")


def _numbered(data: Any, number: float) -> Any:
    if isinstance(data, dict):  # columns are the one thing that has names
        return {key: _numbered(value, number) if key != "columns" else {} for key, value in data.items()}
    if isinstance(data, list):
        return [_numbered(value, number) for value in data]
    return number if data is None else data
