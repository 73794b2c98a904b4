"""All comparisons with other programs, and the growth of a fit's time and memory, in one table and one JSON file.

Run ``make bench``, or ``python benchmarks/bench.py [NAME…] [--full] [--update] [--out FILE]``. NAME is one of the
comparisons or a quantity that grows, such as ``workers``; default: all. A program that is not installed is listed as
such. ``--full`` adds sizes that take minutes. ``--update`` keeps what the file has of others, if it is of the same
machine and commit: for what other programs disturbed. ``python benchmarks/bench_page.py`` makes a page of the
documentation from the file.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import growth
import mcap_reading
import peer_drake
import peer_figaroh
import peer_mujoco_leg
import reduced_solve
import regressor
import simulate
from bench_record import FILE, Bench, Machine
from comparison import Comparison, duration_text
from growth import growth_text
from rich.console import Console
from rich.table import Table

import idtool

TABLE_WIDTH = 170  # characters


@dataclass(frozen=True)
class Measurement:
    """Comparisons with one program.

    Attributes
    ----------
    name
        Name on the command line.
    peer
        The program.
    comparisons
        Function that measures them.
    is_installed
        Function that tells if the program can be used.
    """

    name: str
    peer: str
    comparisons: Callable[[], list[Comparison]]
    is_installed: Callable[[], bool] = lambda: True


MEASUREMENTS = (
    Measurement("cvxpy", "cvxpy", reduced_solve.comparisons),
    Measurement("drake", "drake", peer_drake.comparisons, peer_drake.is_installed),
    Measurement("figaroh", "figaroh", peer_figaroh.comparisons, peer_figaroh.is_installed),
    Measurement("sysid", "mujoco[sysid]", peer_mujoco_leg.comparisons, peer_mujoco_leg.is_installed),
    Measurement("regressor", "pin", regressor.comparisons),
    Measurement("simulation", "pin", simulate.comparisons),
    Measurement("mcap", "mcap", mcap_reading.comparisons),
)


def all_names() -> list[str]:
    """Names of everything that can be measured."""
    return [*(measurement.name for measurement in MEASUREMENTS), *(series.quantity for series in growth.SERIES)]


def measure(names: Sequence[str], full: bool, tell: Callable[[str], None]) -> Bench:
    """Measure some of the comparisons, or all of them, and the growth.

    Parameters
    ----------
    names
        Names of `MEASUREMENTS` or of quantities that grow; none: all.
    full
        If true, also measure sizes that take minutes.
    tell
        Callback for what is measured now.
    """
    command = " ".join(["python benchmarks/bench.py", *names, *(["--full"] if full else [])])
    load = [os.getloadavg()[0]]
    today = f"{datetime.now(UTC):%Y-%m-%d}"
    bench = Bench(today, [command], idtool.__version__, _commit(), Machine.this(), load)
    for measurement in MEASUREMENTS:
        if names and measurement.name not in names:
            continue
        if not measurement.is_installed():
            bench.not_installed.append(measurement.peer)
            continue
        tell(measurement.name)
        try:
            bench.comparisons += measurement.comparisons()
        except Exception as failure:  # the others are still of interest
            bench.failures[measurement.name] = _reason(failure)
    for series in growth.SERIES:
        if names and series.quantity not in names:
            continue
        tell(f"growth with {series.quantity}")
        try:
            bench.growth.append(growth.measure_series(series, full))
        except Exception as failure:
            bench.failures[series.quantity] = _reason(failure)
    load.append(os.getloadavg()[0])
    return bench


def _reason(failure: Exception) -> str:
    return f"{type(failure).__name__}: {failure}".rstrip(": ")


def _commit() -> str:
    """The last commit that changed the package, with a + if its files differ from it; empty if it is unknown."""
    try:
        commit = _git("log", "-1", "--format=%h", "--", "idtool")
        changes = _git("status", "--porcelain", "--", "idtool")
    except (OSError, subprocess.CalledProcessError):
        return ""
    return f"{commit}+" if changes else commit


def _git(*arguments: str) -> str:
    folder = Path(__file__).parents[1]
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True)  # noqa: S607
    return done.stdout.strip()


def ratio_table(bench: Bench) -> Table:
    """The comparisons as a table; above 1, idtool is faster."""
    table = Table("task", "compared with", "idtool", "other", "ratio (range)", "difference of the results")
    for comparison in bench.comparisons:
        table.add_row(
            comparison.task,
            comparison.peer,
            duration_text(comparison.ours),
            duration_text(comparison.theirs),
            comparison.ratio_text,
            comparison.agreement_text,
        )
    for peer in bench.not_installed:
        table.add_row("", peer, "", "", "not installed", "")
    for name, reason in bench.failures.items():
        table.add_row(name, "", "", "", "failed", reason)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table and write the file; 1 if a measurement failed."""
    names = all_names()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(names))
    parser.add_argument("--full", action="store_true", help="also the sizes that take minutes")
    parser.add_argument("--update", action="store_true", help="keep what the file has of others")
    parser.add_argument("--out", type=Path, default=FILE, help=f"JSON file to write; default: {FILE.name} beside this")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in names]
    if unknown:
        parser.error(f"{unknown[0]}: is none of {', '.join(names)}")
    old = Bench.from_json(options.out.read_text()) if options.update else None
    if old is not None and (old.machine, old.commit) != (Machine.this(), _commit()):
        parser.error(f"{options.out}: is of another machine or commit; measure everything, without --update")
    bench = measure(options.names, options.full, lambda name: print(f"measuring {name} …", file=sys.stderr, flush=True))
    if old is not None:
        bench = old.updated(bench, options.names or names)
    console = Console(width=TABLE_WIDTH, markup=False, highlight=False)
    console.print(ratio_table(bench))
    for one in bench.growth:
        print(growth_text(one))
    options.out.write_text(bench.as_json())
    return 1 if bench.failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
