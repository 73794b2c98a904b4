"""How well `idtool diagnose` names what is hidden in simulated robots.

Run ``python benchmarks/scoreboard.py [--kind single,pairs,triples,several,clean,unknown] [--jobs N] [--cache DIR]``;
``--robots``, ``--effects``, ``--magnitudes``, ``--seeds`` take some of the cases, ``--keep DIR`` keeps what idtool
wrote.

The cases are those of benchmarks/hidden_effects, which shares no code with idtool: three robots in MuJoCo whose bodies
are 10 to 20 % from their URDFs', effects applied as physics. Every case is one run of the command, timed from outside.
A line says what is hidden, in a case's name, and what was named, by effect and place: ``stribeck_friction.hip``. Then:

- ``exact``: what is hidden was named, where it is, and nothing else was. ``or a pair``: the same if a step that is
  reported as a pair stands for either of its two. ``first``: the first step is right, whatever follows. ``among``: all
  that is hidden was named, whatever else was. The lines of these begin with ``=``, ``~`` and, for ``among``, ``+``.
- the confusion matrix: hidden effect by the one named first.
- ``closed``: (before − after) / (before − floor), of the RMS error of the torque on what was held out, over all joints,
  and over the joints where something is hidden; the floor is the one that was reported.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from hidden_effects.cases import Case, cases, write_case
from hidden_effects.effects import MAGNITUDES
from hidden_effects.plans import KINDS, numbers
from hidden_effects.robots import ROBOTS

Key = tuple[str, str | None]  # effect, and the joint or link that it acts on

TIMEOUT = 900.0  # s
SEEDS = {"clean": "0-9"}
PLAIN = ("strong", "ordinary")  # magnitudes that should be named


@dataclass(frozen=True)
class Named:
    """A step of a diagnosis, and the other that it might be where it is reported as a pair."""

    key: Key
    other: Key | None


@dataclass(frozen=True)
class Outcome:
    """What came of a case; ``closed`` overall and at the joints of what is hidden, None where there was no gap."""

    case: Case
    steps: tuple[Named, ...]
    verdict: str
    closed: tuple[float | None, float | None]
    faults: tuple[str, ...]
    seconds: float

    @property
    def truth(self) -> tuple[Key, ...]:
        """What is hidden."""
        return tuple((one.effect, one.joint or one.link) for one in self.case.hidden)

    @property
    def named(self) -> tuple[Named, ...]:
        """The steps that name something; those of a delay on every joint are one of all."""
        steps = [step for step in self.steps if step.key[0] != "unknown"]
        late = [step for step in steps if step.key[0] == "time_delay" and step.key[1]]
        if len({step.key for step in late}) < len(ROBOTS[self.case.robot].joints):
            return tuple(steps)
        return (*(step for step in steps if step not in late), Named(("time_delay", None), None))

    @property
    def among(self) -> bool:
        """Whether all that is hidden was named."""
        return set(self.truth) <= {step.key for step in self.named}

    @property
    def first(self) -> bool:
        """Whether the first step is right."""
        return bool(self.named) and self.named[0].key in self.truth

    @property
    def exact(self) -> bool:
        """Whether what is hidden was named, and nothing else."""
        return sorted(map(str, self.truth)) == sorted(str(step.key) for step in self.named)

    @property
    def pair(self) -> bool:
        """Whether every hidden effect is a step of its own, or one of a step's two, and there is no other step."""
        left = [{step.key, step.other} for step in self.named]
        for key in self.truth:
            found = next((two for two in left if key in two), None)
            if found is None:
                return False
            left.remove(found)
        return not left

    @property
    def unknown(self) -> bool:
        """Whether something was called unknown at a joint where something unknown is hidden."""
        return bool({step.key for step in self.steps} & {key for key in self.truth if key[0] == "unknown"})

    @property
    def failed(self) -> bool:
        """Whether there is no diagnosis."""
        return self.verdict.startswith(("failed", "timeout"))

    def line(self) -> str:
        """The case in a line."""
        steps = [_text(step.key) + (f" or {_text(step.other)}" if step.other else "") for step in self.steps]
        mark = "=" if self.exact else "~" if self.pair else "+" if self.among else " "
        closed = "  ".join("   -" if x is None else f"{x:4.2f}" for x in self.closed)
        faults = f"  faults: {', '.join(self.faults)}" if self.faults else ""
        found = ", ".join(steps) or "nothing"
        return f"{mark} {self.case.name} → {found}  [{self.verdict}, closed {closed}, {self.seconds:.0f} s]{faults}"

    def data(self) -> dict[str, Any]:
        """The same for JSON."""
        steps = [[_text(step.key), _text(step.other) if step.other else None] for step in self.steps]
        own = {"case": self.case.name, "truth": [_text(key) for key in self.truth], "steps": steps}
        return own | {"verdict": self.verdict, "closed": self.closed, "faults": self.faults, "seconds": self.seconds}


