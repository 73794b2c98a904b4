"""Distance of fits from the truth for every kind and weight of the regularization, and the cost of choosing a weight.

Run ``python benchmarks/regularization.py [quadruped] [arm] [leg] [time] [--draws N] [--kinds …] [--weights …]``.
A weight is a number or ``auto``, and may be followed by other keys of ``regularization``: ``1e-4,units=si``.

``quadruped``, ``arm``: robots simulated in MuJoCo (simulated_robots.py). Every draw has a motion, a second motion for
validation, noise and a prior of its own. Its prior's masses have errors of 20 %, inertias of another 30 %, centres of
mass of a tenth of the link's length. ``leg``: the sample leg and its logs, with the designer's prior, with priors that
are 10, 30 and 100 % off (masses and second moments by factors of 1.1, 1.3 and 2 up or down, centres of mass by half as
many lengths), and with placeholders (mass 1 kg and a unit sphere's inertia, mass 1 kg and 1 kg m^2, everything 1e-6)
for the links, or for the rotors too. Columns, over the draws:

- ``all``, ``links``, ``rotors``, ``pullback``, ``affine``, ``mass``: mean distances from the truth (`Truth.distances`);
- ``total``, ``worst``, ``needle``: total mass over the true one, the largest factor by which a link is too heavy or
  too light, the smallest principal moment of a body over its true one; geometric means, of ``needle`` the median;
- ``clean``, ``noisy``: rms torque error on the second motion, with torque without and with noise [N m];
- ``torque``: rms of Y (theta - theta_true) over that of Y theta_true along the log [%];
- ``base``, ``max``: rms and largest error of the inertial base parameters in the true bodies' typical sizes [%];
- ``own``: median of their errors over their true values, where these are not small [%];
- ``farther``: share of the draws that end farther from the truth than the prior in ``all``, ``pullback``, ``affine``
  and ``mass`` [%];
- ``weight``: geometric mean of the weights as numbers;
- ``failed``: draws that were not solved; ``s``: median seconds of the identification without reading the log.

The row ``truth`` has the true parameters: its error in the clean torque comes from encoders and filters. The row
``none`` is the fit without a prior: its errors in ``torque`` and ``base`` come from the noise of the log.

``time``: fits of the leg and of the quadruped with each weight, compared with the first weight that is a number, in
turn. Times are processor seconds, which other programs on the machine disturb less.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from functools import cache, partial
from multiprocessing import Pool
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported: many threads are thirty times slower

import numpy as np
import yaml
from body_errors import DISTANCES, PriorErrors, Truth, ellipsoid_matrix, enclosing_ellipsoid, parameters, typical_sizes
from lxml import etree
from numpy.typing import NDArray
from simulated_robots import ROBOTS, Body, SimulatedRobot, TorqueNoise

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import leg_truth

import idtool
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, SolverError
from idtool.data.logs import JointLog, read_log
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress, Rows, Run, prepare
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.fit import fit
from idtool.estimation.identification import estimate_from_logs
from idtool.estimation.study.learning import held_out, rms
from idtool.estimation.uncertainty.base_parameters import structural_base_parameters
from idtool.robot.config import Regularization, parse_config
from idtool.robot.inertia import PARAMETER_NAMES, PI_SIZE
from idtool.robot.urdf.reading import Robot, parse_robot

Array = NDArray[np.float64]
Figures = dict[str, float]
Choice = tuple[str, str]  # kind of the regularization, and its weight, with further keys behind it

PARTS = ("quadruped", "arm", "leg", "time")
KINDS = ("euclidean", "entropic", "pullback")
WEIGHTS = ("auto", "1e-7", "1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "1e-1", "1")
COMPARED = ("euclidean", "pullback", "affine", "mass")  # with the prior's
IN_PERCENT = ("torque", "base", "max", "own")
ROBOT_COLUMNS = (*DISTANCES, "total", "worst", "needle", "clean", "noisy")
LEG_COLUMNS = (*IN_PERCENT, "euclidean", "pullback", "affine", "mass", "total", "worst", "needle", "noisy")
PRIOR_ERRORS = (0.1, 0.3, 1.0)
PLACEHOLDERS = {
    "unit sphere": Body(1.0, np.zeros(3), 0.4 * np.eye(3)),
    "identity": Body(1.0, np.zeros(3), np.eye(3)),
    "tiny": Body(1e-6, np.zeros(3), 1e-6 * np.eye(3)),
}
_MAX_MODEL_ERROR = 1e-3  # of the torque
_MIN_SIZE = 0.1  # of the typical size; relative errors of smaller base parameters are left out
LEG_LOGS = [leg_truth.SAMPLES / f"leg_{part}.mcap" for part in ("train", "validate")]


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


def is_number(weight: str) -> bool:
    """True for a weight that is a number."""
    try:
        float(weight.partition(",")[0])
    except ValueError:
        return False
    return True


def regularization_entry(choice: Choice) -> dict[str, Any]:
    """The entry ``regularization`` of a configuration."""
    kind, text = choice
    weight, *others = text.split(",")
    keys = dict(other.split("=", 1) for other in others)
    value = float(weight) if is_number(weight) else weight
    return {"kind": kind, "weight": value} | {key: yaml.safe_load(text) for key, text in keys.items()}


@cache
def regularization(choice: Choice) -> Regularization:
    """The regularization of a choice.

    Raises
    ------
    ConfigError
        If this version of idtool has no such kind or weight.
    """
    return parse_config({"regularization": regularization_entry(choice)}, "--weights").regularization


@dataclass(frozen=True)
class Outcome:
    """Figures of a model; none if the problem was not solved. ``number`` is the weight."""

    kind: str
    weight: str
    figures: Figures
    seconds: float = 0.0
    number: float | None = None


@dataclass(frozen=True, kw_only=True)
class ReducedExperiment(Experiment):
    """An experiment whose logs are reduced only once, however often it is fitted.

    Attributes
    ----------
    training
        The training data.
    validation
        The held-out data, by log.
    """

    training: tuple[Blocks, ...]
    validation: tuple[Reduction, ...]

    @staticmethod
    def reduced_from(e: Experiment) -> ReducedExperiment:
        """Reduce the logs of an experiment."""
        blocks = e.reduce_in_blocks(silent)
        validation = tuple(held_out(replace(e, runs=(run,)), silent) for run in e.runs if run.held_out)
        return ReducedExperiment(
            e.config, e.model, e.equation, e.equalities, e.runs, training=blocks, validation=validation
        )

    def blocks(self, rows: Callable[[Run], Rows], progress: Progress, stage: str = "reading") -> tuple[Blocks, ...]:
        """The training data."""
        return self.training

    def outcomes(self, choices: Iterable[Choice], true: Array, figures: Callable[[Array], Figures]) -> list[Outcome]:
        """Outcomes of the prior, the truth, and a fit with every regularization."""
        outcomes = [Outcome("prior", "", figures(self.equation.prior)), Outcome("truth", "", figures(true))]
        for choice in choices:
            config = self.config.model_copy(update={"regularization": regularization(choice)})
            started = time.process_time()
            try:
                result = estimate_from_logs(replace(self, config=config), "ls", silent)
            except SolverError:
                outcomes.append(Outcome(*choice, {}, time.process_time() - started))
            else:
                seconds = time.process_time() - started
                number = getattr(result, "regularization", config.regularization).weight
                outcomes.append(Outcome(*choice, figures(result.estimate.theta), seconds, number))
        return outcomes

    def bodies(self, theta: Array) -> Array:
        """Inertia parameters of the bodies, shape (bodies, 10)."""
        return theta[: PI_SIZE * len(self.model.bodies)].reshape(-1, PI_SIZE)

    def validation_errors(self, theta: Array) -> list[float]:
        """RMS torque error over all joints on every validation log."""
        active = self.equation.active()
        return [float(rms(data, active, theta)[-1]) for data in self.validation]

    def truth(self, bodies: Mapping[str, Body]) -> Truth:
        """The true bodies in the order of the model."""
        ordered = {body.name: bodies[body.name] for body in self.model.bodies}
        is_link = np.array([body.kind == "link" for body in self.model.bodies])
        return Truth(ordered, is_link)


@dataclass(frozen=True)
class RobotSetup:
    """A robot, its logs and the errors of its priors, the same for all draws.

    Attributes
    ----------
    robot
        The robot.
    seconds
        Length of each log.
    noise
        Noise on the torque.
    link_errors, rotor_errors
        Errors of the priors.
    has_ellipsoids
        True if the configuration has ellipsoids that enclose the true bodies.
    """

    robot: SimulatedRobot
    seconds: float
    noise: TorqueNoise
    link_errors: PriorErrors
    rotor_errors: PriorErrors
    has_ellipsoids: bool

    def prior(self, rng: np.random.Generator) -> dict[str, Body]:
        """Draw a prior of links and geared rotors."""
        prior = {}
        for name, body in self.robot.bodies.items():
            if name in self.robot.links:
                Q = ellipsoid_matrix(enclosing_ellipsoid(body)) if self.has_ellipsoids else None
                prior[name] = self.link_errors.link(rng, body, Q)
            else:
                prior[name] = self.rotor_errors.rotor(rng, body)
        return prior

    def config(self, prior: Mapping[str, Body]) -> dict[str, Any]:
        """The configuration with a prior's rotors, as plain data."""
        config = self.robot.config(prior)
        if self.has_ellipsoids:
            bounds = {name: enclosing_ellipsoid(body) for name, body in self.robot.bodies.items()}
            config["bounding_ellipsoids"] = {name: [bounds[name]] for name in self.robot.links}
            for name, entry in config.get("rotors", {}).items():
                entry["bounding_ellipsoid"] = bounds[name]
        return config

    def experiment(self, draw: int) -> ReducedExperiment:
        """Experiment with a training log with noise, and a validation log without and with noise."""
        robot, rng = self.robot, np.random.default_rng([draw, 17])
        prior = self.prior(rng)
        train = robot.run(2 * draw, self.seconds)
        validation = robot.run(2 * draw + 1, self.seconds)
        runs = {
            "train": train.with_noise(self.noise, rng),
            "clean": validation,
            "noisy": validation.with_noise(self.noise, rng),
        }
        logs = {name: run.log(f"{robot.name}_{draw}_{name}.csv", robot.joints) for name, run in runs.items()}
        urdf = parse_robot(Path(f"{robot.name}.urdf"), robot.urdf(prior).encode())
        config = parse_config(self.config(prior), robot.name)
        return ReducedExperiment.reduced_from(prepare(urdf, config, [logs["train"]], [logs["clean"], logs["noisy"]]))

    def theta(self, experiment: Experiment) -> Array:
        """The true coefficients, shape (p,)."""
        values = dict(self.robot.joint_terms)
        for name, pi in zip(self.robot.bodies, parameters(self.robot.bodies), strict=True):
            values |= {(name, entry): float(x) for entry, x in zip(PARAMETER_NAMES, pi, strict=True)}
        return np.array([values[c.owner, c.name] for c in experiment.equation.coefficients])


