"""Reading of MCAP logs: time against the mcap package with its ROS 2 decoder, and memory beyond the result.

Run ``python benchmarks/mcap_reading.py``. Memory is the peak of the resident set, as Linux reports it.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from comparison import Comparison, compare, version_text
from numpy.typing import NDArray

from idtool.data.logs import JointLog, make_log, read_log, write_log

Array = NDArray[np.float64]

RATE = 1000.0  # Hz
MINUTE = 60.0  # s
REPETITIONS = 3
JOINTS = ("abad", "hip", "knee")


def leg_log(path: Path, seconds: float) -> JointLog:
    """A log of a moving leg, with noise so that it does not compress too well."""
    count = int(seconds * RATE)
    t = 1.7e9 + np.arange(count) / RATE
    phase = np.linspace(0.0, 2 * np.pi * 0.7 * seconds, count)[:, None] * (1.0, 1.3, 1.7)
    noise = np.random.default_rng(0).normal(scale=1e-3, size=phase.shape)
    return make_log(path, t, JOINTS, {"q": np.sin(phase) + noise, "v": np.cos(phase) + noise, "tau": 3 * noise})


def arrays_by_decoder(path: Path) -> dict[str, Array]:
    """The arrays of a log by the mcap package's decoder."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    t, q, v, tau = [], [], [], []
    with path.open("rb") as file:
        for *_, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            t.append(message.header.stamp.sec + message.header.stamp.nanosec / 1e9)
            q.append(message.position)
            v.append(message.velocity)
            tau.append(message.effort)
    return {"t": np.array(t), "q": np.array(q), "v": np.array(v), "tau": np.array(tau)}


def comparisons() -> list[Comparison]:
    """Check that a minute of a log is read alike, and read it by turns."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "log.mcap")
        write_log(path, leg_log(path, MINUTE))
        log, decoded = read_log(path), arrays_by_decoder(path)
        for name, values in log.signals.items():
            np.testing.assert_array_equal(values, decoded[name])
        difference = float(np.abs(np.diff(log.t) - np.diff(decoded["t"])).max())
        assert difference < 1e-6
        comparison = compare(
            f"reading {len(log)} joint states of an MCAP log",
            version_text("mcap", "mcap-ros2-support"),
            lambda: read_log(path),
            lambda: arrays_by_decoder(path),
            REPETITIONS,
            {"largest of q, v, tau": 0.0, "time steps [s]": difference},
        )
    return [comparison]


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
    """Print the ratio of times, then write longer logs and print the memory."""
    if len(sys.argv) == 3:
        return print_memory(Path(sys.argv[1]), Path(sys.argv[2]))
    for comparison in comparisons():
        print(comparison)
    with tempfile.TemporaryDirectory() as folder:
        paths = {minutes: Path(folder, f"{minutes}.mcap") for minutes in (1, 6, 60)}
        for minutes, path in paths.items():
            write_log(path, leg_log(path, MINUTE * minutes))
        for minutes in (6, 60):
            subprocess.run([sys.executable, __file__, paths[minutes], paths[1]], check=True)


if __name__ == "__main__":
    main()
