"""Distance of fits from the truth for every kind and weight of the regularization, and the cost of choosing a weight.

Run ``python benchmarks/regularization.py [quadruped] [arm] [leg] [time] [--draws N] [--kinds …] [--weights …]``.
A weight is passed on as it stands, ``auto`` as well as ``1e-4``, and other keys behind it: ``1e-4,units=si``.

``quadruped``, ``arm``: robots simulated in MuJoCo (simulated_robots.py). Every draw has a motion, a second motion to
validate on, noise and a prior of its own: masses are off by 20 %, inertias by 30 % beyond that, centres of mass by a
tenth of the link's length. ``leg``: the sample leg and its logs, from the designer's prior, from priors that are 10, 30
and 100 % off (masses and second moments by factors of 1.1, 1.3 and 2 up or down, centres of mass by half as many
lengths), and from placeholders: mass 1 kg and a unit sphere's inertia, mass 1 kg and 1 kg m^2, everything 1e-6; of the
links, or of the rotors too. Columns, over the draws:

- ``all``, ``links``, ``rotors``, ``pullback``, ``affine``, ``mass``: mean distances from the truth (`Truth.figures`);
- ``total``, ``worst``, ``needle``: total mass over the true one, the largest factor by which a link is too heavy or
  too light, the least principal moment of a body over its true one; geometric means, of ``needle`` the median;
- ``clean``, ``noisy``: rms torque error on the second motion, the torque without and with noise [N m];
- ``torque``: rms of Y (theta - theta_true) over that of Y theta_true along the log [%];
- ``base``, ``max``: rms and largest error of the inertial base parameters in the true bodies' typical sizes [%];
- ``own``: median of their errors over their true values, where these are not small [%];
- ``farther``: share of the draws that end farther from the truth than the prior in ``all``, ``pullback``, ``affine``
  and ``mass`` [%];
- ``weight``: geometric mean of the weights as numbers;
- ``failed``: draws that were not solved; ``s``: median seconds of the identification without reading the log.

The row ``truth`` has the true parameters: what it leaves of the clean torque is what encoders and filters spoil. The
row ``none`` is the fit without a prior: what it has of ``torque`` and ``base`` is the noise of the log.

``time``: fits of the leg and of the quadruped with each weight against the first that is a number, by turns; seconds of
the processor, which other programs on the machine disturb less.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, partial
from multiprocessing import Pool
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is there: many threads take thirty times as long

import numpy as np
import yaml
from body_errors import DISTANCES, PriorErrors, Truth, ellipsoid_matrix, enclosing_ellipsoid, parameters, sizes
from lxml import etree
from numpy.typing import NDArray
from simulated_robots import ROBOTS, Body, Sensors, SimulatedRobot

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import leg_truth

import idtool
from idtool.common.exceptions import ConfigError, SolverError
from idtool.data.logs import Log, read_log
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Rows, Run, prepare
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
Choice = tuple[str, str]  # kind, and weight with other keys behind it

PARTS = ("quadruped", "arm", "leg", "time")
KINDS = ("euclidean", "entropic", "pullback")
WEIGHTS = ("auto", "1e-7", "1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "1e-1", "1")
COMPARED = ("euclidean", "pullback", "affine", "mass")  # with the prior's
PER_CENT = ("torque", "base", "max", "own")
ROBOT_COLUMNS = (*DISTANCES, "total", "worst", "needle", "clean", "noisy")
LEG_COLUMNS = (*PER_CENT, "euclidean", "pullback", "affine", "mass", "total", "worst", "needle", "noisy")
LEVELS = (0.1, 0.3, 1.0)
PLACEHOLDERS = {
    "unit sphere": Body(1.0, np.zeros(3), 0.4 * np.eye(3)),
    "identity": Body(1.0, np.zeros(3), np.eye(3)),
    "tiny": Body(1e-6, np.zeros(3), 1e-6 * np.eye(3)),
}
_EXACT = 1e-3  # of the torque
_SMALL = 0.1  # of the typical size: a base parameter whose relative error says nothing
LEG_LOGS = [leg_truth.SAMPLES / f"leg_{part}.mcap" for part in ("train", "validate")]


def silent(stage: str, share: float) -> None:
    """No progress to show."""


def is_number(weight: str) -> bool:
    """True for a weight that is no word."""
    try:
        float(weight.partition(",")[0])
    except ValueError:
        return False
    return True


def regularization_entry(choice: Choice) -> dict[str, Any]:
    """A configuration's ``regularization``."""
    kind, text = choice
    weight, *others = text.split(",")
    keys = dict(other.split("=", 1) for other in others)
    value = float(weight) if is_number(weight) else weight
    return {"kind": kind, "weight": value} | {key: yaml.safe_load(given) for key, given in keys.items()}


