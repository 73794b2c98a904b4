"""Comparison of the results of two versions of idtool: every command on the sample logs, and on real ones if there.

Run ``python benchmarks/same_results.py record DIR`` with each version, then
``python benchmarks/same_results.py compare DIR OTHER``. ``--only fit,init`` selects the cases whose names contain one
of these words, ``--jobs N`` runs several at once.

``record`` runs every case in a folder of its own below DIR, and keeps the written files, the JSON results and the
messages. ``compare`` lists every number that differs by more than ``--tolerance`` of its size, and every other value
that differs, in JSON results, URDFs, configurations and models for simulators. Times and versions are ignored. With
``--texts`` messages are compared too, with ``--pages`` also the HTML pages. Exit code 1: the results differ.
"""

from __future__ import annotations

import argparse
import difflib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
REAL_DATA = ROOT.parent / "shared" / "data"

MIN_DIFFERENCE = 1e-12  # smaller absolute differences of numbers are ignored
IGNORED_KEYS = {"seconds", "wall_seconds", "versions", "idtool", "version"}  # JSON keys of times and versions
DURATION = re.compile(r"[\d.e-]+ m?s\b")
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
MODEL_SUFFIXES = {".urdf", ".yaml", ".xml"}  # compared word by word
MAX_LINES = 12  # of differences that are printed for one file


@dataclass(frozen=True)
class Case:
    """Commands that run one after the other in one folder, each without the leading ``idtool``."""

    name: str
    commands: tuple[str, ...]


LEG = "samples/leg.urdf samples/leg_train.mcap --validate samples/leg_validate.mcap"
BELT = "samples/belt_arm.urdf samples/belt_arm_train.mcap --validate samples/belt_arm_validate.mcap"
GO2 = "real/go2/go2.urdf real/go2/chirp_4.csv real/go2/chirp_5.csv --validate real/go2/chirp_7.csv"
GO2_CONFIG = "--config configs/go2.yaml"
PANDA = "real/panda/panda.urdf real/panda/excitation.mcap"
PANDA_CONFIG = "--config configs/panda.yaml"

SAMPLES = (
    Case("leg_inspect", ("inspect samples/leg_train.mcap", "inspect samples/leg_validate.csv")),
    Case("leg_init", ("init samples/leg.urdf samples/leg_train.mcap --out leg.yaml",)),
    Case("leg_ellipsoids", ("ellipsoids samples/leg.urdf --out leg.yaml", "ellipsoids samples/leg.urdf --check")),
    Case(
        "leg_fit",
        (
            f"fit {LEG} --out out",
            "validate out/identified.urdf samples/leg_validate.csv --prior samples/leg.urdf --out out",
            "simulate out/identified.urdf samples/leg_validate.mcap --out simulated.csv",
            "export out --to mujoco --rotor-bodies",
            "export out --to drake",
        ),
    ),
    Case("leg_fit_iv", (f"fit {LEG} --method iv --quick --out out",)),
    Case("leg_diagnose", (f"diagnose {LEG} --out out",)),
    Case("leg_diagnose_fixed", (f"diagnose {LEG} --inertia fixed --report-only --explain --out out",)),
    Case("leg_adapt", ("adapt samples/leg.urdf samples/leg_train.mcap --out out",)),
    Case("leg_study", (f"study {LEG} --draws 5 --out out",)),
    Case(
        "leg_excite",
        (
            "excite samples/leg.urdf --duration 6 --iterations 10 --rate 200 --out fourier.csv",
            "excite samples/leg.urdf --duration 6 --iterations 5 --rate 200 --pattern shell --out shell.csv",
        ),
    ),
    Case("belt_init", ("init samples/belt_arm.urdf samples/belt_arm_train.mcap --out belt_arm.yaml",)),
    Case("belt_fit", (f"fit {BELT} --out out", "export out --to mujoco", "export out --to drake")),
    Case("belt_diagnose", (f"diagnose {BELT} --out out --no-simulation",)),
    Case("regression", ("validate",)),
)
REAL_LOGS = (
    Case("go2_inspect", ("inspect real/go2/chirp_4.csv",)),
    Case("go2_init", ("init real/go2/go2.urdf real/go2/chirp_4.csv --config gains.yaml --out go2.yaml",)),
    Case("go2_ellipsoids", ("ellipsoids real/go2/go2.urdf --out go2.yaml",)),
    Case(
        "go2_fit",
        (
            f"fit {GO2} {GO2_CONFIG} --out out",
            "validate out/identified.urdf real/go2/chirp_6.csv --prior real/go2/go2.urdf --out out",
            "export out --to mujoco",
            "adapt out/identified.urdf real/go2/chirp_6.csv --out out",
        ),
    ),
    Case("go2_diagnose", (f"diagnose {GO2} {GO2_CONFIG} --out out",)),
    Case("panda_inspect", ("inspect real/panda/excitation.mcap",)),
    Case("panda_init", (f"init {PANDA} --out panda.yaml",)),
    Case("panda_fit", (f"fit {PANDA} {PANDA_CONFIG} --out out", "export out --to drake")),
    Case("panda_diagnose", (f"diagnose {PANDA} {PANDA_CONFIG} --max-effects 3 --no-simulation --out out",)),
    Case("panda_study", (f"study {PANDA} {PANDA_CONFIG} --draws 5 --out out",)),
)
GO2_GAINS = {"hip": (20.0, 1.0), "thigh": (20.0, 1.0), "calf": (40.0, 2.0)}  # kp, kd


