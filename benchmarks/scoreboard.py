"""Benchmark of `idtool diagnose` on simulated robots with hidden effects.

Run ``python benchmarks/scoreboard.py [--kind single,clean,variants] [--jobs N] [--cache DIR]``; ``--robots``,
``--effects``, ``--magnitudes``, ``--seeds`` select cases, ``--friction`` and ``--noise`` change their simulation, and
``--keep DIR`` keeps the files of idtool.

The cases are those of benchmarks/hidden_effects, which shares no code with idtool: three robots in MuJoCo whose bodies
are 10 to 20 % from their URDFs', and effects applied as physics. Every case is one run of the command, timed from
outside. Its line has the hidden effects, in the case's name, and the reported ones, by effect and location, such as
``stribeck_friction.hip``. Then follow:

- ``exact``: the hidden effects were reported at their locations, and nothing else. ``or a pair``: the same, where a
  step that is reported as a pair may stand for either of its two effects. ``first``: the first step is right, whatever
  follows. ``among``: all hidden effects were reported, whatever else was. Lines of these cases begin with ``=``, ``~``
  and, for ``among``, ``+``.
- the confusion matrix: the hidden effect by the one reported first.
- ``time``, and the CPU time of the command with its child processes.
- ``closed``: (before − after) / (before − floor), of the RMS torque error on the held-out data, over all joints, and
  over the joints with hidden effects; the floor is the reported one.
- what no diagnosis should do, over all cases: steps that increase the error on the held-out data, and the verdict
  ``no_disagreement`` with a joint whose residual is not noise.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from hidden_effects.case_files import write_case
from hidden_effects.case_list import FRICTION_HELP, KINDS, NOISE_HELP, Case, list_cases, parse_numbers
from hidden_effects.effects import MAGNITUDES
from hidden_effects.friction import FRICTION_KINDS
from hidden_effects.logs import NOISE_KINDS
from hidden_effects.robots import ROBOTS

EffectKey = tuple[str, str | None]  # effect, and the joint or link that it acts on

TIMEOUT = 900.0  # s
DEFAULT_SEEDS = {"clean": "0-15"}  # every combination of friction and noise once
SEEDS_OF_OTHERS = "0-2"
MAX_JOINT_INCREASE = 0.02  # of the held-out error of any joint, by a step
MAX_ERROR_OVER_FLOOR = 1.3  # of a joint, if nothing disagrees
IDENTIFIABLE = ("strong", "ordinary")  # magnitudes that a diagnosis should find


@dataclass(frozen=True)
class ReportedStep:
    """A step of a diagnosis.

    Attributes
    ----------
    key
        The effect and its location.
    alternative
        Another effect, if the data cannot distinguish the two.
    increases_error
        True if the error on the held-out data, over all joints, is larger after the step than before.
    increases_joint_error
        True if that of any joint is more than 2 % larger.
    """

    key: EffectKey
    alternative: EffectKey | None
    increases_error: bool = False
    increases_joint_error: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of one case.

    Attributes
    ----------
    case
        The case.
    steps
        Steps of the diagnosis.
    verdict
        The diagnosis' verdict, or the reason why there is none.
    closed_gap
        Share of the gap that was closed, over all joints, and over the joints with hidden effects; None: no gap.
    faults
        Data faults that were reported.
    seconds
        Wall time [s].
    cpu_seconds
        CPU time of the command and of its child processes [s].
    joints_above_floor
        Joints whose error on the held-out data is above 1.3 times their noise floor in the end.
    """

    case: Case
    steps: tuple[ReportedStep, ...]
    verdict: str
    closed_gap: tuple[float | None, float | None]
    faults: tuple[str, ...]
    seconds: float
    cpu_seconds: float = 0.0
    joints_above_floor: tuple[str, ...] = ()

    @property
    def truth(self) -> tuple[EffectKey, ...]:
        """The hidden effects."""
        return tuple((effect.effect, effect.joint or effect.link) for effect in self.case.hidden)

    @property
    def identified(self) -> tuple[ReportedStep, ...]:
        """Steps other than ``unknown``; delays of every joint count as one delay of all."""
        steps = [step for step in self.steps if step.key[0] != "unknown"]
        delays = [step for step in steps if step.key[0] == "time_delay" and step.key[1]]
        if len({step.key for step in delays}) < len(ROBOTS[self.case.robot].joints):
            return tuple(steps)
        others = [step for step in steps if step not in delays]
        return (*others, ReportedStep(("time_delay", None), None))

    @property
    def has_all(self) -> bool:
        """True if all hidden effects were reported."""
        return set(self.truth) <= {step.key for step in self.identified}

    @property
    def has_right_first(self) -> bool:
        """True if the first step is a hidden effect."""
        return bool(self.identified) and self.identified[0].key in self.truth

    @property
    def is_exact(self) -> bool:
        """True if the hidden effects were reported, and nothing else."""
        return sorted(map(str, self.truth)) == sorted(str(step.key) for step in self.identified)

    @property
    def is_exact_with_pairs(self) -> bool:
        """True if every hidden effect is one of the effects of a step of its own, and there is no other step."""
        of_steps = [{step.key, step.alternative} for step in self.identified]
        if len(of_steps) != len(self.truth):
            return False
        assignments = permutations(self.truth)
        return any(all(key in keys for key, keys in zip(order, of_steps, strict=True)) for order in assignments)

    @property
    def invented(self) -> list[ReportedStep]:
        """Steps that name what is not there; LuGre's friction has presliding, of any size."""
        of_friction = {"presliding_hysteresis"} if self.case.friction == "lugre" else set()
        return [step for step in self.identified if step.key not in self.truth and step.key[0] not in of_friction]

    @property
    def has_right_unknown(self) -> bool:
        """True if ``unknown`` was reported at a joint where an unknown effect is hidden."""
        unknown = {key for key in self.truth if key[0] == "unknown"}
        return bool({step.key for step in self.steps} & unknown)

    @property
    def has_missed_disagreement(self) -> bool:
        """True if the verdict is ``no_disagreement`` although the residual of a joint is not noise."""
        return self.verdict == "no_disagreement" and bool(self.joints_above_floor)

    @property
    def has_failed(self) -> bool:
        """True if there is no diagnosis."""
        return self.verdict.startswith(("failed", "timeout"))

    def line(self) -> str:
        """The outcome in one line of text."""
        mark = "=" if self.is_exact else "~" if self.is_exact_with_pairs else "+" if self.has_all else " "
        steps = []
        for step in self.steps:
            alternative = f" or {_text(step.alternative)}" if step.alternative else ""
            steps.append(_text(step.key) + alternative)
        reported = ", ".join(steps) or "nothing"
        closed = "  ".join("   -" if x is None else f"{x:4.2f}" for x in self.closed_gap)
        faults = f"  faults: {', '.join(self.faults)}" if self.faults else ""
        time_text = f"{self.seconds:.0f} s, CPU {self.cpu_seconds:.0f} s"
        return f"{mark} {self.case.name} → {reported}  [{self.verdict}, closed {closed}, {time_text}]{faults}"

    def as_dict(self) -> dict[str, Any]:
        """The outcome as plain data for JSON."""
        steps = [[_text(step.key), _text(step.alternative) if step.alternative else None] for step in self.steps]
        increasing = [_text(step.key) for step in self.steps if step.increases_error]
        joint_increasing = [_text(step.key) for step in self.steps if step.increases_joint_error]
        return {
            "case": self.case.name,
            "truth": [_text(key) for key in self.truth],
            "steps": steps,
            "verdict": self.verdict,
            "closed": self.closed_gap,
            "faults": self.faults,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "steps_that_increase_error": increasing,
            "steps_that_increase_joint_error": joint_increasing,
            "joints_above_floor": self.joints_above_floor,
        }