@cache
def regularization(choice: Choice) -> Regularization:
    """As a configuration has it.

    Raises
    ------
    ConfigError
        If this version has no such kind or weight.
    """
    return parse_config({"regularization": regularization_entry(choice)}, "--weights").regularization


@dataclass(frozen=True)
class Outcome:
    """Figures of a model; none where the problem was not solved."""

    kind: str
    weight: str
    figures: Figures
    seconds: float = 0.0
    number: float | None = None  # the weight


@dataclass(frozen=True)
class ReducedExperiment(Experiment):
    """An experiment whose logs are read once, however often it is fitted.

    Attributes
    ----------
    reduced
        The training data.
    validation
        What is held out of every log for validation.
    """

    reduced: tuple[Blocks, ...]
    validation: tuple[Reduction, ...]

    @staticmethod
    def of(e: Experiment) -> ReducedExperiment:
        """Read the logs."""
        blocks = e.blocks(lambda run: e.rows(run, silent))
        kept = tuple(held_out(replace(e, runs=(run,)), silent) for run in e.runs if run.held_out)
        return ReducedExperiment(e.config, e.model, e.equation, e.equalities, e.runs, blocks, kept)

    def blocks(self, rows: Callable[[Run], Rows]) -> tuple[Blocks, ...]:
        """The training data."""
        return self.reduced

    def outcomes(self, choices: Iterable[Choice], true: Array, figures: Callable[[Array], Figures]) -> list[Outcome]:
        """The prior, the truth, and what is identified with every regularization."""
        found = [Outcome("prior", "", figures(self.equation.prior)), Outcome("truth", "", figures(true))]
        for choice in choices:
            config = self.config.model_copy(update={"regularization": regularization(choice)})
            started = time.process_time()
            try:
                result = estimate_from_logs(replace(self, config=config), "ls", silent)
            except SolverError:
                found.append(Outcome(*choice, {}, time.process_time() - started))
            else:
                seconds = time.process_time() - started
                number = getattr(result, "regularization", config.regularization).weight
                found.append(Outcome(*choice, figures(result.estimate.theta), seconds, number))
        return found

    def bodies(self, theta: Array) -> Array:
        """Inertia parameters of the bodies, (bodies, 10)."""
        return theta[: PI_SIZE * len(self.model.bodies)].reshape(-1, PI_SIZE)

    def errors(self, theta: Array) -> list[float]:
        """Rms torque error over all joints on every log for validation."""
        active = self.equation.active()
        return [float(rms(data, active, theta)[-1]) for data in self.validation]

    def truth(self, bodies: Mapping[str, Body]) -> Truth:
        """The true bodies in the order of the model."""
        own = self.model.bodies
        return Truth({body.name: bodies[body.name] for body in own}, np.array([body.kind == "link" for body in own]))


