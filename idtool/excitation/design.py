"""`design`: what is to be told → a trajectory that tells it, and how well.

The search knows a coarse grid and penalties; what it finds is then fitted to within the limits on a fine one, and its
standard errors are predicted by what `fit` will do with the log: the same filter, the same rows left out.

Shapes: nv joints, N samples, r base parameters, p coefficients. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.names import nearest
from idtool.data.logs import Log, make_log
from idtool.data.signals import Signals, default_cutoff
from idtool.estimation.dataset.experiment import Progress
from idtool.estimation.dataset.reduction import Reduction, empty, reduce_blocks
from idtool.excitation.criteria import CRITERIA, Errors, expected_errors
from idtool.excitation.feasible import collisions, feasible, home_of, largest_use, nearest_links
from idtool.excitation.objective import Objective
from idtool.excitation.patterns import PATTERNS, Part, Setting, Slow, Standstill, Trajectory
from idtool.excitation.task import Task
from idtool.robot.config import Config

_LONGEST = 40.0  # s of a motion that is searched for; longer ones are repeated
_SHORTEST = 2.0  # s
_STANDING = 0.25  # of the time for friction is for standstill, if that is
_LEAST = 1.0  # s
_PER_PERIOD = 16.0  # coarse samples in a period of the highest frequency
_COARSE = 20.0  # Hz: no fewer
_FINE = 100.0  # Hz, for the parts that are not searched for
_BELOW_BAND = 0.25  # of the filter's cut-off: highest frequency of a motion
_ABOVE_CORNER = 2.0  # times the frequency at which a joint that uses its range reaches another limit
_STAGES = ((1e2, 0.3), (1e3, 0.3), (1e4, 0.4))  # price of leaving the limits, and share of the iterations at it
_TRIAL = 0.1  # of the iterations, for each of the motions drawn at random, and each repair
_REPAIRS, _WATCHED = 4, 300  # of collisions between coarse samples, and instants that each looks at more


@dataclass(frozen=True)
class DesignOptions:
    """What a user may choose of a trajectory.

    Attributes
    ----------
    pattern
        Name of the motion's family.
    seconds
        Duration of all [s].
    slow
        Share of it that is for friction: slow sweeps and standstill.
    highest
        Highest frequency [Hz]; None: by the limits.
    iterations
        Of the search.
    seed
        Of what is drawn.
    start
        Positions at the start, by joint [rad or m].
    tip
        Link that follows a shell; None: the last.
    """

    pattern: str = "fourier"
    seconds: float = 20.0
    slow: float = 0.2
    highest: float | None = None
    iterations: int = 150
    seed: int = 0
    start: Mapping[str, float] = field(default_factory=dict)
    tip: str | None = None


@dataclass(frozen=True)
class Design:
    """A trajectory and what it will tell.

    Attributes
    ----------
    task, trajectory
        What was asked, and the answer.
    errors, logged_errors
        Standard errors to expect of all data together, and of what is logged already, None where nothing is; SI.
    criteria
        By name: of a random motion of the same family, of the design, and of what is logged.
    use
        Share of each of the robot's limits that is taken, shape (4, nv).
    nearest
        Links that come nearest to each other, how near [m], when [s].
    highest
        Highest frequency of the pattern [Hz].
    evaluations
        Motions looked at.
    interrupted
        Whether the search was ended before its time.
    """

    task: Task
    trajectory: Trajectory
    errors: Errors
    logged_errors: Errors | None
    criteria: dict[str, dict[str, float]]
    use: Array
    nearest: tuple[tuple[str, str], float, float] | None
    highest: float
    evaluations: int
    interrupted: bool

    def log(self, path: Path) -> Log:
        """The trajectory as a log of commands; q and v are those that a perfect controller would give."""
        t, (q, v, _) = self.trajectory.sampled(self.task.rate)
        signals = {"q": q.T, "v": v.T, "qcmd": q.T, "vcmd": v.T}
        return make_log(path, t, self.task.model.names, {name: x.copy() for name, x in signals.items()})


@dataclass(frozen=True)
class Logged:
    """What is logged already: its R-factors, and the noise of each joint in them, shape (nv,)."""

    reduction: Reduction
    noise: Array


def design(task: Task, config: Config, wishes: DesignOptions, logged: Logged | None, progress: Progress) -> Design:
    """Find a trajectory.

    Parameters
    ----------
    task
        Robot, limits and aim.
    config
        For the filter that the log will go through.
    wishes
        Pattern, duration and the like.
    logged
        What is there already.
    progress
        Told the stage and its share.

    Raises
    ------
    IdtoolError
        If there is no such motion.
    """
    if wishes.pattern not in PATTERNS:
        raise ConfigError("--pattern", f"{wishes.pattern} is no pattern; {nearest(wishes.pattern, list(PATTERNS))}")
    rng = np.random.default_rng(wishes.seed)
    highest = wishes.highest or highest_frequency(task, config)
    home = home_of(task, wishes.start, rng)
    fixed, main = _for_friction(task, wishes, home, rng)
    known = task.columns.rows(logged.reduction, logged.noise) * task.size if logged else np.zeros((0, len(task.size)))
    repeats = int(np.ceil(main / _LONGEST))
    setting = Setting(task.model, task.limits, home, main / repeats, max(highest, 2 * repeats / main), wishes.tip)
    before = known.T @ known + _information(task, fixed)
    rate = max(_PER_PERIOD * setting.highest, _COARSE)
    objective = Objective(task, PATTERNS[wishes.pattern](setting), before, repeats, rate)
    start, interrupted = _search(objective, wishes.iterations, rng, progress)
    progress("checking the limits", 0.0)
    best = objective.best if objective.best is not None else start
    drawn, part = (feasible(task, Part(objective.pattern, x)) for x in (start, best))
    part = min(drawn, part, key=lambda one: task.aim.value(objective.information(one.x)))
    trajectory = Trajectory((part,) * repeats + fixed)
    progress("predicting the standard errors", 0.0)
    every = np.concatenate([known, task.columns.rows(_to_come(task, config, trajectory), task.noise) * task.size])
    information = {"random": objective.information(drawn.x), "design": every.T @ every}
    information |= {"logged": known.T @ known} if logged else {}
    return Design(
        task=task,
        trajectory=trajectory,
        errors=expected_errors(every / task.size, task.base),
        logged_errors=expected_errors(known / task.size, task.base) if logged else None,
        criteria={name: {kind: task.aim.value(M, kind) for kind in CRITERIA} for name, M in information.items()},
        use=largest_use(task, trajectory),
        nearest=nearest_links(task, trajectory),
        highest=setting.highest,
        evaluations=objective.evaluations,
        interrupted=interrupted,
    )


def _information(task: Task, parts: Sequence[Part]) -> Array:
    """Of parts that are not searched for, shape (r, r)."""
    M = np.zeros((len(task.size), len(task.size)))
    for part in parts:
        t = np.linspace(0, part.pattern.seconds, int(_FINE * part.pattern.seconds) + 2)
        M += task.information(part.at(t), t)
    return M


def highest_frequency(task: Task, config: Config) -> float:
    """Up to which frequency a motion is worth its while [Hz].

    A joint that moves over its whole range and at its velocity limit meets its acceleration limit at some frequency;
    far above that, it hardly moves. And the filter must let it through.
    """
    limits = task.limits
    corner = np.maximum(limits.acceleration / limits.velocity, np.sqrt(limits.acceleration / limits.half)) / (2 * np.pi)
    band = config.filter.cutoff_hz or default_cutoff(1 / task.rate)
    return float(min(_ABOVE_CORNER * corner.max(), _BELOW_BAND * band))


def _for_friction(
    task: Task, wishes: DesignOptions, home: Array, rng: np.random.Generator
) -> tuple[tuple[Part, ...], float]:
    """Slow sweeps and standstill, and how many seconds are left."""
    if not 0 <= wishes.slow < 1:
        raise ConfigError("--slow", f"{wishes.slow:g} is no share; give a number from 0 to below 1")
    time, parts = wishes.slow * wishes.seconds, []
    standing = _STANDING * time if _STANDING * time >= _LEAST else 0.0
    for kind, seconds in ((Slow, time - standing), (Standstill, standing)):
        if seconds >= _LEAST:
            pattern = kind(Setting(task.model, task.limits, home, seconds))
            parts.append(feasible(task, Part(pattern, pattern.draw(rng))))
    left = wishes.seconds - sum(part.pattern.seconds for part in parts)
    if left < _SHORTEST:
        raise ConfigError("--duration", f"leaves {left:.3g} s for the motion; give at least {_SHORTEST:g} s more")
    return tuple(parts), left


def _search(objective: Objective, iterations: int, rng: np.random.Generator, progress: Progress) -> tuple[Array, bool]:
    """Look for the best motion; gives the first one drawn, and whether the search was interrupted."""
    pattern, done = objective.pattern, 0
    draws = [pattern.draw(rng) for _ in range(pattern.draws)]
    every = max(round(iterations * (1 + _TRIAL * len(draws))), 1)

    def improved(x: Array, most: int) -> tuple[float, Array]:
        def told(_: Array) -> None:
            nonlocal done
            done += 1
            progress("designing", min(done / every, 1.0))

        options = {"maxiter": most, "maxcor": 20}
        found = minimize(  # type: ignore[call-overload]
            objective, x, jac=True, method="L-BFGS-B", callback=told, options=options
        )
        return float(found.fun), found.x

    try:
        progress("designing", 0.0)
        objective.price = _STAGES[0][0]
        trials = [improved(x, max(round(_TRIAL * iterations), 1)) for x in draws]
        x = min(trials, key=lambda trial: trial[0])[1]
        for price, share in _STAGES:
            objective.price = price
            x = improved(x, max(round(share * iterations), 1))[1]
        for _ in range(_REPAIRS):
            best = x if objective.best is None else objective.best
            when = collisions(objective.task, Part(pattern, best))
            if not len(when):
                break
            objective.watch(when[:: max(len(when) // _WATCHED, 1)])
            x = improved(best, max(round(_TRIAL * iterations), 1))[1]
    except KeyboardInterrupt:
        return draws[0], True
    return draws[0], False


def _to_come(task: Task, config: Config, trajectory: Trajectory) -> Reduction:
    """The log of the trajectory as `fit` would reduce it, its torque as predicted."""
    t, samples = trajectory.sampled(task.rate)
    names = task.model.names
    signals = {"q": samples.q.T, "v": samples.v.T, "tau": task.torque(samples, t).T}
    signals_of = Signals(make_log(Path("design"), t, names, signals), names, config)
    blocks = map(task.equation.block, signals_of.batches())
    return reduce_blocks(blocks, empty(task.equation.active()), signals_of.low_pass.redundancy)