def _text(key: EffectKey) -> str:
    return f"{key[0]}.{key[1] or 'all'}"


def read_outcome(case: Case, report: Mapping[str, Any], seconds: float, cpu_seconds: float = 0.0) -> Outcome:
    """The outcome of a case from the content of its diagnosis.json."""
    steps = [_read_step(step) for step in report["steps"]]
    before, after = (report[name]["validation"] or report[name]["train"] for name in ("before", "after"))
    floor = report["noise_floor"]
    hidden_joints = sorted({effect.joint for effect in case.hidden if effect.joint})
    closed_gap = (
        _closed_share(before, after, floor, ["overall"]),
        _closed_share(before, after, floor, hidden_joints or ["overall"]),
    )
    faults = tuple(f"{fault['fault']}.{fault['joint']}" for fault in report["data_faults"])
    above_floor = [
        joint for joint in floor if joint != "overall" and _exceeds(after, floor, joint, MAX_ERROR_OVER_FLOOR)
    ]
    verdict = report["verdict"]
    return Outcome(case, tuple(steps), verdict, closed_gap, faults, seconds, cpu_seconds, tuple(above_floor))


def _read_step(step: Mapping[str, Any]) -> ReportedStep:
    is_pair = step["evidence"].get("pair") and step["alternatives"]
    alternative = _key(step["alternatives"][0]) if is_pair else None
    before, after = step["validation_rms_before"], step["validation_rms_after"]
    joints = [name for name in before if name != "overall"]
    increases_joint_error = any(_exceeds(after, before, joint, 1 + MAX_JOINT_INCREASE) for joint in joints)
    return ReportedStep(_key(step), alternative, _exceeds(after, before, "overall", 1.0), increases_joint_error)


