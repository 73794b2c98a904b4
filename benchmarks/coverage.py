"""Coverage of the truth by the 95 % intervals, over many simulated logs of the paper's leg.

Run ``python benchmarks/coverage.py [--set white|coloured|stribeck|coarse] [--logs N] [--cache DIR] [--json FILE]``.

Every log is a run of tests/helpers/leg_runs.py in MuJoCo: closed loop, quantised positions, noise on the torque, 10 s.
There are 20 conditions. Each has a leg of its own, every body 10 to 30 % from the prior, and a trajectory of its own,
half of them on the paper's shell and half random sines; every condition is run with several noises. Half of the torque
errors' variance is torque that acts on the leg, and so goes round the control loop. The sets of logs: ``white`` has the
sample logs' noise, 0.4 N·m. ``coloured`` has 0.1 N·m of autoregressive noise in addition, with a correlation time of
0.1 to 0.3 s. ``stribeck`` has friction that is larger at rest by 30 %, which the model lacks, so that only inertial
parameters are counted. ``coarse`` has encoders of 12 bits at the joint, in a loop that is soft enough for them.

Each log is fitted as by ``idtool fit``, with constraints and prior, and without held-out data. The intervals are those
of the fit, those of ordinary least squares with the number of independent samples in the band, and those of ordinary
least squares with every logged sample taken as independent.

The parameters are the base parameters beta = B theta. Each is named after one coefficient; ``+n`` behind the name means
that it is a combination with n others. Columns, over all logs:

- ``fit``, ``band``, ``iid``: share of the intervals that cover the truth [%].
- ``width``: half of the fit's interval, in typical sizes of the coefficient [%].
- ``se/sd``: standard error by the fit's interval, over the scatter of the estimates with the noise.
- ``bias``: mean error, in standard deviations of that scatter; ``syst``: rms of the error that all noises of a
  condition have in common, in the same unit. If both are zero, all errors are noise.
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

SETS = {"white": 200, "coloured": 60, "stribeck": 60, "coarse": 60}  # number of logs
INTERVALS = ("fit", "band", "iid")
CONDITIONS = 20
SECONDS = 10.0
ACTING_SHARE = 0.5  # of the torque errors' variance is a torque that acts on the leg
NORMAL_QUANTILE = 1.959964  # half the 95 % interval of the normal distribution


def least_squares_intervals(result: Fit, combinations: Array, every_sample: bool) -> Array:
    """95 % intervals of ordinary least squares, shape (k, p) to (k, 2).

    Parameters
    ----------
    result
        The fit, whose estimate is the intervals' middle.
    combinations
        Combinations of the coefficients.
    every_sample
        True to take every logged sample as independent; otherwise as many as there are in the band.
    """
    equation, noise = result.experiment.equation, result.estimate.noise
    stride = result.experiment.runs[0].signals.low_pass.stride
    whitened = []
    for factor, columns, sigma in zip(result.experiment.reduce(silent), equation.active(), noise, strict=True):
        samples_per_row = stride if every_sample else factor.independent / factor.rows
        rows = np.zeros((len(factor.R), combinations.shape[1]))
        rows[:, columns] = factor.R[:, :-1] * np.sqrt(samples_per_row) / sigma
        whitened.append(rows)
    W = np.concatenate(whitened)
    size = np.linalg.norm(W, axis=0)
    size[size == 0] = 1.0
    solution = np.linalg.lstsq((W / size).T, (combinations / size).T, rcond=1e-9)[0]
    half_width = NORMAL_QUANTILE * np.linalg.norm(solution, axis=0)
    return (combinations @ result.estimate.theta)[:, None] + half_width[:, None] * [-1, 1]


@dataclass(frozen=True)
class Case:
    """One log: the leg, its motion and its noise, by the set of logs and the number in it."""

    kind: str
    number: int

    @property
    def condition(self) -> int:
        """Number of the condition: of the leg and its motion."""
        return self.number % CONDITIONS

    @property
    def path(self) -> Path:
        """File name of the log."""
        return Path(f"{self.kind}_{self.number:03}.mcap")

    def truth(self) -> Truth:
        """The true leg."""
        truth = draw_truth(100 + self.condition)
        if self.kind != "stribeck":
            return truth
        return replace(truth, stribeck={name: 0.3 * friction.coulomb for name, friction in TRUTH.friction.items()})

    def motion(self) -> Motion:
        """The commanded motion."""
        if self.condition % 2:
            return fourier(self.condition, SECONDS)
        return shell(SECONDS, np.random.default_rng(self.condition).uniform(2.5, 60))

    def sensors(self) -> LegSensors:
        """The sensors."""
        if self.kind == "coarse":
            return LegSensors(
                position_step=encoder_step(12, on_motor=False), velocity_lag=5e-3, acting_share=ACTING_SHARE
            )
        if self.kind == "coloured":
            time = np.random.default_rng(self.number).uniform(0.1, 0.3)
            return LegSensors(coloured_noise=0.1, coloured_time=time, acting_share=ACTING_SHARE)
        return LegSensors(acting_share=ACTING_SHARE)

    def controller(self) -> Controller:
        """The controller."""
        return GENTLE if self.kind == "coarse" else Controller()

    def run(self) -> LegRun:
        """Simulate the log, with the true motion."""
        command = self.motion()
        return track_leg(
            command.q,
            command.v,
            1000 + self.number,
            acmd=command.a,
            truth=self.truth(),
            sensors=self.sensors(),
            controller=self.controller(),
        )


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


def cached_log(case: Case, folder: Path) -> Path:
    """Path of the case's log, which is simulated if it is not in the folder, with its true motion beside it."""
    path = folder / case.path
    if not path.exists():
        run = case.run()
        signals = {name: getattr(run.true, name) for name in ("q", "v", "a", "tau", "friction")}
        np.savez_compressed(path.with_suffix(".npz"), **signals)
        part = path.with_suffix(".part.mcap")
        write_log(part, run.log)
        part.rename(path)
    return path


