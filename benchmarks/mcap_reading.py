"""Reading of MCAP logs: time against the mcap package with its ROS 2 decoder, and memory beyond the result.

Run ``python benchmarks/mcap_reading.py``. Memory is the peak of the resident set, as Linux reports it.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from idtool.data.logs import JointLog, make_log, read_log, write_log

RATE = 1000.0  # Hz
JOINTS = ("abad", "hip", "knee")


def leg_log(path: Path, seconds: float) -> JointLog:
    """A log of a moving leg, with noise so that it does not compress too well."""
    count = int(seconds * RATE)
    t = 1.7e9 + np.arange(count) / RATE
    phase = np.linspace(0.0, 2 * np.pi * 0.7 * seconds, count)[:, None] * (1.0, 1.3, 1.7)
    noise = np.random.default_rng(0).normal(scale=1e-3, size=phase.shape)
    return make_log(path, t, JOINTS, {"q": np.sin(phase) + noise, "v": np.cos(phase) + noise, "tau": 3 * noise})


def seconds_by_decoder(path: Path) -> tuple[float, int]:
    """Time that the mcap package's decoder takes for the same arrays [s], and the number of samples."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    start = time.perf_counter()
    t, q, v, tau = [], [], [], []
    with path.open("rb") as file:
        for *_, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            t.append(message.header.stamp.sec + message.header.stamp.nanosec / 1e9)
            q.append(message.position)
            v.append(message.velocity)
            tau.append(message.effort)
    arrays = [np.array(t), np.array(q), np.array(v), np.array(tau)]
    return time.perf_counter() - start, len(arrays[0])


def seconds_by_idtool(path: Path) -> float:
    """Time that `read_log` takes [s]."""
    start = time.perf_counter()
    read_log(path)
    return time.perf_counter() - start


def process_memory(name: str) -> int:
    """A figure of this process's memory by its name in /proc/self/status [bytes]."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.findall(rf"{name}:\s+(\d+)", status)[0])


def print_memory(path: Path, warm_up: Path) -> None:
    """Read a log in this process; print its size in memory and the peak of the additional memory."""
    read_log(warm_up)  # so that the memory of imports is not counted
    before = process_memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    log = read_log(path)
    result = log.t.nbytes + sum(array.nbytes for array in log.signals.values())
    additional = process_memory("VmHWM") - before - result
    minutes = len(log) / RATE / 60
    print(f"{minutes:3.0f} min: {result / 2**20:6.1f} MiB of result, {additional / 2**20:6.1f} MiB beyond it at most")


def main() -> None:
    """Write logs, then print the ratio of times and the memory."""
    if len(sys.argv) == 3:
        return print_memory(Path(sys.argv[1]), Path(sys.argv[2]))
    with tempfile.TemporaryDirectory() as folder:
        paths = {minutes: Path(folder, f"{minutes}.mcap") for minutes in (1, 6, 60)}
        for minutes, path in paths.items():
            write_log(path, leg_log(path, 60 * minutes))
        ours = min(seconds_by_idtool(paths[1]) for _ in range(5))
        theirs, count = min(seconds_by_decoder(paths[1]) for _ in range(2))
        print(
            f"{count} messages: mcap and mcap_ros2 {theirs / count * 1e6:.2f} µs each, "
            f"idtool {ours / count * 1e6:.2f} µs each, ratio {theirs / ours:.1f}"
        )
        for minutes in (6, 60):
            subprocess.run([sys.executable, __file__, paths[minutes], paths[1]], check=True)


if __name__ == "__main__":
    main()