def check_truth(setup: RobotSetup) -> None:
    """Check that the true parameters are those of the simulation, frames, rotors and friction included.

    Raises
    ------
    RuntimeError
        If they leave more than 1e-3 of a torque without noise and stiction.
    """
    smooth = replace(setup, robot=setup.robot.without_stiction(), seconds=4.0, noise=TorqueNoise(white=0.0))
    experiment = smooth.experiment(0)
    theta = smooth.theta(experiment)
    error = experiment.validation_errors(theta)[0] / experiment.validation_errors(np.zeros_like(theta))[0]
    print(f"{setup.robot.name}: the true parameters leave {error:.1e} of a torque without noise and stiction")
    if error > _MAX_MODEL_ERROR:
        raise RuntimeError(f"{setup.robot.name}: the truth is not what was simulated")


def draw_robot(draw: int, setup: RobotSetup, choices: Sequence[Choice]) -> list[Outcome]:
    """Outcomes of every regularization on one draw."""
    experiment = setup.experiment(draw)
    truth = experiment.truth(setup.robot.bodies)

    def figures(theta: Array) -> Figures:
        clean, noisy = experiment.validation_errors(theta)
        return truth.distances(experiment.bodies(theta)) | {"clean": clean, "noisy": noisy}

    return experiment.outcomes(choices, setup.theta(experiment), figures)


