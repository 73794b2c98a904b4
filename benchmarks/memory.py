"""Memory of a whole fit of the leg beyond the log's own arrays, which should not grow with the log.

Run ``python benchmarks/memory.py [MINUTES ...]``; default: 6 and 60 minutes at 1 kHz. Each log is made, written, and
fitted in a fresh process. Printed is the resident set's high-water mark, which Linux tells, less what it was after the
imports and less the size of the log's arrays.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import leg
import numpy as np

from idtool.data.logs import make_log, write_log
from idtool.data.signals import Motion
from idtool.estimation.fit import fit

RATE = 1000.0  # Hz
MINUTE = round(60 * RATE)  # samples


def write_swinging(path: Path, minutes: int) -> None:
    """Write a log of a leg whose joints follow sums of sines under the torque of the prior model, with noise."""
    equation = leg.experiment().equation
    rng = np.random.default_rng(0)
    frequency = 2 * np.pi * rng.uniform(0.1, 2.0, (8, 3, 1))
    amplitude, start = rng.uniform(0.05, 0.2, (8, 3, 1)), rng.uniform(0, 2 * np.pi, (8, 3, 1))
    pieces = []
    for minute in range(minutes):
        t = (minute * MINUTE + np.arange(MINUTE)) / RATE
        phase = frequency * t + start
        q = (amplitude * np.sin(phase)).sum(axis=0)
        v = (amplitude * frequency * np.cos(phase)).sum(axis=0)
        a = -(amplitude * frequency**2 * np.sin(phase)).sum(axis=0)
        motion = Motion(t=t, q=q, v=v, a=a, tau=q, logged=q, velocity_deadband=np.full(3, 1e-2), dt=1 / RATE)
        tau = equation.torque(motion, equation.prior)
        pieces.append([x + s * rng.normal(size=x.shape) for x, s in ((q, 3e-5), (v, 1e-2), (tau, 0.4))])
    q, v, tau = (np.concatenate(signal, axis=1).T for signal in zip(*pieces, strict=True))
    t = np.arange(minutes * MINUTE) / RATE
    write_log(path, make_log(path, t, equation.joints, {"q": q, "v": v, "tau": tau}))


def memory(name: str) -> int:
    """A figure of this process's memory [bytes]."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.findall(rf"{name}:\s+(\d+)", status)[0])


def print_memory(path: Path) -> None:
    """Read and fit in this process."""
    leg.experiment()  # so that what is imported on the way is not counted
    before = memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the high-water mark starts anew
    experiment = leg.experiment(path, holdout=0.3)
    log = experiment.runs[0].signals.log
    arrays = log.t.nbytes + sum(array.nbytes for array in log.signals.values())
    reading = memory("VmHWM") - before - arrays
    Path("/proc/self/clear_refs").write_text("5")
    fit(experiment, lambda *_: None)
    fitting = memory("VmHWM") - before - arrays
    print(
        f"{len(log) / MINUTE:3.0f} min: {arrays / 2**20:6.1f} MiB of log; beyond it at most {reading / 2**20:5.1f} MiB "
        f"for reading and {fitting / 2**20:5.1f} MiB for the fit"
    )


def main() -> None:
    """Write each log, fit it in a process of its own, remove it."""
    if sys.argv[1:2] == ["--fit"]:
        return print_memory(Path(sys.argv[2]))
    for minutes in map(int, sys.argv[1:] or (6, 60)):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "swing.mcap")
            write_swinging(path, minutes)
            subprocess.run([sys.executable, __file__, "--fit", path], check=True)


if __name__ == "__main__":
    main()
