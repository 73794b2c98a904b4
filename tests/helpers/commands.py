"""The command line as a user runs it: the same entry point, in this process where a process of its own adds nothing."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import yaml
from paths import SAMPLES

from idtool.cli import main

LEG, TRAIN, VALIDATE = SAMPLES / "leg.urdf", SAMPLES / "leg_train.mcap", SAMPLES / "leg_validate.mcap"
VALIDATE_CSV = SAMPLES / "leg_validate.csv"
JOINTS = ("abad", "hip", "knee")

FIT_FILES = {"identified.urdf", "model.yaml", "report.json", "report.html"}
VALIDATION_FILES = {"validation.json", "validation.html"}

Row = list[str]


@dataclass(frozen=True)
class Result:
    """Result of a command: exit code, standard output and standard error."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """Standard output, all of it, as one JSON object."""
        data = strict_json(self.out)
        assert isinstance(data, dict)
        return data


def idtool(*arguments: object, folder: Path | None = None) -> Result:
    """Run the command line in this process, in a folder."""
    out, err = io.StringIO(), io.StringIO()
    code: object = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(sys, "argv", ["idtool", *map(str, arguments)]))
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        if folder is not None:
            stack.enter_context(contextlib.chdir(folder))
        try:
            main()
        except SystemExit as end:
            code = end.code
    assert isinstance(code, int)
    return Result(code, out.getvalue(), err.getvalue())


def installed(*arguments: object, folder: Path) -> Result:
    """Run the installed command in a process of its own."""
    command = [str(Path(sys.executable).with_name("idtool")), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    return Result(done.returncode, done.stdout, done.stderr)


def fitted(folder: Path, *arguments: object, simulated: bool = False) -> dict[str, Any]:
    """The report of a fit that writes to a folder and succeeds."""
    leave_out = [] if simulated else ["--quick"]
    done = idtool("fit", *arguments, "--out", folder, "--quiet", "--json", *leave_out)
    assert done.code == 0, done.err
    return done.json


def validated(folder: Path, *arguments: object, simulated: bool = False) -> dict[str, Any]:
    """The report of a validation that writes to a folder and succeeds."""
    leave_out = [] if simulated else ["--no-simulation"]
    done = idtool("validate", *arguments, "--out", folder, "--quiet", "--json", *leave_out)
    assert done.code == 0, done.err
    return done.json


def strict_json(text: str) -> Any:
    """JSON, in which NaN and Infinity are not numbers."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} in JSON")

    return json.loads(text, parse_constant=refuse)


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, and what it holds."""
    paths = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def config_with(path: Path, base: Path | None = None, **changes: Any) -> Path:
    """Write a configuration: another one with some keys changed, None to leave one out."""
    data = yaml.safe_load(base.read_text()) if base else {}
    data = {key: value for key, value in {**data, **changes}.items() if value is not None}
    path.write_text(yaml.safe_dump(data))
    return path


def sample_table(rows: int) -> list[Row]:
    """The head of the CSV sample log: names of the columns, then so many samples."""
    with VALIDATE_CSV.open() as file:
        return [line.strip().split(",") for line, _ in zip(file, range(rows + 1), strict=False)]


def csv_text(table: list[Row]) -> str:
    """A table as text."""
    return "".join(",".join(row) + "\n" for row in table)


def column_set(table: list[Row], name: str, value: Callable[[int], object]) -> list[Row]:
    """The table with another column of that name, from the number of the sample."""
    place = table[0].index(name)
    samples = ([*row[:place], str(value(i)), *row[place + 1 :]] for i, row in enumerate(table[1:]))
    return [table[0], *samples]


def columns_kept(table: list[Row], wanted: Callable[[str], bool]) -> list[Row]:
    """The table's columns whose name is wanted."""
    places = [i for i, name in enumerate(table[0]) if wanted(name)]
    return [[row[i] for i in places] for row in table]


def numbers(x: Any) -> Iterator[float]:
    """Every number in plain data."""
    if isinstance(x, dict | list):
        for value in x.values() if isinstance(x, dict) else x:
            yield from numbers(value)
    elif isinstance(x, int | float) and not isinstance(x, bool):
        yield float(x)


def refuse(folder: Path, *arguments: object, naming: str, file: str = "") -> None:
    """Run a command in a folder and check that it refuses its input.

    Exit code 2, one line on standard error that names what is at fault, and no file written, changed or left behind.
    """
    out = folder / "out"
    out.mkdir()
    for name in FIT_FILES | VALIDATION_FILES:
        (out / name).write_text(f"the former {name}")
    paths, contents = sorted(folder.rglob("*")), files(folder)
    done = idtool(*arguments, folder=folder)
    assert (done.code, done.out) == (2, ""), done
    assert done.err.startswith("error: ")
    assert done.err.endswith("\n")
    assert done.err[:-1].isprintable()  # one line, no traceback
    assert file in done.err, done.err
    assert naming in done.err, done.err
    assert sorted(folder.rglob("*")) == paths
    assert files(folder) == contents