def fit_log(path: Path, method: Method = "ls") -> Fit:
    """Fit a log as `idtool fit` does, without held-out data."""
    config = read_config(SAMPLES / "leg.yaml")
    return fit(prepare(read_robot(URDF), config, [path], holdout=0.0), silent, method=method)


def evaluate_case(case: Case, folder: Path, method: Method) -> tuple[Array, Array, Array]:
    """Fit a case's log and compare its intervals with the truth.

    Returns
    -------
    - the errors of the base parameters, shape (r,);
    - half the width of each kind of interval, shape (kinds, r);
    - the mask of the intervals that cover the truth, shape (kinds, r).
    """
    result = fit_log(cached_log(case, folder), method)
    B = structural_base_parameters(result.experiment.model, result.experiment.equation).B
    intervals = np.array(
        [
            result.uncertainty_analysis.interval(B),
            least_squares_intervals(result, B, every_sample=False),
            least_squares_intervals(result, B, every_sample=True),
        ]
    )
    lower, upper = intervals[..., 0], intervals[..., 1]
    truth = B @ true_theta(result.experiment, case.truth())
    error = B @ result.estimate.theta - truth
    return error, (upper - lower) / 2, (lower <= truth) & (truth <= upper)


@dataclass(frozen=True)
class ParameterInfo:
    """Names of the base parameters, the mask of inertial ones, and their typical sizes, shape (r,) each."""

    names: tuple[str, ...]
    inertial: NDArray[np.bool_]
    size: Array

    @staticmethod
    def of_leg(experiment: Experiment, base: BaseParameters) -> ParameterInfo:
        """Base parameters of an experiment with the leg."""
        theta = true_theta(experiment)
        other_counts = (base.B != 0).sum(axis=1) - 1
        names, inertial, sizes = [], [], []
        for k, count in zip(base.own, other_counts, strict=True):
            coefficient = experiment.equation.coefficients[k]
            names.append(f"{coefficient.owner} {coefficient.name}" + (f" +{count}" if count else ""))
            inertial.append(coefficient.effect == "rigid_body")
            sizes.append(coefficient.scale or theta[k])
        return ParameterInfo(tuple(names), np.array(inertial), np.array(sizes))


