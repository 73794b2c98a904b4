"""How often the 95 % intervals cover the truth, over many simulated logs of the paper's leg.

Run ``python benchmarks/coverage.py [--set white|coloured|stribeck|coarse] [--logs N] [--cache DIR] [--json FILE]``.

Every log is a run of tests/helpers/leg_runs.py in MuJoCo: closed loop, quantised positions, noise on the torque, 10 s.
There are 20 conditions, each with a leg of its own, every body 10 to 30 % from the prior, on a trajectory of its own,
half of them on the paper's shell and half random sines; every condition is run with several noises. Half of the torque
errors' variance is felt by the leg and goes round the loop. ``white`` has the sample logs' noise, 0.4 N·m; ``coloured``
0.1 N·m of autoregressive noise on top, of a correlation time of 0.1 to 0.3 s; ``stribeck`` friction that is larger at
rest by 30 %, which the model lacks, so that only inertia can be judged; ``coarse`` encoders of 12 bits at the joint, in
a loop that is soft enough for them.

Each log is fitted as ``idtool fit`` does, constraints and prior included, nothing held out. The intervals judged are
those of the fit, those of ordinary least squares with the band's share of independent samples, and those with every
logged sample taken as independent.

The parameters are the base parameters beta = B theta, called after one coefficient each: those without a ``+`` are
that coefficient, which the data determine alone, the others are it and so many others. Columns, all over the logs:

- ``fit``, ``band``, ``iid``: share of the intervals that cover the truth [%].
- ``width``: half of the fit's interval in typical sizes of the coefficient [%].
- ``se/sd``: standard error that the fit's interval stands for over the estimates' scatter among noises alone.
- ``bias``: mean error in standard deviations of that scatter; ``syst``: rms of what is the same for all noises of a
  condition, in the same. Both zero: only noise is left.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from leg_runs import (
    GENTLE,
    SAMPLES,
    TRUTH,
    URDF,
    Controller,
    LegRun,
    LegSensors,
    Motion,
    Truth,
    draw_truth,
    encoder_step,
    fourier,
    shell,
    track_leg,
    true_theta,
)

from idtool.data.logs import write_log
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.fit import Fit, fit
from idtool.estimation.identification import Method
from idtool.estimation.uncertainty.base_parameters import BaseParameters, structural_base_parameters
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

SETS = {"white": 200, "coloured": 60, "stribeck": 60, "coarse": 60}  # and how many logs
KINDS = ("fit", "band", "iid")
CONDITIONS = 20
SECONDS = 10.0
FELT = 0.5  # of the torque errors' variance is torque that the leg lacks, so that its motion answers to it
NORMAL = 1.959964  # half of the 95 % interval of the normal distribution


def intervals(found: Fit, rows: Array) -> Array:
    """The fit's 95 % intervals of combinations of the coefficients, shape (k, p) to (k, 2)."""
    return found.uncertainty_analysis.interval(rows)


def ordinary(found: Fit, rows: Array, every_sample: bool) -> Array:
    """The same of ordinary least squares, on so many independent samples as the band has, or as were logged."""
    equation, noise = found.experiment.equation, found.estimate.noise
    stride = found.experiment.runs[0].signals.low_pass.stride
    W = []
    for factor, columns, sigma in zip(found.experiment.reduce(silent), equation.active(), noise, strict=True):
        worth = stride if every_sample else factor.independent / factor.rows
        own = np.zeros((len(factor.R), rows.shape[1]))
        own[:, columns] = factor.R[:, :-1] * np.sqrt(worth) / sigma
        W.append(own)
    whole = np.concatenate(W)
    size = np.linalg.norm(whole, axis=0)
    size[size == 0] = 1.0
    half = NORMAL * np.linalg.norm(np.linalg.lstsq((whole / size).T, (rows / size).T, rcond=1e-9)[0], axis=0)
    return (rows @ found.estimate.theta)[:, None] + half[:, None] * [-1, 1]


