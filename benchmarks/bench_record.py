"""Records of everything that one run of the benchmarks measured, and their JSON file."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from child_cost import Cost
from comparison import Comparison
from growth import Growth

FILE = Path(__file__).with_name("bench.json")
PACKAGES = ("numpy", "scipy", "clarabel", "cvxpy", "pin", "mcap", "mujoco", "drake", "figaroh")


@dataclass(frozen=True)
class Machine:
    """The machine of a measurement.

    Attributes
    ----------
    processor
        Name of the processor.
    cores
        Number of its cores.
    memory
        Its memory [bytes].
    system
        Operating system.
    python
        Version of Python.
    packages
        Versions of packages by name, of those that are installed.
    """

    processor: str
    cores: int
    memory: int
    system: str
    python: str
    packages: dict[str, str]

    @classmethod
    def this(cls) -> Machine:
        """The machine that this program runs on."""
        packages = {}
        for name in PACKAGES:
            try:
                packages[name] = metadata.version(name)
            except metadata.PackageNotFoundError:
                continue
        return cls(
            processor=_processor(),
            cores=os.cpu_count() or 1,
            memory=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
            system=platform.system(),
            python=platform.python_version(),
            packages=packages,
        )


@dataclass
class Bench:
    """Everything that was measured with one version on one machine.

    Attributes
    ----------
    date
        Day of the measurement, UTC.
    commands
        The command lines.
    version, commit
        Version of idtool; the last commit that changed the package, empty if it is unknown.
    machine
        The machine.
    load
        Load of the machine before and after each command: processes that ran or waited, mean of a minute.
    comparisons
        Comparisons with other programs.
    not_installed
        Programs that are not installed.
    failures
        Measurements that failed, with the reason.
    growth
        Growth of time and memory.
    """

    date: str
    commands: list[str]
    version: str
    commit: str
    machine: Machine
    load: list[float]
    comparisons: list[Comparison] = field(default_factory=list)
    not_installed: list[str] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    growth: list[Growth] = field(default_factory=list)

    @classmethod
    def from_json(cls, text: str) -> Bench:
        """The record of a file."""
        data = json.loads(text)
        data["machine"] = Machine(**data["machine"])
        data["comparisons"] = [Comparison(**row) for row in data["comparisons"]]
        data["growth"] = [_growth(**row) for row in data["growth"]]
        return cls(**data)

    def updated(self, later: Bench, names: Sequence[str]) -> Bench:
        """The record with what was measured later on the same machine with the same version.

        Parameters
        ----------
        later
            The later record.
        names
            Names of what it measured.
        """
        comparisons = {(one.task, one.peer): one for one in (*self.comparisons, *later.comparisons)}
        quantities = {one.quantity: one for one in (*self.growth, *later.growth)}
        failures = {name: reason for name, reason in self.failures.items() if name not in names}
        return replace(
            later,
            commands=[*self.commands, *later.commands],
            load=[*self.load, *later.load],
            comparisons=list(comparisons.values()),
            not_installed=list(dict.fromkeys([*self.not_installed, *later.not_installed])),
            failures={**failures, **later.failures},
            growth=list(quantities.values()),
        )

    def as_json(self) -> str:
        """The figures as JSON, with the exponents of the growth."""
        data = asdict(self)
        data["growth"] = [one.as_data() for one in self.growth]
        return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _growth(sizes: list[float], costs: list[dict[str, Any]], exponents: object, **others: Any) -> Growth:
    """The growth of a file; its exponents are computed again."""
    return Growth(sizes=tuple(sizes), costs=tuple(Cost(**cost) for cost in costs), **others)


def _processor() -> str:
    """Name of the processor as Linux tells it."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    names = re.findall(r"model name\s*:\s*(.+)", text)
    return names[0] if names else platform.machine()