@dataclass(frozen=True)
class Setup:
    """A robot, its logs and the errors of its priors, the same for all draws.

    Attributes
    ----------
    robot
        The robot.
    seconds
        Length of each log.
    sensors
        Noise of the torque.
    links, rotors
        Errors of their priors.
    ellipsoids
        Whether idtool is told ellipsoids that enclose the true bodies.
    """

    robot: SimulatedRobot
    seconds: float
    sensors: Sensors
    links: PriorErrors
    rotors: PriorErrors
    ellipsoids: bool

    def prior(self, rng: np.random.Generator) -> dict[str, Body]:
        """A prior of links and geared rotors."""
        prior = {}
        for name, body in self.robot.bodies.items():
            if name in self.robot.links:
                Q = ellipsoid_matrix(enclosing_ellipsoid(body)) if self.ellipsoids else None
                prior[name] = self.links.link(rng, body, Q)
            else:
                prior[name] = self.rotors.rotor(rng, body)
        return prior

    def config(self, prior: Mapping[str, Body]) -> dict[str, Any]:
        """The configuration with a prior's rotors, as plain data."""
        config = self.robot.config(prior)
        if self.ellipsoids:
            bounds = {name: enclosing_ellipsoid(body) for name, body in self.robot.bodies.items()}
            config["bounding_ellipsoids"] = {name: [bounds[name]] for name in self.robot.links}
            for name, entry in config.get("rotors", {}).items():
                entry["bounding_ellipsoid"] = bounds[name]
        return config

    def experiment(self, draw: int) -> ReducedExperiment:
        """A log with noise, and one for validation without and with noise."""
        robot, rng = self.robot, np.random.default_rng([draw, 17])
        prior = self.prior(rng)
        train, other = (robot.run(2 * draw + k, self.seconds) for k in range(2))
        runs = {"train": train.noisy(self.sensors, rng), "clean": other, "noisy": other.noisy(self.sensors, rng)}
        logs = {name: run.log(f"{robot.name}_{draw}_{name}.csv", robot.joints) for name, run in runs.items()}
        urdf = parse_robot(Path(f"{robot.name}.urdf"), robot.urdf(prior).encode())
        config = parse_config(self.config(prior), robot.name)
        return ReducedExperiment.of(prepare(urdf, config, [logs["train"]], [logs["clean"], logs["noisy"]]))

    def theta(self, experiment: Experiment) -> Array:
        """The true coefficients, (p,)."""
        values = dict(self.robot.joint_terms)
        for name, pi in zip(self.robot.bodies, parameters(self.robot.bodies), strict=True):
            values |= {(name, entry): float(x) for entry, x in zip(PARAMETER_NAMES, pi, strict=True)}
        return np.array([values[c.owner, c.name] for c in experiment.equation.coefficients])


def check(setup: Setup) -> None:
    """Make sure that the true parameters are those that MuJoCo moves, frames, rotors and friction included.

    Raises
    ------
    RuntimeError
        If they leave more than 1e-3 of a torque without noise and stiction.
    """
    smooth = replace(setup, robot=setup.robot.without_stiction(), seconds=4.0, sensors=Sensors(noise=0.0))
    experiment = smooth.experiment(0)
    theta = smooth.theta(experiment)
    left = experiment.errors(theta)[0] / experiment.errors(np.zeros_like(theta))[0]
    print(f"{setup.robot.name}: the true parameters leave {left:.1e} of a torque without noise and stiction")
    if left > _EXACT:
        raise RuntimeError(f"{setup.robot.name}: the truth is not what was simulated")


def draw_robot(draw: int, setup: Setup, choices: Sequence[Choice]) -> list[Outcome]:
    """Every regularization on one draw."""
    experiment = setup.experiment(draw)
    truth = experiment.truth(setup.robot.bodies)

    def figures(theta: Array) -> Figures:
        clean, noisy = experiment.errors(theta)
        return truth.figures(experiment.bodies(theta)) | {"clean": clean, "noisy": noisy}

    return experiment.outcomes(choices, setup.theta(experiment), figures)


