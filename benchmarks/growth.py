"""Growth of the time and memory of `idtool fit` with samples, bodies, joints, logs and worker processes.

Run ``python benchmarks/growth.py [samples] [bodies] [joints] [thorough] [logs] [workers] [--full]``; default: all.
Robots and logs are those of `long_logs`. Every size is fitted in a fresh process, and the figures are of the whole
command: start-up, reading, fit and page. Their exponents are slopes in a double logarithmic plot: a fixed part, such as
the start of 1 s or the memory of the libraries, makes them smaller, so that of the two largest sizes is given, too. The
command is that of `COMMAND`, ``thorough`` without ``--quick``; each series starts with a run that does not count.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from child_cost import Cost, cost_of

COMMAND = "idtool fit robot.urdf LOG… --quick --quiet"
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Task:
    """A robot with its logs, and the options of the fit.

    Attributes
    ----------
    size
        Value of the quantity that grows.
    branches, length, rotors
        The robot, see `long_logs.BranchedRobot`.
    minutes, logs
        Length of each log [min], and number of logs.
    jobs
        Number of processes; None: idtool's own choice.
    quick
        False for a fit with ranges, simulation and the search for faults.
    """

    size: float
    branches: int = 4
    length: int = 3
    rotors: bool = False
    minutes: float = 1.0
    logs: int = 1
    jobs: int | None = None
    quick: bool = True

    @property
    def files(self) -> tuple[object, ...]:
        """Everything that the robot and its logs depend on."""
        return (self.branches, self.length, self.rotors, self.minutes, self.logs)


@dataclass(frozen=True)
class Series:
    """Sizes of one quantity.

    Attributes
    ----------
    quantity
        Name of the quantity.
    unit
        Unit of the sizes.
    description
        The robot and the logs.
    tasks
        The sizes, in ascending order.
    full_tasks
        Larger sizes that take minutes.
    repetitions
        Number of runs of each size, by turns; the least times count, those least disturbed by other programs.
    """

    quantity: str
    unit: str
    description: str
    tasks: tuple[Task, ...]
    full_tasks: tuple[Task, ...] = ()
    repetitions: int = 2


SHORT = 20 / 60  # min
SERIES = (
    Series(
        "samples",
        "minutes at 1 kHz",
        "quadruped with 12 joints, one log",
        tuple(Task(minutes, minutes=minutes) for minutes in (1, 10)),
        (Task(60, minutes=60),),
    ),
    Series(
        "bodies",
        "bodies",
        "chain of joints, each with a link and a geared rotor, 20 s",
        tuple(Task(n, branches=1, length=n // 2, rotors=True, minutes=SHORT) for n in (6, 14, 30, 60)),
    ),
    Series(
        "joints",
        "joints",
        "chain of joints without rotors, 20 s",
        tuple(Task(n, branches=1, length=n, minutes=SHORT) for n in (3, 6, 12, 24)),
        (Task(60, branches=1, length=60, minutes=SHORT),),
    ),
    Series(
        "thorough",
        "joints",
        "the same chains, fitted without --quick",
        tuple(Task(n, branches=1, length=n, minutes=SHORT, quick=False) for n in (3, 6, 12, 24)),
        (Task(60, branches=1, length=60, minutes=SHORT, quick=False),),
        repetitions=1,
    ),
    Series(
        "logs",
        "logs of 4 s",
        "quadruped with 12 joints",
        tuple(Task(n, logs=n, minutes=4 / 60) for n in (1, 20, 200)),
    ),
    Series(
        "workers",
        "processes",
        "quadruped with 12 joints, one log of 10 minutes",
        tuple(Task(n, minutes=10, jobs=n) for n in (1, 2)),
        repetitions=4,
    ),
)


@dataclass(frozen=True)
class Growth:
    """Measured costs of a series.

    Attributes
    ----------
    quantity, unit, description
        See `Series`.
    sizes
        The sizes, ascending.
    costs
        Wall time [s], CPU time [s] and memory [bytes] for each size.
    load
        Load of the machine when the series began: processes that ran or waited, mean of a minute.
    """

    quantity: str
    unit: str
    description: str
    sizes: tuple[float, ...]
    costs: tuple[Cost, ...]
    load: float = field(default=0.0)

    def values(self, name: str) -> list[float]:
        """One of the figures of `Cost` for each size."""
        return [float(getattr(cost, name)) for cost in self.costs]

    def exponent(self, name: str) -> float:
        """Slope of a figure over the sizes, both as logarithms, by least squares."""
        return log_slope(self.sizes, self.values(name))

    def last_exponent(self, name: str) -> float:
        """Slope between the two largest sizes."""
        return log_slope(self.sizes[-2:], self.values(name)[-2:])

    def as_data(self) -> dict[str, object]:
        """The figures with their exponents, as plain data."""
        exponents = {}
        for name in ("wall", "cpu", "memory"):
            exponents[name] = {"all": self.exponent(name), "last": self.last_exponent(name)}
        return {**asdict(self), "exponents": exponents}


def log_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope of log y over log x by least squares.

    Raises
    ------
    ValueError
        If there are fewer than two different x, or a number is not positive.
    """
    if len(set(x)) < 2 or min(*x, *y) <= 0:
        raise ValueError("an exponent needs two sizes, and positive numbers")
    slope, _ = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope)