@dataclass(frozen=True)
class Coverage:
    """Coverage, shape (kinds, r), and the other columns of the table, shape (r,); see the top of this file."""

    covered: Array
    width: Array
    se_over_sd: Array
    bias: Array
    systematic: Array

    @staticmethod
    def from_logs(
        errors: Array, half_widths: Array, covered: Array, condition: NDArray[np.int64], size: Array
    ) -> Coverage:
        """Coverage over N logs.

        Parameters
        ----------
        errors
            Errors of the base parameters, shape (N, r).
        half_widths, covered
            Half the width of each interval, and the mask of those that cover the truth, shape (N, kinds, r).
        condition
            Condition of each log, shape (N,).
        size
            Typical sizes, shape (r,).
        """
        groups = [errors[condition == c] for c in np.unique(condition)]
        degrees_of_freedom = len(errors) - len(groups)
        squares = sum(np.square(group - group.mean(axis=0)).sum(axis=0) for group in groups)
        scatter = np.sqrt(squares / max(degrees_of_freedom, 1))
        means = np.array([group.mean(axis=0) for group in groups])
        noise_of_means = np.square(scatter) * np.mean([1 / len(group) for group in groups])
        of_fit = half_widths[:, 0]
        return Coverage(
            covered=covered.mean(axis=0),
            width=of_fit.mean(axis=0) / size,
            se_over_sd=np.sqrt(np.square(of_fit).mean(axis=0)) / NORMAL_QUANTILE / scatter,
            bias=errors.mean(axis=0) / scatter,
            systematic=np.sqrt(np.maximum(np.square(means).mean(axis=0) - noise_of_means, 0)) / scatter,
        )

    def print(self, parameters: ParameterInfo, included: NDArray[np.bool_]) -> None:
        """Print a row for each included parameter, and the summary."""
        print(f"{'parameter':24}" + "".join(f"{kind:>7}" for kind in INTERVALS) + "   width  se/sd   bias   syst")
        for k in np.flatnonzero(included):
            shares = "".join(f"{100 * x:7.1f}" for x in self.covered[:, k])
            rest = f"{100 * self.width[k]:7.1f}%{self.se_over_sd[k]:7.2f}{self.bias[k]:7.2f}{self.systematic[k]:7.2f}"
            print(f"{parameters.names[k]:24}{shares}{rest}")
        for kind, covered in zip(INTERVALS, self.covered, strict=True):
            lowest = int(np.argmin(np.where(included, covered, np.inf)))
            highest = int(np.argmax(np.where(included, covered, -np.inf)))
            print(
                f"{kind}: {100 * covered[included].mean():.1f} % overall, "
                f"lowest {100 * covered[lowest]:.1f} % ({parameters.names[lowest]}), "
                f"highest {100 * covered[highest]:.1f} % ({parameters.names[highest]})"
            )

    def as_dicts(self, parameters: ParameterInfo, included: NDArray[np.bool_]) -> list[dict[str, Any]]:
        """The table as plain data for JSON."""
        return [
            {
                "parameter": parameters.names[k],
                "coverage": dict(zip(INTERVALS, self.covered[:, k].tolist(), strict=True)),
                "width": float(self.width[k]),
                "se_over_sd": float(self.se_over_sd[k]),
                "bias_over_sd": float(self.bias[k]),
                "systematic_over_sd": float(self.systematic[k]),
            }
            for k in np.flatnonzero(included)
        ]


def run_set(kind: str, count: int, folder: Path, jobs: int, method: Method) -> list[dict[str, Any]]:
    """Evaluate a set of logs and print the table."""
    cases = [Case(kind, number) for number in range(count)]
    with Pool(jobs) as pool:
        results = pool.map(partial(evaluate_case, folder=folder, method=method), cases, chunksize=1)
    experiment = fit_log(cached_log(cases[0], folder)).experiment
    base = structural_base_parameters(experiment.model, experiment.equation)
    parameters = ParameterInfo.of_leg(experiment, base)
    included = parameters.inertial | (kind != "stribeck")
    condition = np.array([case.condition for case in cases])
    errors, half_widths, covered = (np.array(values) for values in zip(*results, strict=True))
    coverage = Coverage.from_logs(errors, half_widths, covered, condition, parameters.size)
    conditions, number = len(set(condition)), np.count_nonzero(included)
    print(f"\n{kind}: {count} logs in {conditions} conditions, {number} base parameters")
    coverage.print(parameters, included)
    return coverage.as_dicts(parameters, included)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every set asked for."""
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
        results = {}
        for kind in options.set or ["white", "coloured"]:
            results[kind] = run_set(kind, options.logs or SETS[kind], folder, options.jobs, options.method)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