@dataclass(frozen=True)
class LegPrior:
    """A prior of the sample leg: links and rotors."""

    name: str
    bodies: Mapping[str, Body]

    def experiment(self) -> ReducedExperiment:
        """With the sample logs."""
        rotors = leg_truth.CONFIG["rotors"]
        own = {name: entry | {"inertial": self.bodies[name].to_config()} for name, entry in rotors.items()}
        config = parse_config(leg_truth.CONFIG | {"rotors": own}, "leg.yaml")
        train, validation = leg_logs()
        return ReducedExperiment.of(prepare(self.robot(), config, [train], [validation]))

    def robot(self) -> Robot:
        """The leg's URDF with these links."""
        tree = etree.parse(leg_truth.URDF)
        for link in tree.iterfind("link"):
            inertial = link.find("inertial")
            if inertial is not None:
                write_inertial(inertial, self.bodies[str(link.get("name"))])
        return parse_robot(leg_truth.URDF, etree.tostring(tree))


@cache
def leg_logs() -> list[Log]:
    """To fit to, and to validate on."""
    return [read_log(path) for path in LEG_LOGS]


def write_inertial(inertial: Any, body: Body) -> None:
    """Replace what a URDF says of a link."""
    inertial.find("origin").attrib.update({"xyz": " ".join(map(repr, body.com.tolist())), "rpy": "0 0 0"})
    inertial.find("mass").set("value", repr(float(body.mass)))
    for i, j in zip(*np.triu_indices(3), strict=True):
        inertial.find("inertia").set(f"i{'xyz'[i]}{'xyz'[j]}", repr(float(body.inertia[i, j])))


def leg_priors(draws: int) -> dict[str, list[LegPrior]]:
    """The designer's, wrong ones at every level, so many each, and placeholders."""
    bounds = {name: ellipsoid_matrix(entry[0]) for name, entry in leg_truth.CONFIG["bounding_ellipsoids"].items()}
    designer = leg_truth.prior_truth().bodies
    found = [LegPrior("designer's", designer)]
    for level in LEVELS:
        size = float(np.log1p(level))
        errors = PriorErrors(mass=size, com=level / 2, inertia=size, exact=True)
        for draw in range(draws):
            rng = np.random.default_rng([draw, round(100 * level)])
            bodies = {
                name: errors.link(rng, body, bounds[name]) if name in bounds else errors.rotor(rng, body)
                for name, body in leg_truth.TRUTH.bodies.items()
            }
            found.append(LegPrior(f"{100 * level:.0f} % off", bodies))
    for name, body in PLACEHOLDERS.items():
        links = {other: body if other in bounds else given for other, given in designer.items()}
        found.append(LegPrior(name, links))
        found.append(LegPrior(f"{name}, rotors too", dict.fromkeys(designer, body)))
    return {name: [prior for prior in found if prior.name == name] for name in dict.fromkeys(p.name for p in found)}


def draw_leg(prior: LegPrior, choices: Sequence[Choice]) -> list[Outcome]:
    """Every regularization from one prior."""
    experiment = prior.experiment()
    truth, true = experiment.truth(leg_truth.TRUTH.bodies), leg_truth.true_theta(experiment)
    combinations = structural_base_parameters(experiment.model, experiment.equation)
    base = combinations.B[combinations.own < PI_SIZE * len(truth.bodies)]
    typical = np.zeros(len(true))
    typical[: PI_SIZE * len(truth.bodies)] = sizes(truth.bodies).ravel()
    size, own = np.sqrt(np.square(base * typical).sum(axis=1)), np.abs(base @ true)
    large = own > _SMALL * size
    data = merge_reductions([log.total for log in experiment.reduced])
    active = experiment.equation.active()

    def torque(theta: Array) -> float:
        parts = [factor.R[:, :-1] @ theta[columns] for factor, columns in zip(data, active, strict=True)]
        return float(np.linalg.norm(np.concatenate(parts)))

    def figures(theta: Array) -> Figures:
        errors = np.abs(base @ (theta - true))
        return truth.figures(experiment.bodies(theta)) | {
            "torque": torque(theta - true) / torque(true),
            "base": float(np.sqrt(np.mean(np.square(errors / size)))),
            "max": float((errors / size).max()),
            "own": float(np.median(errors[large] / own[large])),
            "noisy": experiment.errors(theta)[0],
        }

    return experiment.outcomes([("none", "0"), *choices], true, figures)


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