@dataclass(frozen=True)
class Case:
    """One log: which leg, on which motion, with which noise."""

    kind: str
    number: int

    @property
    def condition(self) -> int:
        """Number of the leg and its motion."""
        return self.number % CONDITIONS

    @property
    def path(self) -> Path:
        """Name of the log."""
        return Path(f"{self.kind}_{self.number:03}.mcap")

    def truth(self) -> Truth:
        """The leg."""
        truth = draw_truth(100 + self.condition)
        if self.kind != "stribeck":
            return truth
        return replace(truth, stribeck={name: 0.3 * friction.coulomb for name, friction in TRUTH.friction.items()})

    def motion(self) -> Motion:
        """The command."""
        if self.condition % 2:
            return fourier(self.condition, SECONDS)
        return shell(SECONDS, np.random.default_rng(self.condition).uniform(2.5, 60))

    def sensors(self) -> LegSensors:
        """What reads it."""
        if self.kind == "coarse":
            return LegSensors(position_step=encoder_step(12, on_motor=False), velocity_lag=5e-3, felt=FELT)
        if self.kind == "coloured":
            time = np.random.default_rng(self.number).uniform(0.1, 0.3)
            return LegSensors(coloured_noise=0.1, coloured_time=time, felt=FELT)
        return LegSensors(felt=FELT)

    def controller(self) -> Controller:
        """What drives it."""
        return GENTLE if self.kind == "coarse" else Controller()

    def run(self) -> LegRun:
        """The log and the true motion."""
        command, seed = self.motion(), 1000 + self.number
        options = {"truth": self.truth(), "sensors": self.sensors(), "controller": self.controller()}
        return track_leg(command.q, command.v, seed, acmd=command.a, **options)


def silent(stage: str, share: float) -> None:
    """No progress to show."""


def log_of(case: Case, folder: Path) -> Path:
    """The case's log, made where it is not there yet, its true motion beside it."""
    path = folder / case.path
    if not path.exists():
        run = case.run()
        signals = {name: getattr(run.true, name) for name in ("q", "v", "a", "tau", "friction")}
        np.savez_compressed(path.with_suffix(".npz"), **signals)
        part = path.with_suffix(".part.mcap")
        write_log(part, run.log)
        part.rename(path)
    return path


def fitted(path: Path, method: Method = "ls") -> Fit:
    """As `idtool fit` does it, nothing held out."""
    config = read_config(SAMPLES / "leg.yaml")
    return fit(prepare(read_robot(URDF), config, [path], holdout=0.0), silent, method=method)


def judged(case: Case, folder: Path, method: Method) -> tuple[Array, Array, Array]:
    """Errors of the base parameters, (r,), and of each kind's intervals half the width and whether they cover."""
    found = fitted(log_of(case, folder), method)
    base = structural_base_parameters(found.experiment.model, found.experiment.equation)
    three = np.array([intervals(found, base.B), *(ordinary(found, base.B, every) for every in (False, True))])
    truth = base.B @ true_theta(found.experiment, case.truth())
    error = base.B @ found.estimate.theta - truth
    return error, (three[..., 1] - three[..., 0]) / 2, (three[..., 0] <= truth) & (truth <= three[..., 1])


@dataclass(frozen=True)
class Names:
    """What the base parameters are called, which are of inertia alone, and their typical sizes, (r,) each."""

    names: tuple[str, ...]
    inertial: NDArray[np.bool_]
    size: Array

    @staticmethod
    def of(experiment: Experiment, base: BaseParameters) -> Names:
        """Of an experiment with the leg."""
        coefficients, theta = experiment.equation.coefficients, true_theta(experiment)
        others = (base.B != 0).sum(axis=1) - 1
        own = [coefficients[k] for k in base.own]
        return Names(
            tuple(f"{c.owner} {c.name}" + (f" +{n}" if n else "") for c, n in zip(own, others, strict=True)),
            np.array([c.effect == "rigid_body" for c in own]),
            np.array([c.scale or theta[k] for c, k in zip(own, base.own, strict=True)]),
        )