def _exceeds(errors: Mapping[str, Any], limits: Mapping[str, Any], name: str, factor: float) -> bool:
    """True if an error is larger than a limit times a factor; False if either is unknown."""
    error, limit = errors.get(name), limits.get(name)
    return error is not None and limit is not None and error > factor * limit


def _key(step: Mapping[str, Any]) -> EffectKey:
    return step["effect"], step.get("joint") or step.get("link")


def _closed_share(before: Any, after: Any, floor: Any, names: Sequence[str]) -> float | None:
    """Share of the gap that was closed, of the RMS over names; None if the gap is less than 5 %."""
    a, b, c = (np.sqrt(np.mean([values[name] ** 2 for name in names])) for values in (before, after, floor))
    return float((a - b) / (a - c)) if a - c > 0.05 * a else None


def run_case(case: Case, cache: Path, keep: Path) -> Outcome:
    """Make the logs of a case if they are not in the cache, and diagnose them."""
    try:
        files = write_case(case, cache / f"{case.name}_{case.seconds:g}")
    except RuntimeError as error:
        return _failed_outcome(case, f"failed: {error}", 0.0)
    command = [sys.executable, "-c", "from idtool.cli import main; main()", "diagnose", str(files.urdf)]
    command += [*map(str, files.logs), "--config", str(files.config), "--out", str(keep / case.name)]
    command += ["--inertia", case.inertia, "--json", "--quiet"]
    start, cpu_start = time.perf_counter(), _cpu_seconds_of_children()
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, env=os.environ, check=False)
    except subprocess.TimeoutExpired:
        return _failed_outcome(case, "timeout", TIMEOUT, _cpu_seconds_of_children() - cpu_start)
    seconds = time.perf_counter() - start
    cpu_seconds = _cpu_seconds_of_children() - cpu_start
    if process.returncode:
        message = (process.stderr.strip().splitlines() or ["no message"])[-1]
        return _failed_outcome(case, f"failed: {message}", seconds, cpu_seconds)
    return read_outcome(case, json.loads(process.stdout), seconds, cpu_seconds)