def rows_of(draws: Sequence[Sequence[Outcome]]) -> list[dict[str, Any]]:
    """Averages over the draws, a row a model; without figures where none was solved."""
    priors = [outcomes[0].figures for outcomes in draws]
    rows = []
    for outcomes in zip(*draws, strict=True):
        solved = [(outcome.figures, prior) for outcome, prior in zip(outcomes, priors, strict=True) if outcome.figures]
        row: dict[str, Any] = {
            "kind": outcomes[0].kind,
            "weight": outcomes[0].weight,
            "failed": len(outcomes) - len(solved),
        }
        row["seconds"] = float(np.median([outcome.seconds for outcome in outcomes]))
        numbers = [outcome.number for outcome in outcomes if outcome.number]
        row["number"] = geometric_mean(np.array(numbers)) if numbers else None
        for name in solved[0][0] if solved else ():
            values = np.array([figures[name] for figures, _ in solved])
            row[name] = float(AVERAGES.get(name, np.mean)(values))
        if solved:
            row["farther"] = {
                name: float(np.mean([own[name] > prior[name] for own, prior in solved])) for name in COMPARED
            }
        rows.append(row)
    return rows


def print_rows(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> None:
    """The table."""
    heads = ["all" if name == "euclidean" else name for name in columns]
    head = "".join(f"{name:>10}" for name in heads)
    width = max(len(row["weight"]) for row in rows)
    print(f"{'':10}{'':{width}} {head}{'farther [%]':>21}{'weight':>10}{'failed':>8}{'s':>6}")
    for row in rows:
        line = f"{row['kind']:10}{row['weight']:>{width}} "
        if "farther" in row:
            values = [(100 if name in PER_CENT else 1) * row[name] for name in columns]
            line += "".join(f"{value:10.3g}" for value in values) + " "
            line += "".join(f"{100 * row['farther'][name]:5.0f}" for name in COMPARED)
        else:
            line += " " * (10 * len(columns) + 21)
        number = "" if row["number"] is None else f"{row['number']:.1e}"
        print(f"{line}{number:>10}{row['failed']:8}{row['seconds']:6.2f}")


def print_best(rows: Sequence[Mapping[str, Any]]) -> None:
    """Best fixed weight with hindsight, and distance of a chosen one over its, its kind's best and the prior's."""
    solved = [row for row in rows if row["weight"] and row["kind"] != "none" and not row["failed"]]
    fixed = [row for row in solved if is_number(row["weight"])]
    chosen = [row for row in solved if not is_number(row["weight"])]
    print("best fixed weight with hindsight" + ("; chosen over it, the best of its kind, the prior" if chosen else ""))
    for name in DISTANCES if fixed else ():
        if np.isnan(fixed[0][name]):
            continue
        best = min(fixed, key=lambda row: row[name])
        line = f"  {name:10}{best[name]:8.4f}  {best['kind']} {best['weight']}"
        for row in chosen:
            same = min(other[name] for other in fixed if other["kind"] == row["kind"])
            ratios = ", ".join(f"{row[name] / other:.2f}" for other in (best[name], same, rows[0][name]))
            line += f"; {row['kind']} {row['weight']} {ratios}"
        print(line)


def stopwatch(experiment: ReducedExperiment) -> Callable[[Choice], Figures]:
    """Processor seconds of a fit, of its identification, and of that without reading the log."""
    whole = Experiment(*(getattr(experiment, field.name) for field in fields(Experiment)))

    def seconds(choice: Choice) -> Figures:
        config = experiment.config.model_copy(update={"regularization": regularization(choice)})
        jobs = {
            "fit": lambda: fit(replace(whole, config=config), silent),
            "its identification": lambda: estimate_from_logs(replace(whole, config=config), "ls", silent),
            "without reading": lambda: estimate_from_logs(replace(experiment, config=config), "ls", silent),
        }
        return {name: processor_seconds(job) for name, job in jobs.items()}

    return seconds


def quick_fit_seconds(choice: Choice) -> Figures:
    """Processor seconds of a fit of the leg as a user runs it from Python."""
    config = leg_truth.CONFIG | {"regularization": regularization_entry(choice)}
    job = partial(idtool.fit, idtool.Model(leg_truth.URDF, config), LEG_LOGS[0], quick=True)
    return {"idtool.fit(quick=True)": processor_seconds(job)}


def processor_seconds(job: Callable[[], object]) -> float:
    """Processor time of a job [s]."""
    started = time.process_time()
    job()
    return time.process_time() - started


def print_times(choices: Sequence[Choice], repetitions: int, quadruped: Setup) -> list[dict[str, Any]]:
    """Time fits by turns, the first choice being what the others are compared with."""
    leg = leg_priors(0)["designer's"][0].experiment()
    actions: dict[str, Callable[[Choice], Figures]] = {
        "leg": lambda choice: quick_fit_seconds(choice) | stopwatch(leg)(choice),
        "quadruped": stopwatch(quadruped.experiment(0)),
    }
    rows = []
    for robot, action in actions.items():
        action(choices[0])  # imports and caches
        turns = [[action(choice) for choice in choices] for _ in range(repetitions)]
        for name in turns[0][0]:
            table = np.array([[taken[name] for taken in turn] for turn in turns])
            least, median = table.min(axis=0), np.median(table, axis=0)
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


def run_draws(pool: Any, job: Callable[[Any], list[Outcome]], things: Sequence[Any], name: str) -> list[list[Outcome]]:
    """The job done for all of them, progress on standard error."""
    results = []
    for outcomes in pool.imap(job, things):
        results.append(outcomes)
        print(f"\r{name}: {len(results)} of {len(things)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return results


def known_choices(kinds: Sequence[str], weights: Sequence[str]) -> list[Choice]:
    """Choices that this version of idtool knows; the others are named on standard error."""
    choices = []
    for choice in ((kind, weight) for kind in kinds for weight in weights):
        try:
            regularization(choice)
            choices.append(choice)
        except ConfigError as error:
            print(f"left out: {' '.join(choice)}: {error}", file=sys.stderr)
    return choices


def main(arguments: Sequence[str] | None = None) -> None:
    """Every part asked for."""
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
    sensors = Sensors(options.noise, options.coloured)
    errors = [PriorErrors(size, size / 2, 1.5 * size) for size in (options.mass_error, options.rotor_error)]
    common = (options.seconds, sensors, *errors, options.ellipsoids)
    setups = {name: Setup(robot.confined(options.travel), *common) for name, robot in ROBOTS.items()}
    results: dict[str, Any] = {"options": {name: str(value) for name, value in vars(options).items()}}
    with Pool(options.jobs) as pool:
        for name in (name for name in ROBOTS if name in parts):
            check(setups[name])
            job = partial(draw_robot, setup=setups[name], choices=choices)
            draws = run_draws(pool, job, range(options.draws), name)
            results[name] = report(f"{name}, {options.draws} draws", draws, ROBOT_COLUMNS)
        for name, priors in leg_priors(options.leg_draws).items() if "leg" in parts else ():
            draws = run_draws(pool, partial(draw_leg, choices=choices), priors, name)
            results[f"leg, {name}"] = report(f"leg, prior {name}, {len(priors)} draws", draws, LEG_COLUMNS)
    if "time" in parts:
        fixed = [choice for choice in choices if is_number(choice[1])][:1]
        others = [choice for choice in choices if choice[0] == options.kinds[0] and choice not in fixed]
        results["time"] = print_times([*fixed, *others], options.repetitions, setups["quadruped"])
    if options.json:
        options.json.write_text(json.dumps(results, indent=1))


def report(title: str, draws: Sequence[Sequence[Outcome]], columns: Sequence[str]) -> dict[str, Any]:
    """Print a table; all of it for JSON."""
    rows = rows_of(draws)
    print(f"\n{title}")
    print_rows(rows, columns)
    print_best(rows)
    return {"rows": rows, "draws": [[asdict(outcome) for outcome in outcomes] for outcomes in draws]}


if __name__ == "__main__":
    main()
