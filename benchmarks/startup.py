"""Time of ``idtool --help``, and of each step of ``idtool fit`` of the leg.

Run ``python benchmarks/startup.py``. Every run is a fresh process. These take turns: an empty Python program, the help,
the command ``idtool fit``, with and without ``--quick``, and a process that takes the steps of the fit one by one and
times them.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

REPETITIONS = 7


def python(*arguments: str | Path) -> str:
    """Run Python, with compiled modules as of an installed package, and return its standard output."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, *arguments]
    process = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return process.stdout


def idtool(*arguments: str | Path) -> str:
    """Run the command line."""
    return python("-m", "idtool", *arguments)


def print_steps(urdf: Path, log: Path) -> None:
    """Fit in this process, from the imports to the page, and print the time of each step [s]."""
    clock = [time.perf_counter()]
    from idtool.estimation.dataset.experiment import prepare
    from idtool.estimation.fit import fit
    from idtool.reporting.fit_report import fit_report
    from idtool.reporting.pages.fit import fit_page
    from idtool.robot.config import read_config
    from idtool.robot.urdf.reading import read_robot

    clock.append(time.perf_counter())
    experiment = prepare(read_robot(urdf), read_config(urdf.with_suffix(".yaml")), [log])
    clock.append(time.perf_counter())
    result = fit(experiment, lambda *_: None)
    clock.append(time.perf_counter())
    fit_page(result, fit_report(result), "")
    clock.append(time.perf_counter())
    imports, reading, _, page = (b - a for a, b in pairwise(clock))
    print(json.dumps({"imports": imports, "reading": reading, **result.seconds, "page": page}))


def main() -> None:
    """Time all in turn and print medians."""
    if len(sys.argv) == 3:
        return print_steps(Path(sys.argv[1]), Path(sys.argv[2]))
    import sample_leg

    steps: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        fit = ("fit", sample_leg.URDF, sample_leg.LOG, "--out", folder, "--quiet")
        idtool(*fit)  # compiles what it imports
        empty, help_seconds, fit_seconds, quick_seconds, _ = sample_leg.median_times(
            REPETITIONS,
            lambda: python("-c", "pass"),
            lambda: idtool("--help"),
            lambda: idtool(*fit),
            lambda: idtool(*fit, "--quick"),
            lambda: steps.append(json.loads(python(__file__, sample_leg.URDF, sample_leg.LOG))),
        )
    commands = {"--help": help_seconds, "fit": fit_seconds, "fit --quick": quick_seconds}
    print(f"an empty Python {empty:.3f} s")
    for name, seconds in commands.items():
        print(f"idtool {name} {seconds:.3f} s: ratio {seconds / empty:.1f}")
    parts = ", ".join(f"{name} {statistics.median(run[name] for run in steps):.2f}" for name in steps[0])
    print(f"steps of fit --quick: {parts} s")


if __name__ == "__main__":
    main()
