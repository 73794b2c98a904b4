"""Time and memory of a command: ``python benchmarks/child_cost.py COMMAND…`` prints them as JSON.

It is a program of its own because Linux counts the memory of the process that starts a command as the command's.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """Time and memory of a command.

    Attributes
    ----------
    wall, cpu
        Wall time, and time of all its processes together on a processor core [s].
    memory
        Peak of the resident set, of the largest of its processes [bytes].
    """

    wall: float
    cpu: float
    memory: int


def cost_of(command: Sequence[str]) -> Cost:
    """Run a command and measure it.

    Raises
    ------
    RuntimeError
        If it fails, with what it printed.
    """
    launcher = [sys.executable, __file__, *command]
    launched = subprocess.run(launcher, check=False, capture_output=True, text=True)
    if launched.returncode != 0:
        raise RuntimeError(launched.stderr.strip() or f"{command[0]}: exit code {launched.returncode}")
    return Cost(**json.loads(launched.stdout))


def main() -> None:
    """Run the command of the arguments."""
    started = time.perf_counter()
    process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - started
    code = os.waitstatus_to_exitcode(status)
    if code != 0:
        raise SystemExit(code if code > 0 else 1)
    print(json.dumps({"wall": wall, "cpu": usage.ru_utime + usage.ru_stime, "memory": 1024 * usage.ru_maxrss}))


if __name__ == "__main__":
    main()