def _text(key: Key) -> str:
    return f"{key[0]}.{key[1] or 'all'}"


def read_outcome(case: Case, report: Mapping[str, Any], seconds: float) -> Outcome:
    """What a diagnosis.json says (contract, section 5)."""
    steps = []
    for step in report["steps"]:
        pair = step["evidence"].get("pair") and step["alternatives"]
        steps.append(Named(_key(step), _key(step["alternatives"][0]) if pair else None))
    places = {joint for one in case.hidden for joint in [one.joint] if joint}
    before, after = (report[name]["validation"] or report[name]["train"] for name in ("before", "after"))
    floor = report["noise_floor"]
    closed = _closed(before, after, floor, ["overall"]), _closed(before, after, floor, sorted(places) or ["overall"])
    faults = tuple(f"{fault['fault']}.{fault['joint']}" for fault in report["data_faults"])
    return Outcome(case, tuple(steps), report["verdict"], closed, faults, seconds)


def _key(named: Mapping[str, Any]) -> Key:
    return named["effect"], named.get("joint") or named.get("link")


def _closed(before: Any, after: Any, floor: Any, names: Sequence[str]) -> float | None:
    """Share of the gap, of the root of the mean square; None without a gap of 5 %."""
    a, b, c = (np.sqrt(np.mean([values[name] ** 2 for name in names])) for values in (before, after, floor))
    return float((a - b) / (a - c)) if a - c > 0.05 * a else None


def run(case: Case, cache: Path, keep: Path) -> Outcome:
    """Make a case where it is not there yet, and diagnose it."""
    try:
        files, out = write_case(case, cache / f"{case.name}_{case.seconds:g}"), keep / case.name
    except RuntimeError as error:
        return _nothing(case, f"failed: {error}", 0.0)
    command = [sys.executable, "-c", "from idtool.cli import main; main()", "diagnose", files.urdf, files.log]
    command += ["--config", files.config, "--out", out, "--inertia", case.inertia, "--json", "--quiet"]
    start = time.perf_counter()
    try:
        done = subprocess.run(
            list(map(str, command)), capture_output=True, text=True, timeout=TIMEOUT, env=os.environ, check=False
        )
    except subprocess.TimeoutExpired:
        return _nothing(case, "timeout", TIMEOUT)
    seconds = time.perf_counter() - start
    if done.returncode:
        message = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return _nothing(case, f"failed: {message}", seconds)
    return read_outcome(case, json.loads(done.stdout), seconds)


def _nothing(case: Case, verdict: str, seconds: float) -> Outcome:
    return Outcome(case, (), verdict, (None, None), (), seconds)


def share(hits: Sequence[bool]) -> str:
    """So many of how many."""
    return f"{sum(hits)}/{len(hits)}" + (f" = {100 * np.mean(hits):.0f} %" if hits else "")


def print_confusion(outcomes: Sequence[Outcome]) -> None:
    """Hidden effect by the first that was named."""
    table: dict[str, Counter[str]] = {}
    for one in outcomes:
        (effect, place), *_ = one.truth or (("clean", None),)
        found = one.steps[0].key if one.steps else ("failed" if one.failed else "none", None)
        elsewhere = found[0] == effect and found[1] != place
        table.setdefault(effect, Counter())[f"{found[0]} elsewhere" if elsewhere else found[0]] += 1
    print("\nhidden effect: how often which was named first")
    for effect in sorted(table):
        others = ", ".join(f"{name} {count}" for name, count in table[effect].most_common() if name != effect)
        print(f"  {effect:24} {table[effect][effect]:3} of {table[effect].total():3}   {others}")