@dataclass(frozen=True)
class LegPrior:
    """A prior of the sample leg: links and rotors."""

    name: str
    bodies: Mapping[str, Body]

    def experiment(self) -> ReducedExperiment:
        """Experiment with the sample logs."""
        rotors = {}
        for name, entry in leg_truth.CONFIG["rotors"].items():
            rotors[name] = entry | {"inertial": self.bodies[name].to_config()}
        config = parse_config(leg_truth.CONFIG | {"rotors": rotors}, "leg.yaml")
        train, validation = leg_logs()
        return ReducedExperiment.reduced_from(prepare(self.robot(), config, [train], [validation]))

    def robot(self) -> Robot:
        """The leg's URDF with these links."""
        tree = etree.parse(leg_truth.URDF)
        for link in tree.iterfind("link"):
            inertial = link.find("inertial")
            if inertial is not None:
                write_inertial(inertial, self.bodies[str(link.get("name"))])
        return parse_robot(leg_truth.URDF, etree.tostring(tree))


@cache
def leg_logs() -> list[JointLog]:
    """The training log and the validation log."""
    return [read_log(path) for path in LEG_LOGS]


def write_inertial(inertial: Any, body: Body) -> None:
    """Replace the inertial of a link in a URDF."""
    inertial.find("origin").attrib.update({"xyz": " ".join(map(repr, body.com.tolist())), "rpy": "0 0 0"})
    inertial.find("mass").set("value", repr(float(body.mass)))
    for i, j in zip(*np.triu_indices(3), strict=True):
        inertial.find("inertia").set(f"i{'xyz'[i]}{'xyz'[j]}", repr(float(body.inertia[i, j])))


