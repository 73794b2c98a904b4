"""Time of `idtool diagnose` with two versions of idtool, on the same logs, one after the other.

Run ``python benchmarks/diagnose_versions.py OLD NEW CASE...``, with the folders of two checkouts and those of cases
that ``scoreboard.py --cache`` has written, or others with a ``robot.urdf``, a ``log.csv`` or ``log.mcap`` and a
``config.yaml``. Prints the wall time and the CPU time, child processes included, of both versions for each case, their
ratios, and what each version names. A run that exceeds the time limit is ended, and counts as if it had taken that
long.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from statistics import geometric_mean
from typing import NamedTuple


class Run(NamedTuple):
    """One diagnosis.

    Attributes
    ----------
    wall_seconds, cpu_seconds
        Its time.
    named
        The effects that it names, with their locations; "no result" if it exceeded the time limit.
    """

    wall_seconds: float
    cpu_seconds: float
    named: str


def diagnose(checkout: Path, case: Path, time_limit: float) -> Run:
    """Diagnose a case with the idtool of a checkout, for at most a given time [s]."""
    log = next(case.glob("log.*"))
    truth_file = case / "truth.json"
    inertia = json.loads(truth_file.read_text())["inertia"] if truth_file.is_file() else "refit"
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    with tempfile.TemporaryDirectory() as folder:
        files = [case / "robot.urdf", log, "--config", case / "config.yaml", "--out", folder]
        command = [sys.executable, "-m", "idtool", "diagnose", *map(str, files), "--inertia", inertia]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = time.perf_counter()
        is_complete = run_within(time_limit, command, environment, folder)
        wall_seconds = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        named = named_effects(Path(folder)) if is_complete else "no result"
    cpu_seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return Run(wall_seconds, cpu_seconds, named)


def run_within(time_limit: float, command: Sequence[str], environment: Mapping[str, str], folder: str) -> bool:
    """Run a command in a folder; False if it exceeded the time limit [s] and was killed with its children."""
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment, cwd=folder, start_new_session=True
    ) as process:
        try:
            _, errors = process.communicate(timeout=time_limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return False
    if process.returncode:
        raise RuntimeError(errors.decode())
    return True


def named_effects(folder: Path) -> str:
    """The effects that a diagnosis in a folder names."""
    report = json.loads((folder / "diagnosis.json").read_text())
    names = [f"{step['effect']}.{step['joint'] or step['link'] or 'all'}" for step in report["steps"]]
    return ", ".join(names) or "nothing"


def main() -> None:
    """Print a line for each case, and the mean ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--time-limit", type=float, default=900.0, metavar="S", help="of each run [s]")
    options = parser.parse_args()

    print(f"{'case':50} wall s: old, new, ratio    CPU s: old, new, ratio")
    runs = []
    for case in options.cases:
        checkouts = (options.old.resolve(), options.new.resolve())
        old, new = (diagnose(checkout, case.resolve(), options.time_limit) for checkout in checkouts)
        runs.append((old, new))
        wall = f"{old.wall_seconds:8.1f} {new.wall_seconds:6.1f} {old.wall_seconds / new.wall_seconds:5.1f}"
        cpu = f"{old.cpu_seconds:8.1f} {new.cpu_seconds:6.1f} {old.cpu_seconds / new.cpu_seconds:5.1f}"
        print(f"{case.name:50} {wall}    {cpu}   old: {old.named}; new: {new.named}", flush=True)
    for name, seconds in (("wall", attrgetter("wall_seconds")), ("CPU", attrgetter("cpu_seconds"))):
        mean_ratio = geometric_mean(seconds(old) / seconds(new) for old, new in runs)
        total_ratio = sum(seconds(old) for old, _ in runs) / sum(seconds(new) for _, new in runs)
        print(f"{name} time: geometric mean of the ratios {mean_ratio:.1f}, ratio of the totals {total_ratio:.1f}")


if __name__ == "__main__":
    main()