def write_files(task: Task, folder: Path) -> None:
    """Write a task's robot and logs."""
    options = ["--branches", task.branches, "--length", task.length, "--minutes", task.minutes, "--logs", task.logs]
    command = [sys.executable, HERE / "long_logs.py", folder, *options]
    if task.rotors:
        command.append("--rotors")
    cost_of([*map(str, command)])


def measure(task: Task, folder: Path) -> Cost:
    """Cost of the fit of a task whose files are in a folder."""
    logs = [folder / f"log_{i}.mcap" for i in range(task.logs)]
    options: list[object] = ["--out", folder / "out", "--quiet"]
    if task.quick:
        options.append("--quick")
    if task.jobs is not None:
        options += ["--jobs", task.jobs]
    command = [sys.executable, "-m", "idtool", "fit", folder / "robot.urdf", *logs, *options]
    return cost_of([*map(str, command)])


def measure_series(series: Series, full: bool) -> Growth:
    """Costs of all sizes of a series, the least times and the largest memory of the repetitions, which take turns."""
    tasks = series.tasks + (series.full_tasks if full else ())
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        folders: dict[tuple[object, ...], Path] = {}
        for task in tasks:
            if task.files not in folders:
                folders[task.files] = Path(name, str(len(folders)))
                write_files(task, folders[task.files])
        measure(tasks[0], folders[tasks[0].files])  # compiles what it imports
        runs: list[list[Cost]] = []
        for _ in range(series.repetitions):
            runs.append([measure(task, folders[task.files]) for task in tasks])
    costs = []
    for of_size in zip(*runs, strict=True):
        wall = min(cost.wall for cost in of_size)
        cpu = min(cost.cpu for cost in of_size)
        costs.append(Cost(wall, cpu, max(cost.memory for cost in of_size)))
    sizes = tuple(float(task.size) for task in tasks)
    return Growth(series.quantity, series.unit, series.description, sizes, tuple(costs), load)


def growth_text(growth: Growth) -> str:
    """A table of a growth."""
    lines = [f"{growth.quantity}: {growth.description} (load {growth.load:.1f})"]
    lines.append(f"{growth.unit:>18s}{'wall [s]':>12s}{'CPU [s]':>12s}{'memory [MiB]':>14s}")
    for size, cost in zip(growth.sizes, growth.costs, strict=True):
        lines.append(f"{size:18g}{cost.wall:12.2f}{cost.cpu:12.2f}{cost.memory / 2**20:14.0f}")
    for words, exponent in (("exponent", growth.exponent), ("of the last two", growth.last_exponent)):
        lines.append(f"{words:>18s}{exponent('wall'):12.2f}{exponent('cpu'):12.2f}{exponent('memory'):14.2f}")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    names = [series.quantity for series in SERIES]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("quantities", nargs="*", metavar="QUANTITY", help=", ".join(names))
    parser.add_argument("--full", action="store_true", help="also the sizes that take minutes")
    options = parser.parse_args()
    unknown = [quantity for quantity in options.quantities if quantity not in names]
    if unknown:
        parser.error(f"{unknown[0]}: is none of {', '.join(names)}")
    for series in SERIES:
        if not options.quantities or series.quantity in options.quantities:
            print(growth_text(measure_series(series, options.full)), flush=True)


if __name__ == "__main__":
    main()