def leg_priors(draws: int) -> dict[str, list[LegPrior]]:
    """Priors by name: the designer's, wrong ones of every size, ``draws`` each, and placeholders."""
    bounds = {name: ellipsoid_matrix(entry[0]) for name, entry in leg_truth.CONFIG["bounding_ellipsoids"].items()}
    designer = leg_truth.prior_truth().bodies
    priors = {"designer's": [LegPrior("designer's", designer)]}
    for level in PRIOR_ERRORS:
        size = float(np.log1p(level))
        errors = PriorErrors(mass=size, com=level / 2, inertia=size, exact=True)
        name = f"{100 * level:.0f} % off"
        for draw in range(draws):
            rng = np.random.default_rng([draw, round(100 * level)])
            bodies = {}
            for body_name, body in leg_truth.TRUTH.bodies.items():
                if body_name in bounds:
                    bodies[body_name] = errors.link(rng, body, bounds[body_name])
                else:
                    bodies[body_name] = errors.rotor(rng, body)
            priors.setdefault(name, []).append(LegPrior(name, bodies))
    for name, placeholder in PLACEHOLDERS.items():
        links_only = {other: placeholder if other in bounds else body for other, body in designer.items()}
        priors[name] = [LegPrior(name, links_only)]
        with_rotors = f"{name}, rotors too"
        priors[with_rotors] = [LegPrior(with_rotors, dict.fromkeys(designer, placeholder))]
    return priors