def go2_controller() -> str:
    """Configuration with the Go2's controller, which its logs do not have."""
    kp, kd = [], []
    for leg in ("FL", "FR", "RL", "RR"):
        for part, (stiffness, damping) in GO2_GAINS.items():
            kp.append(f"{leg}_{part}_joint: {stiffness}")
            kd.append(f"{leg}_{part}_joint: {damping}")
    return f"controller: {{kp: {{{', '.join(kp)}}}, kd: {{{', '.join(kd)}}}}}\n"


def record(case: Case, to: Path) -> tuple[float, list[str]]:
    """Run a case in a new folder of its own; its wall time [s], and the last message of each failed command."""
    folder = to / case.name
    folder.mkdir(parents=True)
    (folder / "samples").symlink_to(ROOT / "sample_logs")
    (folder / "configs").symlink_to(ROOT / "configs")
    (folder / "real").symlink_to(REAL_DATA)
    (folder / "gains.yaml").write_text(go2_controller())
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "120"}
    started = time.perf_counter()
    failures = []
    for i, command in enumerate(case.commands):
        process = subprocess.run(
            [sys.executable, "-m", "idtool", *command.split(), "--json"],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        (folder / f"{i}.json").write_text(process.stdout or "null")
        (folder / f"{i}.txt").write_text(f"{command}\nexit code {process.returncode}\n{process.stderr}")
        if process.returncode:
            failures.append(f"idtool {command}: {process.stderr.strip().splitlines()[-1:]}")
    return time.perf_counter() - started, failures


def files_by_path(folder: Path, suffixes: set[str]) -> dict[str, Path]:
    """Files of a case with given suffixes, by their paths below its folder."""
    files = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix in suffixes and path.is_file():
            files[str(path.relative_to(folder))] = path
    return files


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and values of a JSON document's leaves: all values but objects and lists."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in IGNORED_KEYS:
                yield from leaves(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from leaves(inner, f"{path}[{i}]")
    else:
        yield path, value


def are_equal(one: Any, other: Any, tolerance: float) -> bool:
    """True if two values are equal; numbers may differ by a share of their size."""
    is_number = isinstance(one, int | float) and isinstance(other, int | float) and not isinstance(one, bool)
    if is_number:
        size = max(abs(one), abs(other))
        return one == other or abs(one - other) <= max(tolerance * size, MIN_DIFFERENCE)
    return bool(one == other)


def json_differences(one: Path, other: Path, tolerance: float) -> Iterator[str]:
    """Differences between two JSON files, one line each."""
    before = dict(leaves(json.loads(one.read_text())))
    after = dict(leaves(json.loads(other.read_text())))
    for path in before.keys() - after.keys():
        yield f"{path}: {before[path]!r} is gone"
    for path in after.keys() - before.keys():
        yield f"{path}: {after[path]!r} is new"
    for path in before.keys() & after.keys():
        if not are_equal(before[path], after[path], tolerance):
            yield f"{path}: {before[path]!r} became {after[path]!r}"


def text_differences(one: Path, other: Path, tolerance: float) -> Iterator[str]:
    """The lines that differ between two text files by more than rounded numbers."""
    before, after = _comparable_lines(one), _comparable_lines(other)
    if len(before) == len(after):
        pairs = zip(before, after, strict=True)
        if all(are_equal_lines(line, other_line, tolerance) for line, other_line in pairs):
            return
    for line in difflib.unified_diff(before, after, lineterm="", n=0):
        if not line.startswith(("---", "+++", "@@")):
            yield line


def _comparable_lines(path: Path) -> list[str]:
    """The lines of a text without versions, durations and the name of the recording's own folder."""
    recording = re.search(r"^.*?(?=/\w+/(?:out/)?[^/]+$)", str(path.resolve()))
    text = path.read_text().replace(recording[0] if recording else "", "")
    return [DURATION.sub("… s", line) for line in text.splitlines() if "idtool 0." not in line]


def are_equal_lines(one: str, other: str, tolerance: float) -> bool:
    """True if two lines have the same words, and the same numbers except for rounding."""
    if NUMBER.split(one) != NUMBER.split(other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(are_equal(float(a), float(b), tolerance) for a, b in pairs)


def compare(one: Path, other: Path, arguments: argparse.Namespace) -> int:
    """Print the differences between two recordings; return the number of files that differ."""
    differing = 0
    suffixes = MODEL_SUFFIXES | {".json", ".csv"}
    if arguments.texts:
        suffixes.add(".txt")
    if arguments.pages:
        suffixes.add(".html")
    for folder in sorted(path for path in one.iterdir() if is_selected(path.name, arguments.only)):
        before, after = files_by_path(folder, suffixes), files_by_path(other / folder.name, suffixes)
        for name in sorted(before.keys() | after.keys()):
            if name not in before or name not in after:
                lines = ["is gone" if name in before else "is new"]
            elif name.endswith(".json"):
                lines = list(json_differences(before[name], after[name], arguments.tolerance))
            else:
                lines = list(text_differences(before[name], after[name], arguments.tolerance))
            if lines:
                differing += 1
                print(f"{folder.name}/{name}: {len(lines)} differences")
                for line in lines[:MAX_LINES]:
                    print(f"    {line[:200]}")
    return differing


def is_selected(name: str, only: str) -> bool:
    """True if a case is to be run or compared: its name contains one of the words."""
    return any(word in name for word in only.split(","))


def main() -> int:
    """Record or compare, as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    recording = verbs.add_parser("record")
    recording.add_argument("to", type=Path)
    recording.add_argument("--jobs", type=int, default=2)
    comparing = verbs.add_parser("compare")
    comparing.add_argument("one", type=Path)
    comparing.add_argument("other", type=Path)
    comparing.add_argument("--tolerance", type=float, default=1e-9)
    comparing.add_argument("--texts", action="store_true")
    comparing.add_argument("--pages", action="store_true")
    for verb in (recording, comparing):
        verb.add_argument("--only", default="", help="words of names of cases, with commas between")
    arguments = parser.parse_args()

    if arguments.verb == "compare":
        differing = compare(arguments.one, arguments.other, arguments)
        print(f"{differing} files differ" if differing else "the same")
        return int(differing > 0)
    available = SAMPLES + REAL_LOGS if REAL_DATA.exists() else SAMPLES
    cases = [case for case in available if is_selected(case.name, arguments.only)]
    with ThreadPool(arguments.jobs) as pool:
        results = pool.imap(lambda case: record(case, arguments.to.resolve()), cases)
        for case, (seconds, failures) in zip(cases, results, strict=True):
            print(f"{case.name:20} {seconds:6.1f} s", *failures, sep="\n    ", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
