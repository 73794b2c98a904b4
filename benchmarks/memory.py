"""Memory of a whole fit of the leg, which should hardly grow with the log.

Run ``python benchmarks/memory.py [MINUTES ...]``; default: 6 and 60 minutes at 1 kHz. Each log is made, written, and
fitted in a fresh process. The figures are peaks of the resident set, as Linux reports it: of the whole process, and
of reading and of the fit less its size after the imports and less those arrays of the log that are in memory.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import sample_leg

from idtool.data.logs import make_log, write_log
from idtool.data.logs.stored_arrays import is_in_file
from idtool.data.signals import Motion
from idtool.estimation.fit import fit

RATE = 1000.0  # Hz
SAMPLES_PER_MINUTE = round(60 * RATE)


def write_swinging_log(path: Path, minutes: int) -> None:
    """Write a log of a leg whose joints follow sums of sines under the torque of the prior model, with noise."""
    equation = sample_leg.leg_experiment().equation
    rng = np.random.default_rng(0)
    frequency = 2 * np.pi * rng.uniform(0.1, 2.0, (8, 3, 1))
    amplitude = rng.uniform(0.05, 0.2, (8, 3, 1))
    start = rng.uniform(0, 2 * np.pi, (8, 3, 1))
    pieces = []
    for minute in range(minutes):
        t = (minute * SAMPLES_PER_MINUTE + np.arange(SAMPLES_PER_MINUTE)) / RATE
        phase = frequency * t + start
        q = (amplitude * np.sin(phase)).sum(axis=0)
        v = (amplitude * frequency * np.cos(phase)).sum(axis=0)
        a = -(amplitude * frequency**2 * np.sin(phase)).sum(axis=0)
        motion = Motion(t=t, q=q, v=v, a=a, tau=q, logged_tau=q, velocity_deadband=np.full(3, 1e-2), dt=1 / RATE)
        tau = equation.torque(motion, equation.prior)
        q_noisy = q + 3e-5 * rng.normal(size=q.shape)
        v_noisy = v + 1e-2 * rng.normal(size=v.shape)
        tau_noisy = tau + 0.4 * rng.normal(size=tau.shape)
        pieces.append([q_noisy, v_noisy, tau_noisy])
    q, v, tau = (np.concatenate(signal, axis=1).T for signal in zip(*pieces, strict=True))
    t = np.arange(minutes * SAMPLES_PER_MINUTE) / RATE
    write_log(path, make_log(path, t, equation.joints, {"q": q, "v": v, "tau": tau}))


def process_memory(name: str) -> int:
    """A figure of this process's memory by its name in /proc/self/status [bytes]."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.findall(rf"{name}:\s+(\d+)", status)[0])


def print_memory(path: Path) -> None:
    """Read and fit a log in this process; print the peak of the additional memory."""
    sample_leg.leg_experiment()  # so that the memory of late imports is not counted
    before = process_memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    experiment = sample_leg.leg_experiment(path, holdout=0.3)
    log = experiment.runs[0].signals.log
    arrays = [log.t, *log.signals.values()]
    size = sum(array.nbytes for array in arrays)
    in_memory = sum(array.nbytes for array in arrays if not is_in_file(array))
    reading_peak = process_memory("VmHWM")
    Path("/proc/self/clear_refs").write_text("5")
    fit(experiment, lambda *_: None)
    fitting_peak = process_memory("VmHWM")
    reading = reading_peak - before - in_memory
    fitting = fitting_peak - before - in_memory
    print(
        f"{len(log) / SAMPLES_PER_MINUTE:3.0f} min: {size / 2**20:6.1f} MiB of log, of which {in_memory / 2**20:5.1f} "
        f"in memory; beyond these at most {reading / 2**20:5.1f} MiB for reading and {fitting / 2**20:5.1f} MiB for "
        f"the fit; whole process at most {max(reading_peak, fitting_peak) / 2**20:5.1f} MiB"
    )


def main() -> None:
    """Write each log, fit it in a process of its own, and remove it."""
    if sys.argv[1:2] == ["--fit"]:
        return print_memory(Path(sys.argv[2]))
    for minutes in map(int, sys.argv[1:] or (6, 60)):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "swing.mcap")
            write_swinging_log(path, minutes)
            subprocess.run([sys.executable, __file__, "--fit", path], check=True)


if __name__ == "__main__":
    main()