def draw_leg(prior: LegPrior, choices: Sequence[Choice]) -> list[Outcome]:
    """Outcomes of every regularization with one prior of the leg."""
    experiment = prior.experiment()
    truth = experiment.truth(leg_truth.TRUTH.bodies)
    true_theta = leg_truth.true_theta(experiment)
    base_parameters = structural_base_parameters(experiment.model, experiment.equation)
    inertial = base_parameters.own < PI_SIZE * len(truth.bodies)
    B = base_parameters.B[inertial]
    coefficient_sizes = np.zeros(len(true_theta))
    coefficient_sizes[: PI_SIZE * len(truth.bodies)] = typical_sizes(truth.bodies).ravel()
    size = np.sqrt(np.square(B * coefficient_sizes).sum(axis=1))
    true_values = np.abs(B @ true_theta)
    is_large = true_values > _MIN_SIZE * size
    data = merge_reductions([log.total for log in experiment.training])
    active = experiment.equation.active()

    def torque_norm(theta: Array) -> float:
        torques = [factor.R[:, :-1] @ theta[columns] for factor, columns in zip(data, active, strict=True)]
        return float(np.linalg.norm(np.concatenate(torques)))

    def figures(theta: Array) -> Figures:
        errors = np.abs(B @ (theta - true_theta))
        return truth.distances(experiment.bodies(theta)) | {
            "torque": torque_norm(theta - true_theta) / torque_norm(true_theta),
            "base": float(np.sqrt(np.mean(np.square(errors / size)))),
            "max": float((errors / size).max()),
            "own": float(np.median(errors[is_large] / true_values[is_large])),
            "noisy": experiment.validation_errors(theta)[0],
        }

    return experiment.outcomes([("none", "0"), *choices], true_theta, figures)