@dataclass(frozen=True)
class Coverage:
    """What came out, per parameter (r,); ``covered`` per kind of interval (kinds, r)."""

    covered: Array
    width: Array
    ratio: Array
    bias: Array
    systematic: Array

    @staticmethod
    def of(errors: Array, halves: Array, covered: Array, condition: NDArray[np.int64], size: Array) -> Coverage:
        """Of N logs: errors (N, r), halves and covered (N, kinds, r)."""
        groups = [errors[condition == c] for c in np.unique(condition)]
        freedom = len(errors) - len(groups)
        within = np.sqrt(sum(np.square(g - g.mean(axis=0)).sum(axis=0) for g in groups) / max(freedom, 1))
        means = np.array([g.mean(axis=0) for g in groups])
        chance = np.square(within) * np.mean([1 / len(g) for g in groups])
        return Coverage(
            covered=covered.mean(axis=0),
            width=halves[:, 0].mean(axis=0) / size,
            ratio=np.sqrt(np.square(halves[:, 0]).mean(axis=0)) / NORMAL / within,
            bias=errors.mean(axis=0) / within,
            systematic=np.sqrt(np.maximum(np.square(means).mean(axis=0) - chance, 0)) / within,
        )

    def print(self, names: Names, kept: NDArray[np.bool_]) -> None:
        """A row a parameter, and the summary."""
        print(f"{'parameter':24}" + "".join(f"{kind:>7}" for kind in KINDS) + "   width  se/sd   bias   syst")
        for k in np.flatnonzero(kept):
            shares = "".join(f"{100 * x:7.1f}" for x in self.covered[:, k])
            rest = f"{100 * self.width[k]:7.1f}%{self.ratio[k]:7.2f}{self.bias[k]:7.2f}{self.systematic[k]:7.2f}"
            print(f"{names.names[k]:24}{shares}{rest}")
        for kind, covered in zip(KINDS, self.covered, strict=True):
            lowest, highest = (int(f(np.where(kept, covered, x))) for f, x in ((np.argmin, 2), (np.argmax, -1)))
            print(
                f"{kind}: {100 * covered[kept].mean():.1f} % overall, lowest {100 * covered[lowest]:.1f} % "
                f"({names.names[lowest]}), highest {100 * covered[highest]:.1f} % ({names.names[highest]})"
            )

    def data(self, names: Names, kept: NDArray[np.bool_]) -> list[dict[str, Any]]:
        """The same for JSON."""
        return [
            {
                "parameter": names.names[k],
                "coverage": dict(zip(KINDS, self.covered[:, k].tolist(), strict=True)),
                "width": float(self.width[k]),
                "se_over_sd": float(self.ratio[k]),
                "bias_over_sd": float(self.bias[k]),
                "systematic_over_sd": float(self.systematic[k]),
            }
            for k in np.flatnonzero(kept)
        ]


def run(kind: str, logs: int, folder: Path, jobs: int, method: Method) -> list[dict[str, Any]]:
    """Judge a set of logs and print the table."""
    cases = [Case(kind, number) for number in range(logs)]
    with Pool(jobs) as pool:
        results = pool.map(partial(judged, folder=folder, method=method), cases, chunksize=1)
    experiment = fitted(log_of(cases[0], folder)).experiment
    names = Names.of(experiment, structural_base_parameters(experiment.model, experiment.equation))
    kept = names.inertial | (kind != "stribeck")
    condition = np.array([case.condition for case in cases])
    errors, halves, covered = (np.array(x) for x in zip(*results, strict=True))
    coverage = Coverage.of(errors, halves, covered, condition, names.size)
    print(f"\n{kind}: {logs} logs in {len(set(condition))} conditions, {np.count_nonzero(kept)} base parameters")
    coverage.print(names, kept)
    return coverage.data(names, kept)


def main(arguments: Sequence[str] | None = None) -> None:
    """Every set asked for."""
    parser = argparse.ArgumentParser(description="Coverage of the 95 % intervals on simulated logs of the leg.")
    parser.add_argument("--set", choices=SETS, action="append", help="which logs; repeatable; default: white, coloured")
    parser.add_argument("--logs", type=int, help=f"how many of each; default: {SETS}")
    parser.add_argument("--cache", type=Path, help="folder in which logs are kept for another time")
    parser.add_argument("--json", type=Path, help="file for the results")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--method", choices=("ls", "iv"), default="ls", help="of the fit; the other intervals stay")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.cache or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        kinds = options.set or ["white", "coloured"]
        results = {kind: run(kind, options.logs or SETS[kind], folder, options.jobs, options.method) for kind in kinds}
    if options.json:
        options.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