def _cpu_seconds_of_children() -> float:
    """CPU time of all child processes of this process that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _failed_outcome(case: Case, verdict: str, seconds: float, cpu_seconds: float = 0.0) -> Outcome:
    return Outcome(case, (), verdict, (None, None), (), seconds, cpu_seconds)


def count_text(hits: Sequence[bool]) -> str:
    """Number of hits and their share, in words."""
    return f"{sum(hits)}/{len(hits)}" + (f" = {100 * np.mean(hits):.0f} %" if hits else "")


def print_confusion(outcomes: Sequence[Outcome]) -> None:
    """Print the effects that were reported first, by hidden effect."""
    table: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        effect, location = outcome.truth[0] if outcome.truth else ("clean", None)
        if outcome.steps:
            first, first_location = outcome.steps[0].key
        else:
            first, first_location = "failed" if outcome.has_failed else "none", None
        is_elsewhere = first == effect and first_location != location
        table.setdefault(effect, Counter())[f"{first} elsewhere" if is_elsewhere else first] += 1
    print("\nhidden effect: how often which was named first")
    for effect in sorted(table):
        others = ", ".join(f"{name} {count}" for name, count in table[effect].most_common() if name != effect)
        print(f"  {effect:24} {table[effect][effect]:3} of {table[effect].total():3}   {others}")


def print_summary(kind: str, outcomes: Sequence[Outcome]) -> None:
    """Print the figures of a kind of cases."""
    print(f"\n{kind}: {len(outcomes)} cases")
    if kind == "clean":
        _print_clean(outcomes)
    else:
        _print_by_magnitude(kind, outcomes)
    if kind not in ("clean", "unknown"):
        _print_closed_gaps(outcomes)
    seconds = [outcome.seconds for outcome in outcomes]
    with_faults = sum(bool(outcome.faults) for outcome in outcomes)
    failed = sum(outcome.has_failed for outcome in outcomes)
    print(f"  data faults: {with_faults}; failed: {failed}")
    print(f"  time: median {np.median(seconds):.0f} s, longest {max(seconds):.0f} s")
    cpu_seconds = [outcome.cpu_seconds for outcome in outcomes]
    print(f"  CPU time: median {np.median(cpu_seconds):.0f} s, longest {max(cpu_seconds):.0f} s")


def print_properties(outcomes: Sequence[Outcome]) -> None:
    """Print how often a diagnosis did what none should do."""
    steps = [step for outcome in outcomes for step in outcome.steps]
    increasing = count_text([step.increases_error for step in steps])
    joint_increasing = count_text([step.increases_joint_error for step in steps])
    without_gap = [outcome for outcome in outcomes if outcome.verdict == "no_disagreement"]
    missed = count_text([outcome.has_missed_disagreement for outcome in without_gap])
    print(f"\nall kinds: {len(outcomes)} cases, {len(steps)} steps")
    print(f"  steps that increase the held-out error: {increasing}")
    print(f"  steps that increase that of a joint by more than {MAX_JOINT_INCREASE:.0%}: {joint_increasing}")
    print(f"  no_disagreement with a joint above {MAX_ERROR_OVER_FLOOR} times its noise floor: {missed}")


def _print_clean(outcomes: Sequence[Outcome]) -> None:
    diagnosed = [outcome for outcome in outcomes if not outcome.has_failed]
    invented = [bool(outcome.invented) for outcome in diagnosed]
    presliding = [bool(outcome.identified) for outcome in diagnosed if outcome.case.friction == "lugre"]
    unknown = [any(step.key[0] == "unknown" for step in outcome.steps) for outcome in diagnosed]
    without_gap = [outcome.verdict == "no_disagreement" for outcome in diagnosed]
    print(f"  something invented: {count_text(invented)}")
    print(f"  presliding of LuGre friction named: {count_text(presliding)}")
    print(f"  called unknown: {count_text(unknown)}")
    print(f"  no_disagreement: {count_text(without_gap)}")


def _print_by_magnitude(kind: str, outcomes: Sequence[Outcome]) -> None:
    groups = {"strong and ordinary": IDENTIFIABLE, **{magnitude: (magnitude,) for magnitude in MAGNITUDES}}
    for label, magnitudes in groups.items():
        group = []
        for outcome in outcomes:
            if {effect.magnitude for effect in outcome.case.hidden} <= set(magnitudes):
                group.append(outcome)
        if not group:
            continue
        if kind == "unknown":
            unknown = count_text([outcome.has_right_unknown for outcome in group])
            alone = count_text([outcome.has_right_unknown and not outcome.identified for outcome in group])
            print(f"  {label}: called unknown {unknown}, and nothing else named {alone}")
        else:
            exact = count_text([outcome.is_exact for outcome in group])
            pair = count_text([outcome.is_exact_with_pairs for outcome in group])
            first = count_text([outcome.has_right_first for outcome in group])
            among = count_text([outcome.has_all for outcome in group])
            print(f"  {label}: exact {exact}, or a pair {pair}; first {first}, among {among}")


def _print_closed_gaps(outcomes: Sequence[Outcome]) -> None:
    for k, label in enumerate(("overall", "at its joints")):
        closed = [outcome.closed_gap[k] for outcome in outcomes if outcome.closed_gap[k] is not None]
        if closed:
            lower_quartile, median = np.quantile(closed, (0.25, 0.5))
            print(f"  closed {label}: median {median:.2f}, a quarter below {lower_quartile:.2f}, of {len(closed)}")


def split_list(text: str) -> list[str]:
    """Items of a list with commas."""
    return [part for part in text.split(",") if part]


def select_cases(options: argparse.Namespace, kind: str) -> list[Case]:
    """The cases of a kind that the options select."""
    seeds = parse_numbers(options.seeds or DEFAULT_SEEDS.get(kind, SEEDS_OF_OTHERS))
    robots, magnitudes = split_list(options.robots), split_list(options.magnitudes)
    cases = list_cases(kind, robots, magnitudes, seeds, options.seconds, options.friction, options.noise)
    effects = set(split_list(options.effects))
    return [case for case in cases if not effects or effects & {effect.effect for effect in case.hidden}]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every kind of cases asked for."""
    parser = argparse.ArgumentParser(
        description="Benchmark of `idtool diagnose` on simulated robots with hidden effects."
    )
    parser.add_argument("--kind", default=",".join(KINDS), help="default: %(default)s")
    for name, default in (("robots", ",".join(ROBOTS)), ("effects", ""), ("magnitudes", ",".join(MAGNITUDES))):
        parser.add_argument(f"--{name}", default=default, help=f"default: {default or 'all'}")
    parser.add_argument("--seeds", help="such as 0,3-5; default: 0-2, of clean cases 0-15")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of the logs")
    parser.add_argument("--friction", choices=FRICTION_KINDS, help=FRICTION_HELP)
    parser.add_argument("--noise", choices=NOISE_KINDS, help=NOISE_HELP)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="folder in which logs are kept for another time")
    parser.add_argument("--keep", type=Path, help="folder for the diagnoses")
    parser.add_argument("--json", type=Path, help="file for the results")
    options = parser.parse_args(arguments)

    results: dict[str, list[Outcome]] = {}
    with tempfile.TemporaryDirectory() as scratch, Pool(options.jobs) as pool:
        cache, keep = options.cache or Path(scratch), options.keep or Path(scratch) / "out"
        for kind in split_list(options.kind):
            results[kind] = []
            for outcome in pool.imap_unordered(partial(run_case, cache=cache, keep=keep), select_cases(options, kind)):
                results[kind].append(outcome)
                print(outcome.line(), flush=True)
    for kind, outcomes in results.items():
        if outcomes:
            print_summary(kind, outcomes)
    print_properties([outcome for outcomes in results.values() for outcome in outcomes])
    kinds_with_one_effect = ("single", "unknown", "clean", "variants")
    print_confusion([outcome for kind in kinds_with_one_effect for outcome in results.get(kind, [])])
    if options.json:
        content = {kind: [outcome.as_dict() for outcome in outcomes] for kind, outcomes in results.items()}
        options.json.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