def rms_of(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def geometric_mean(values: Array) -> float:
    """Geometric mean of positive numbers."""
    return float(np.exp(np.mean(np.log(values))))


AVERAGES: Mapping[str, Callable[[Array], Any]] = {
    "total": geometric_mean,
    "worst": geometric_mean,
    "needle": np.median,
    "clean": rms_of,
    "noisy": rms_of,
}


def table_rows(draws: Sequence[Sequence[Outcome]]) -> list[dict[str, Any]]:
    """Averages over the draws, one row per model; without figures if no draw was solved."""
    priors = [outcomes[0].figures for outcomes in draws]
    rows = []
    for outcomes in zip(*draws, strict=True):
        solved = [(outcome.figures, prior) for outcome, prior in zip(outcomes, priors, strict=True) if outcome.figures]
        numbers = [outcome.number for outcome in outcomes if outcome.number]
        row: dict[str, Any] = {
            "kind": outcomes[0].kind,
            "weight": outcomes[0].weight,
            "failed": len(outcomes) - len(solved),
            "seconds": float(np.median([outcome.seconds for outcome in outcomes])),
            "number": geometric_mean(np.array(numbers)) if numbers else None,
        }
        if solved:
            for name in solved[0][0]:
                average = AVERAGES.get(name, np.mean)
                row[name] = float(average(np.array([figures[name] for figures, _ in solved])))
            row["farther"] = {}
            for name in COMPARED:
                row["farther"][name] = float(np.mean([figures[name] > prior[name] for figures, prior in solved]))
        rows.append(row)
    return rows


def print_rows(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> None:
    """Print the table."""
    heads = ["all" if name == "euclidean" else name for name in columns]
    head = "".join(f"{name:>10}" for name in heads)
    width = max(len(row["weight"]) for row in rows)
    print(f"{'':10}{'':{width}} {head}{'farther [%]':>21}{'weight':>10}{'failed':>8}{'s':>6}")
    for row in rows:
        line = f"{row['kind']:10}{row['weight']:>{width}} "
        if "farther" in row:
            values = [(100 if name in IN_PERCENT else 1) * row[name] for name in columns]
            line += "".join(f"{value:10.3g}" for value in values) + " "
            line += "".join(f"{100 * row['farther'][name]:5.0f}" for name in COMPARED)
        else:
            line += " " * (10 * len(columns) + 21)
        number = "" if row["number"] is None else f"{row['number']:.1e}"
        print(f"{line}{number:>10}{row['failed']:8}{row['seconds']:6.2f}")


def print_best(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the best fixed weights, and the distances of chosen weights over those of the best and of the prior."""
    solved = [row for row in rows if row["weight"] and row["kind"] != "none" and not row["failed"]]
    fixed = [row for row in solved if is_number(row["weight"])]
    chosen = [row for row in solved if not is_number(row["weight"])]
    print("best fixed weight with hindsight" + ("; chosen over it, the best of its kind, the prior" if chosen else ""))
    for name in DISTANCES:
        if not fixed or np.isnan(fixed[0][name]):
            continue
        best = min(fixed, key=lambda row: row[name])
        line = f"  {name:10}{best[name]:8.4f}  {best['kind']} {best['weight']}"
        for row in chosen:
            best_of_kind = min(other[name] for other in fixed if other["kind"] == row["kind"])
            references = (best[name], best_of_kind, rows[0][name])
            ratios = ", ".join(f"{row[name] / reference:.2f}" for reference in references)
            line += f"; {row['kind']} {row['weight']} {ratios}"
        print(line)


def fit_timer(experiment: ReducedExperiment) -> Callable[[Choice], Figures]:
    """Function that measures a fit, its identification, and that without reading the log [processor seconds]."""
    unreduced = Experiment(*(getattr(experiment, field.name) for field in fields(Experiment)))

    def seconds(choice: Choice) -> Figures:
        config = experiment.config.model_copy(update={"regularization": regularization(choice)})
        jobs = {
            "fit": lambda: fit(replace(unreduced, config=config), silent),
            "its identification": lambda: estimate_from_logs(replace(unreduced, config=config), "ls", silent),
            "without reading": lambda: estimate_from_logs(replace(experiment, config=config), "ls", silent),
        }
        return {name: processor_seconds(job) for name, job in jobs.items()}

    return seconds


def quick_fit_seconds(choice: Choice) -> Figures:
    """Processor time of a fit of the leg with the public Python API [s]."""
    config = leg_truth.CONFIG | {"regularization": regularization_entry(choice)}
    job = partial(idtool.fit, idtool.Model(leg_truth.URDF, config), LEG_LOGS[0], quick=True)
    return {"idtool.fit(quick=True)": processor_seconds(job)}


def processor_seconds(job: Callable[[], object]) -> float:
    """Processor time of a job [s]."""
    started = time.process_time()
    job()
    return time.process_time() - started


def print_times(choices: Sequence[Choice], repetitions: int, quadruped: RobotSetup) -> list[dict[str, Any]]:
    """Time fits in turn, and print the times and their ratios to those of the first choice."""
    leg = leg_priors(0)["designer's"][0].experiment()
    timers: dict[str, Callable[[Choice], Figures]] = {
        "leg": lambda choice: quick_fit_seconds(choice) | fit_timer(leg)(choice),
        "quadruped": fit_timer(quadruped.experiment(0)),
    }
    rows = []
    for robot, timer in timers.items():
        timer(choices[0])  # imports and caches
        turns = [[timer(choice) for choice in choices] for _ in range(repetitions)]
        for name in turns[0][0]:
            times = np.array([[seconds[name] for seconds in turn] for turn in turns])
            least, median = times.min(axis=0), np.median(times, axis=0)
            for k, (kind, weight) in enumerate(choices):
                row = {"what": f"{robot}: {name}", "kind": kind, "weight": weight}
                row |= {"least": least[k], "median": median[k]}
                rows.append(row | {"least_ratio": least[k] / least[0], "median_ratio": median[k] / median[0]})
    print(f"\n{'times over':10} {repetitions:2} turns{'':31}{'least s':>10}{'median s':>10}{'ratios of both':>16}")
    for row in rows:
        name = f"{row['what']}, {row['kind']} {row['weight']}"
        times = f"{row['least']:10.3f}{row['median']:10.3f}{row['least_ratio']:8.2f}{row['median_ratio']:8.2f}"
        print(f"{name:50}{times}")
    return rows


def run_draws(pool: Any, job: Callable[[Any], list[Outcome]], draws: Sequence[Any], name: str) -> list[list[Outcome]]:
    """Results of a job for all draws; the progress goes to standard error."""
    results = []
    for outcomes in pool.imap(job, draws):
        results.append(outcomes)
        print(f"\r{name}: {len(results)} of {len(draws)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return results


def known_choices(kinds: Sequence[str], weights: Sequence[str]) -> list[Choice]:
    """Choices that this version of idtool knows; the others are named on standard error."""
    choices = []
    for kind in kinds:
        for weight in weights:
            try:
                regularization((kind, weight))
                choices.append((kind, weight))
            except ConfigError as error:
                print(f"left out: {kind} {weight}: {error}", file=sys.stderr)
    return choices


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the parts asked for."""
    parser = argparse.ArgumentParser(description="Kinds and weights of the regularization against the truth.")
    parser.add_argument("parts", nargs="*", metavar="part", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--draws", type=int, default=200, help="of a robot; default: %(default)s")
    parser.add_argument("--leg-draws", type=int, default=10, help="of the leg's prior a level; default: %(default)s")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--weights", nargs="+", default=WEIGHTS, help="default: %(default)s")
    parser.add_argument("--seconds", type=float, default=20.0, help="of a robot's log; default: %(default)s")
    parser.add_argument("--noise", type=float, default=0.02, help="white, of the torque's rms; default: %(default)s")
    parser.add_argument("--coloured", type=float, default=0.0, help="noise of 0.2 s; default: %(default)s")
    parser.add_argument("--travel", type=float, default=1.0, help="of the joints that is used; default: %(default)s")
    parser.add_argument("--mass-error", type=float, default=0.2, help="of the links; default: %(default)s")
    parser.add_argument("--rotor-error", type=float, default=0.2, help="of the rotors' masses; default: %(default)s")
    parser.add_argument("--ellipsoids", action="store_true", help="tell idtool ellipsoids that hold the true bodies")
    parser.add_argument("--repetitions", type=int, default=7, help="of the times; default: %(default)s")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path, help="file for the results, of every draw too")
    options = parser.parse_args(arguments)
    parts = options.parts or PARTS
    if set(parts) - set(PARTS):
        parser.error(f"parts are {', '.join(PARTS)}")
    choices = known_choices(options.kinds, options.weights)
    if not choices:
        parser.error("none of these weights is known")
    setups = {}
    for name, robot in ROBOTS.items():
        setups[name] = RobotSetup(
            robot.with_travel(options.travel),
            options.seconds,
            TorqueNoise(options.noise, options.coloured),
            _prior_errors(options.mass_error),
            _prior_errors(options.rotor_error),
            options.ellipsoids,
        )
    results: dict[str, Any] = {"options": {name: str(value) for name, value in vars(options).items()}}
    with Pool(options.jobs) as pool:
        for name in ROBOTS:
            if name not in parts:
                continue
            check_truth(setups[name])
            job = partial(draw_robot, setup=setups[name], choices=choices)
            draws = run_draws(pool, job, range(options.draws), name)
            results[name] = report(f"{name}, {options.draws} draws", draws, ROBOT_COLUMNS)
        all_leg_priors = leg_priors(options.leg_draws) if "leg" in parts else {}
        for name, priors in all_leg_priors.items():
            draws = run_draws(pool, partial(draw_leg, choices=choices), priors, name)
            results[f"leg, {name}"] = report(f"leg, prior {name}, {len(priors)} draws", draws, LEG_COLUMNS)
    if "time" in parts:
        fixed = [choice for choice in choices if is_number(choice[1])][:1]
        others = [choice for choice in choices if choice[0] == options.kinds[0] and choice not in fixed]
        results["time"] = print_times([*fixed, *others], options.repetitions, setups["quadruped"])
    if options.json:
        options.json.write_text(json.dumps(results, indent=1))


def _prior_errors(size: float) -> PriorErrors:
    return PriorErrors(mass=size, com=size / 2, inertia=1.5 * size)


def report(title: str, draws: Sequence[Sequence[Outcome]], columns: Sequence[str]) -> dict[str, Any]:
    """Print a table, and return its content with that of every draw, for JSON."""
    rows = table_rows(draws)
    print(f"\n{title}")
    print_rows(rows, columns)
    print_best(rows)
    return {"rows": rows, "draws": [[asdict(outcome) for outcome in outcomes] for outcomes in draws]}


if __name__ == "__main__":
    main()
