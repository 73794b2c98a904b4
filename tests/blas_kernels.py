"""The tests under several of OpenBLAS's kernels: `python tests/blas_kernels.py --jobs 2 Haswell Sandybridge`.

numpy's and scipy's OpenBLAS have kernels for several kinds of CPU, whose results differ in the last bits. They take the
one that suits the machine, or that of OPENBLAS_CORETYPE. A kernel that this CPU cannot run is skipped, as is one that
OpenBLAS has no kernel of its own for.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys

WORK = "import numpy, scipy.linalg; A = numpy.eye(64) + 0.01; A @ A; numpy.linalg.eigh(A); scipy.linalg.qr(A)"


def environment(kernel: str) -> dict[str, str]:
    return {**os.environ, "OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1"}


def loaded_kernels(kernel: str) -> tuple[str, ...]:
    """Kernels that numpy and scipy load when told to take this one; none where this CPU lacks its instructions."""
    probe = subprocess.run(
        [sys.executable, "-c", WORK],
        env={**environment(kernel), "OPENBLAS_VERBOSE": "2"},
        capture_output=True,
        text=True,
        check=False,
    )
    if probe.returncode == -signal.SIGILL:
        return ()
    probe.check_returncode()
    names = tuple(re.findall(r"^Core: (\w+)", probe.stderr, re.MULTILINE))
    if not names:
        sys.exit("error: numpy and scipy: have another BLAS than OpenBLAS, whose kernels cannot be chosen")
    return names


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("kernels", nargs="+")
    parser.add_argument("--jobs", default="2")
    options = parser.parse_args()
    failed = []
    tested: dict[tuple[str, ...], str] = {}
    for kernel in options.kernels:
        loaded = loaded_kernels(kernel)
        if not loaded:
            print(f"{kernel}: skipped, this CPU lacks its instructions", flush=True)
            continue
        if loaded in tested:
            print(f"{kernel}: skipped, OpenBLAS takes the kernel of {tested[loaded]} for it", flush=True)
            continue
        tested[loaded] = kernel
        print(f"{kernel}: numpy and scipy have loaded {' and '.join(loaded)}", flush=True)
        tests = [sys.executable, "-m", "pytest", "-n", options.jobs, "--dist", "worksteal", "-m", "not slow"]
        if subprocess.run(tests, env=environment(kernel), check=False).returncode:
            failed.append(kernel)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