def print_summary(kind: str, outcomes: Sequence[Outcome]) -> None:
    """The figures of a kind of cases."""
    print(f"\n{kind}: {len(outcomes)} cases")
    if kind == "clean":
        made = [one for one in outcomes if not one.failed]
        print(f"  something invented: {share([bool(one.named) for one in made])}")
        print(f"  called unknown: {share([any(step.key[0] == 'unknown' for step in one.steps) for one in made])}")
        print(f"  no_disagreement: {share([one.verdict == 'no_disagreement' for one in made])}")
    for size in ("plain", *MAGNITUDES) if kind != "clean" else ():
        sizes = PLAIN if size == "plain" else (size,)
        some = [one for one in outcomes if {each.magnitude for each in one.case.hidden} <= set(sizes)]
        label = "strong and ordinary" if size == "plain" else size
        if some and kind == "unknown":
            alone = share([one.unknown and not one.named for one in some])
            print(f"  {label}: called unknown {share([one.unknown for one in some])}, and nothing else named {alone}")
        elif some:
            figures = {
                name: share([getattr(one, name) for one in some]) for name in ("exact", "pair", "first", "among")
            }
            print("  {}: exact {exact}, or a pair {pair}; first {first}, among {among}".format(label, **figures))
    for k, where in enumerate(("overall", "at its joints")) if kind not in ("clean", "unknown") else ():
        closed = [one.closed[k] for one in outcomes if one.closed[k] is not None]
        if closed:
            low, middle = np.quantile(closed, (0.25, 0.5))
            print(f"  closed {where}: median {middle:.2f}, a quarter below {low:.2f}, of {len(closed)}")
    seconds = [one.seconds for one in outcomes]
    print(f"  data faults: {sum(bool(one.faults) for one in outcomes)}; failed: {sum(one.failed for one in outcomes)}")
    print(f"  time: median {np.median(seconds):.0f} s, longest {max(seconds):.0f} s")


def listed(text: str) -> list[str]:
    """What stands between commas."""
    return [part for part in text.split(",") if part]


def chosen(options: argparse.Namespace, kind: str) -> list[Case]:
    """The cases asked for."""
    seeds, effects = options.seeds or SEEDS.get(kind, "0-2"), set(listed(options.effects))
    found = cases(kind, listed(options.robots), listed(options.magnitudes), numbers(seeds), options.seconds)
    return [case for case in found if not effects or effects & {one.effect for one in case.hidden}]


def main(arguments: Sequence[str] | None = None) -> None:
    """Every kind asked for."""
    parser = argparse.ArgumentParser(description="How well `idtool diagnose` names what is hidden in simulated robots.")
    parser.add_argument("--kind", default=",".join(KINDS), help="default: %(default)s")
    for name, default in (("robots", ",".join(ROBOTS)), ("effects", ""), ("magnitudes", ",".join(MAGNITUDES))):
        parser.add_argument(f"--{name}", default=default, help=f"default: {default or 'all'}")
    parser.add_argument("--seeds", help="such as 0,3-5; default: 0-2, of clean cases 0-9")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of the logs")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="folder in which logs are kept for another time")
    parser.add_argument("--keep", type=Path, help="folder for the diagnoses")
    parser.add_argument("--json", type=Path, help="file for the results")
    options = parser.parse_args(arguments)
    results: dict[str, list[Outcome]] = {}
    with tempfile.TemporaryDirectory() as scratch, Pool(options.jobs) as pool:
        folders = {"cache": options.cache or Path(scratch), "keep": options.keep or Path(scratch) / "out"}
        for kind in listed(options.kind):
            results[kind] = []
            for outcome in pool.imap_unordered(partial(run, **folders), chosen(options, kind)):
                results[kind].append(outcome)
                print(outcome.line(), flush=True)
    for kind, outcomes in results.items():
        if outcomes:
            print_summary(kind, outcomes)
    print_confusion([one for kind in ("single", "unknown", "clean") for one in results.get(kind, [])])
    if options.json:
        options.json.write_text(
            json.dumps({k: [one.data() for one in found] for k, found in results.items()}, indent=1)
        )


if __name__ == "__main__":
    main()
