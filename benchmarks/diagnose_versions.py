"""Time of `idtool diagnose` with two versions of idtool, on the same logs, one after the other.

Run ``python benchmarks/diagnose_versions.py OLD NEW CASE...``, with the folders of two checkouts and those of cases
that ``scoreboard.py --cache`` has written. Prints the wall time and the CPU time, child processes included, of both
versions for each case, their ratios, and what each version names.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
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
        The effects that it names, with their locations.
    """

    wall_seconds: float
    cpu_seconds: float
    named: str


def diagnose(checkout: Path, case: Path) -> Run:
    """Diagnose a case with the idtool of a checkout."""
    truth = json.loads((case / "truth.json").read_text())
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    with tempfile.TemporaryDirectory() as folder:
        files = [case / "robot.urdf", case / "log.csv", "--config", case / "config.yaml", "--out", folder]
        command = [sys.executable, "-m", "idtool", "diagnose", *map(str, files), "--inertia", truth["inertia"]]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=environment, cwd=folder)
        wall_seconds = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        report = json.loads((Path(folder) / "diagnosis.json").read_text())
    cpu_seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    names = [f"{step['effect']}.{step['joint'] or step['link'] or 'all'}" for step in report["steps"]]
    return Run(wall_seconds, cpu_seconds, ", ".join(names) or "nothing")


def main() -> None:
    """Print a line for each case, and the mean ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("cases", type=Path, nargs="+")
    options = parser.parse_args()

    print(f"{'case':50} wall s: old, new, ratio    CPU s: old, new, ratio")
    ratios = []
    for case in options.cases:
        old, new = (diagnose(checkout.resolve(), case.resolve()) for checkout in (options.old, options.new))
        wall_ratio, cpu_ratio = old.wall_seconds / new.wall_seconds, old.cpu_seconds / new.cpu_seconds
        ratios.append((wall_ratio, cpu_ratio))
        wall = f"{old.wall_seconds:8.1f} {new.wall_seconds:6.1f} {wall_ratio:5.1f}"
        cpu = f"{old.cpu_seconds:8.1f} {new.cpu_seconds:6.1f} {cpu_ratio:5.1f}"
        print(f"{case.name:50} {wall}    {cpu}   old: {old.named}; new: {new.named}", flush=True)
    wall_mean, cpu_mean = (geometric_mean(column) for column in zip(*ratios, strict=True))
    print(f"geometric mean of the ratios: wall {wall_mean:.1f}, CPU {cpu_mean:.1f}")


if __name__ == "__main__":
    main()
