"""Whether two versions of idtool give the same results: every command on the sample logs, and on real ones if at hand.

Run ``python benchmarks/same_results.py record DIR`` with each version, then
``python benchmarks/same_results.py compare DIR OTHER``. ``--only fit,init`` takes the cases whose names contain one of
these words, ``--jobs N`` runs several at once.

``record`` runs every case in a folder of its own below DIR, and keeps what the command writes, its JSON result and its
messages. ``compare`` lists every number that differs by more than ``--tolerance`` of its size, and every other value
that differs, in JSON results, URDFs, configurations and models for simulators. Times and versions are left aside. With
``--texts`` messages are compared too, with ``--pages`` the HTML pages as well. Exit code 1: they are not the same.
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
REAL = ROOT.parent / "shared" / "data"

LEAST = 1e-12  # a difference of numbers that is smaller is none, whatever their size
ASIDE = {"seconds", "wall_seconds", "versions", "idtool", "version"}  # JSON keys of times and versions
DURATION = re.compile(r"[\d.e-]+ m?s\b")
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
MODELS = {".urdf", ".yaml", ".xml"}  # compared word by word
TEXTS = {".txt"}
MOST_LINES = 12  # of differences shown for one file


@dataclass(frozen=True)
class Case:
    """A folder's commands, one after the other, each with what is typed after ``idtool``."""

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
GAINS = "controller: {kp: {%s}, kd: {%s}}\n"


def gains() -> str:
    """The Go2's controller, which no log tells."""
    gain = {"hip": (20.0, 1.0), "thigh": (20.0, 1.0), "calf": (40.0, 2.0)}
    joints = [(f"{leg}_{part}_joint", *gain[part]) for leg in ("FL", "FR", "RL", "RR") for part in gain]
    return GAINS % (", ".join(f"{j}: {kp}" for j, kp, _ in joints), ", ".join(f"{j}: {kd}" for j, _, kd in joints))


def record(case: Case, to: Path) -> tuple[float, list[str]]:
    """Run a case in a new folder of its own; the time it took [s], and the last line of commands that failed."""
    folder = to / case.name
    folder.mkdir(parents=True)
    (folder / "samples").symlink_to(ROOT / "sample_logs")
    (folder / "configs").symlink_to(ROOT / "configs")
    (folder / "real").symlink_to(REAL)
    (folder / "gains.yaml").write_text(gains())
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "120"}
    started = time.perf_counter()
    failures = []
    for i, command in enumerate(case.commands):
        ran = subprocess.run(
            [sys.executable, "-m", "idtool", *command.split(), "--json"],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        (folder / f"{i}.json").write_text(ran.stdout or "null")
        (folder / f"{i}.txt").write_text(f"{command}\nexit code {ran.returncode}\n{ran.stderr}")
        if ran.returncode:
            failures.append(f"idtool {command}: {ran.stderr.strip().splitlines()[-1:]}")
    return time.perf_counter() - started, failures


def files(folder: Path, kinds: set[str]) -> dict[str, Path]:
    """The files of some endings that a case has written, by their paths below its folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix in kinds and path.is_file():
            found[str(path.relative_to(folder))] = path
    return found


def leaves(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """All values of a JSON document that hold no others, with where they are."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in ASIDE:
                yield from leaves(inner, f"{at}.{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from leaves(inner, f"{at}[{i}]")
    else:
        yield at, value


def same(one: Any, other: Any, tolerance: float) -> bool:
    """Whether two values are equal, numbers to a share of their size."""
    numbers = (int, float)
    if isinstance(one, numbers) and isinstance(other, numbers) and not isinstance(one, bool | None):
        return one == other or abs(one - other) <= max(tolerance * max(abs(one), abs(other)), LEAST)
    return bool(one == other)


def json_differences(one: Path, other: Path, tolerance: float) -> Iterator[str]:
    """What differs between two JSON files."""
    left, right = (dict(leaves(json.loads(path.read_text()))) for path in (one, other))
    for at in left.keys() - right.keys():
        yield f"{at}: {left[at]!r} is gone"
    for at in right.keys() - left.keys():
        yield f"{at}: {right[at]!r} is new"
    for at in left.keys() & right.keys():
        if not same(left[at], right[at], tolerance):
            yield f"{at}: {left[at]!r} became {right[at]!r}"


def text_differences(one: Path, other: Path, tolerance: float) -> Iterator[str]:
    """The lines that differ between two text files by more than rounded numbers."""
    left, right = (_comparable_lines(path) for path in (one, other))
    if len(left) == len(right) and all(same_line(a, b, tolerance) for a, b in zip(left, right, strict=True)):
        return
    for line in difflib.unified_diff(left, right, lineterm="", n=0):
        if not line.startswith(("---", "+++", "@@")):
            yield line


def _comparable_lines(path: Path) -> list[str]:
    """The lines of a text without versions, durations and the name of the recording's own folder."""
    recording = re.search(r"^.*?(?=/\w+/(?:out/)?[^/]+$)", str(path.resolve()))
    text = path.read_text().replace(recording[0] if recording else "", "")
    return [DURATION.sub("… s", line) for line in text.splitlines() if "idtool 0." not in line]


def same_line(one: str, other: str, tolerance: float) -> bool:
    """Whether two lines have the same words, and the same numbers but for rounding."""
    if NUMBER.split(one) != NUMBER.split(other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(same(float(a), float(b), tolerance) for a, b in pairs)


def compare(one: Path, other: Path, arguments: argparse.Namespace) -> int:
    """Print what differs between two recordings; the number of files that do."""
    differing = 0
    kinds = (
        MODELS | {".json", ".csv"} | (TEXTS if arguments.texts else set()) | ({".html"} if arguments.pages else set())
    )
    for folder in sorted(path for path in one.iterdir() if chosen(path.name, arguments.only)):
        left, right = files(folder, kinds), files(other / folder.name, kinds)
        for name in sorted(left.keys() | right.keys()):
            if name not in left or name not in right:
                lines = ["is gone" if name in left else "is new"]
            elif name.endswith(".json"):
                lines = list(json_differences(left[name], right[name], arguments.tolerance))
            else:
                lines = list(text_differences(left[name], right[name], arguments.tolerance))
            if lines:
                differing += 1
                print(f"{folder.name}/{name}: {len(lines)} differences")
                for line in lines[:MOST_LINES]:
                    print(f"    {line[:200]}")
    return differing


def chosen(name: str, only: str) -> bool:
    """Whether a case is to be run or compared."""
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
    cases = [case for case in (*SAMPLES, *(REAL_LOGS if REAL.exists() else ())) if chosen(case.name, arguments.only)]
    with ThreadPool(arguments.jobs) as pool:
        took = pool.imap(lambda case: record(case, arguments.to.resolve()), cases)
        for case, (seconds, failures) in zip(cases, took, strict=True):
            print(f"{case.name:20} {seconds:6.1f} s", *failures, sep="\n    ", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
