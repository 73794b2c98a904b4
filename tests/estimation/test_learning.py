"""Draws of samples: the pool they come from, and the errors and violations that are made of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from commands import LEG, TRAIN, VALIDATE
from numpy.typing import NDArray
from scipy.stats import chi2

from idtool.common import processes
from idtool.common.exceptions import LogError, SolverError
from idtool.estimation.dataset.drawn_rows import DrawnRows
from idtool.estimation.dataset.experiment import Experiment, Run, prepare
from idtool.estimation.dataset.reduced_logs import reduce_logs
from idtool.estimation.dataset.reduction import Factor, Reduction, empty, merge
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.study import learning
from idtool.estimation.study.learning import (
    StudyData,
    counts,
    gather,
    held_out,
    learn,
    reduced_data,
    rms,
    violation,
)
from idtool.robot.config import read_config
from idtool.robot.inertia import PI_SIZE, from_mass_com_inertia
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]


def silent(stage: str, share: float) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def leg() -> Experiment:
    """The sample leg with a log to fit and one held out."""
    config = read_config(LEG.with_suffix(".yaml"))
    return prepare(read_robot(LEG), config, [TRAIN], [VALIDATE])


@pytest.fixture(scope="module")
def gathered(leg: Experiment) -> tuple[Reduction, DrawnRows]:
    """All its training data and the pool."""
    return gather(leg, silent)


def squared(factor: Factor) -> Array:
    """What is left of the rows' order and of the factor's signs."""
    return np.asarray(factor.R.T @ factor.R)


def assert_same(a: Reduction, b: Reduction, rtol: float = 1e-9) -> None:
    for x, y in zip(a, b, strict=True):
        assert x.rows == y.rows
        assert x.independent == pytest.approx(y.independent, rel=1e-12)
        size = np.sqrt(np.diag(squared(y)))
        size[size == 0] = 1
        np.testing.assert_allclose(squared(x) / size / size[:, None], squared(y) / size / size[:, None], atol=rtol)


def test_gathering_reduces_the_data_as_a_fit_does(leg: Experiment, gathered: tuple[Reduction, DrawnRows]) -> None:
    assert_same(gathered[0], leg.reduce(silent))


def test_a_draw_of_all_samples_is_all_data(gathered: tuple[Reduction, DrawnRows], rng: np.random.Generator) -> None:
    """In any order, at once or merged from parts."""
    total, pool = gathered
    assert pool.are_all
    samples = len(pool)
    assert all(block.shape[1] == samples for block in pool.rows)
    order = rng.permutation(samples)
    assert_same(pool.reduction(order), total)
    parts = np.split(order, [1, 3, 10, 500])
    merged = tuple(Factor(np.zeros((0, len(b))), 0, 0.0) for b in pool.rows)
    for part in parts:
        merged = merge(merged, pool.reduction(part))
    assert_same(merged, total)


def test_samples_that_do_not_count_are_left_out_of_a_draw(rng: np.random.Generator) -> None:
    blocks = [rng.normal(size=(3, 20)), rng.normal(size=(2, 20))]
    shares = [(np.arange(20) % 2 == 0) * 1.0, (np.arange(20) < 5) * 1.0]
    worth, keys = np.full(20, 0.25), np.linspace(0, 1, 20)
    pool = DrawnRows(tuple(blocks), np.stack(shares), worth, keys, 20)
    chosen = np.array([1, 2, 3, 4, 17, 18])
    first, second = pool.reduction(chosen)
    assert (first.rows, first.independent) == (3, 0.75)  # 2, 4, 18
    assert (second.rows, second.independent) == (4, 1.0)  # 1, 2, 3, 4
    own = blocks[0][:, [2, 4, 18]]
    np.testing.assert_allclose(squared(first), own @ own.T, rtol=1e-12, atol=1e-12)


def stream(sizes: list[int], runs: int = 1, name: str = "log") -> Experiment:
    """Logs that hold nothing but the samples' numbers, in batches of these sizes; what `gather` takes of it."""
    starts = np.cumsum([0, *(sizes * runs)]).tolist()

    def rows(batch: Any) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        number = np.arange(batch.start, batch.stop, dtype=float)
        return [np.stack([number, np.ones_like(number)])], [np.ones(len(number), dtype=bool)]

    def batches(first: int) -> Iterator[Any]:
        for k in range(first, first + len(sizes)):
            motion = SimpleNamespace(t=np.zeros(sizes[k - first]))
            yield SimpleNamespace(start=starts[k], stop=starts[k + 1], motion=motion, before=0, after=0)

    def run(first: int) -> Any:
        signals: Any = SimpleNamespace(
            low_pass=SimpleNamespace(redundancy=2.0),
            full_rate_low_pass=SimpleNamespace(edge=0),
            log=SimpleNamespace(path=Path(f"{name}{first}.csv"), dt=0.001, unknown_torque=(), sources=()),
            batches=lambda _: batches(first),
        )
        return Run(signals, (slice(0, sum(sizes)),), ())

    equation = SimpleNamespace(joints=("hip",), active=lambda: (np.arange(1),), counted_rows=rows, contacts=None)
    logs = tuple(run(k * len(sizes)) for k in range(runs))
    return Experiment(
        *cast(
            "Any",
            (SimpleNamespace(effects=(), contacts=()), SimpleNamespace(has_floating_base=False), equation, None, logs),
        )
    )


def test_the_pool_is_bounded_and_holds_every_sample_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over many draws of it, by the chi-squared statistic of how often each sample was in it."""
    monkeypatch.setattr(learning, "_POOL", 40)
    sizes, repeats = [7, 100, 1, 60, 32], 2000
    total = sum(sizes)
    seen = np.zeros(total)
    for seed in range(repeats):
        reduction, pool = gather(stream(sizes, name=f"log {seed}"), silent)
        numbers = pool.rows[0][0].astype(int)
        assert pool.rows[0].shape == (2, 40)
        assert pool.shares.shape == (1, 40)
        assert len(set(numbers.tolist())) == 40
        assert pool.drawn_from == total
        assert reduction[0].rows == total
        seen[numbers] += 1
    share = 40 / total
    expected, spread = repeats * share, repeats * share * (1 - share)
    statistic = float(np.sum((seen - expected) ** 2) / spread) * (total - 1) / total  # of samples without replacement
    assert 1e-3 < chi2.cdf(statistic, total - 1) < 1 - 1e-3
    batches = np.add.reduceat(seen, np.cumsum([0, *sizes[:-1]]))
    np.testing.assert_allclose(batches / (expected * np.array(sizes)), 1, atol=0.1)


def test_a_pool_over_several_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has its share, and a pool that is not full is everything."""
    _, pool = gather(stream([30, 20], runs=3), silent)
    assert pool.are_all
    assert sorted(pool.rows[0][0]) == list(range(150))
    monkeypatch.setattr(learning, "_POOL", 60)
    of_log = np.zeros(3)
    for seed in range(200):
        _, pool = gather(stream([30, 20], runs=3, name=f"log {seed}"), silent)
        of_log += np.bincount(pool.rows[0][0].astype(int) // 50, minlength=3)
    np.testing.assert_allclose(of_log / of_log.sum(), 1 / 3, atol=0.02)


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        ([], "no part without gaps is long enough for the filter"),
        ([5], "joint hip hardly moves in the part of the logs that is used for the fit; log a motion"),
    ],
    ids=["no samples", "samples that do not count"],
)
def test_nothing_to_fit_to_is_said(sizes: list[int], said: str) -> None:
    experiment = stream(sizes)
    rows = experiment.equation.counted_rows
    experiment.equation.counted_rows = lambda batch: (rows(batch)[0], [np.zeros(5, dtype=bool)])  # type: ignore[method-assign]
    with pytest.raises(LogError, match=f"^log0.csv: {said}"):
        gather(experiment, silent)


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        (1, [1]),
        (2, [1, 2]),
        (3, [1, 3]),
        (10, [1, 3, 10]),
        (29, [1, 3, 10, 29]),
        (30, [1, 3, 10, 30]),
        (1645, [1, 3, 10, 30, 100, 300, 1000, 1645]),
    ],
)
def test_the_counts_go_up_to_all_samples(samples: int, expected: list[int]) -> None:
    assert counts(samples) == expected


def test_the_error_is_that_of_the_rows(leg: Experiment, rng: np.random.Generator) -> None:
    """Filtered rows of every held-out batch, written out."""
    theta = leg.equation.prior * rng.uniform(0.5, 1.5, len(leg.equation.prior))
    squares, samples = np.zeros(3), 0
    for run in leg.runs:
        for batch in run.signals.batches(run.held_out):
            blocks, _ = leg.equation.filtered_rows(batch)
            for j, (block, columns) in enumerate(zip(blocks, leg.equation.active(), strict=True)):
                squares[j] += np.sum((theta[columns] @ block[:-1] - block[-1]) ** 2)
            samples += blocks[0].shape[1]
    expected = np.sqrt([*(squares / samples), squares.sum() / (3 * samples)])
    ours = rms(held_out(leg, silent), leg.equation.active(), theta)
    np.testing.assert_allclose(ours, expected, rtol=1e-10)


State = dict[str, Any]


def stating(leg: Experiment, total: Reduction, names: tuple[str, ...]) -> State:
    noise = free_noise(leg.equation, total, leg.equalities)

    def of(name: str) -> Any:
        sets = [choose_set(body, name) for body in leg.model.bodies]
        regularization = leg.config.regularization.fixed_or_weak()
        return lambda data: build_problem(
            leg.equation, leg.model.bodies, data, sets, regularization, noise, leg.equalities
        )

    return {name: of(name) for name in names}


def problem_of(leg: Experiment, total: Reduction) -> Problem:
    problem: Problem = stating(leg, total, ("full",))["full"](total)
    return problem


def test_the_violation_is_the_worst_bodys_least_eigenvalue(
    leg: Experiment, gathered: tuple[Reduction, DrawnRows]
) -> None:
    """In units of its mass and size, and 0 where all can be."""
    problem = problem_of(leg, gathered[0])
    bodies = len(leg.model.bodies)
    ball = np.tile(from_mass_com_inertia(1.0, np.zeros(3), np.eye(3)), bodies)  # Sigma = ½
    z = np.concatenate([ball, -np.ones(len(problem.other_coefficients))])
    assert violation(problem, z) == 0
    for least, body in ((-0.2, 3), (-0.7, 1)):
        sigma = np.diag([0.5, 0.5, least])
        pi = from_mass_com_inertia(1.0, np.zeros(3), np.trace(sigma) * np.eye(3) - sigma)
        z[PI_SIZE * body : PI_SIZE * (body + 1)] = pi
        assert violation(problem, z) == pytest.approx(-least, rel=1e-12)


def learned(leg: Experiment, gathered: tuple[Reduction, DrawnRows], draws: int, seed: int = 0, **changes: Any) -> Any:
    total, pool = gathered
    state = stating(leg, total, ("none", "full"))
    validation = held_out(leg, silent)
    rng = np.random.default_rng(seed)
    pool = replace(pool, **changes)
    return learn(StudyData(total, pool, validation), leg.equation.active(), state, draws, rng, silent)


def test_all_samples_leave_no_spread_and_give_the_fit(leg: Experiment, gathered: tuple[Reduction, DrawnRows]) -> None:
    steps, curves = learned(leg, gathered, 2)
    assert steps == counts(len(gathered[1]))
    total = gathered[0]
    for name, problem in stating(leg, total, ("none", "full")).items():
        curve = curves[name]
        assert curve.unsolved == 0
        assert (curve.lower <= curve.median).all()
        assert (curve.median <= curve.upper).all()
        assert len(curve.violation) == len(curve.median) == len(steps)
        x, _ = solve(problem(total))
        theta = problem(total).theta(problem(total).S @ x)
        expected = rms(held_out(leg, silent), leg.equation.active(), theta)[-1]
        np.testing.assert_allclose([curve.lower[-1], curve.median[-1], curve.upper[-1]], expected, rtol=1e-4)
    assert (curves["full"].violation == 0).all()
    assert (curves["none"].violation > 0).any()


def test_the_same_seed_draws_the_same(leg: Experiment, gathered: tuple[Reduction, DrawnRows]) -> None:
    """And all sets learn from the same draws: with another seed both change."""
    first, same, other = (learned(leg, gathered, 1, seed)[1] for seed in (0, 0, 1))
    for name in ("none", "full"):
        np.testing.assert_array_equal(first[name].median, same[name].median)
        assert (first[name].median[:-1] != other[name].median[:-1]).all()


def test_a_pool_that_is_not_everything_ends_with_everything(
    leg: Experiment, gathered: tuple[Reduction, DrawnRows]
) -> None:
    samples = 2 * len(gathered[1])
    steps, curves = learned(leg, gathered, 1, drawn_from=samples)
    assert steps[-1] == samples
    assert steps[:-1] == counts(len(gathered[1]))
    for curve in curves.values():
        assert len(curve.median) == len(steps)
        assert curve.lower[-1] == curve.upper[-1]


def test_draws_that_are_not_solved_are_counted_and_left_out(
    leg: Experiment, gathered: tuple[Reduction, DrawnRows], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second one, and at the end all of them."""
    calls = 0

    def moody(problem: Problem) -> Any:
        nonlocal calls
        calls += 1
        if calls % 2:
            raise SolverError("solver", "gave up")
        return solve(problem)

    monkeypatch.setattr(processes, "process_count", lambda: 1)  # a copy of the process has its own count
    monkeypatch.setattr(learning, "solve", moody)
    steps, curves = learned(leg, gathered, 2)
    assert curves["none"].unsolved + curves["full"].unsolved == calls - calls // 2
    assert np.isfinite(curves["full"].median).all()  # the second of the two
    assert np.isnan(curves["none"].median).all()
    assert np.isnan(curves["none"].violation).all()
    assert len(curves["none"].median) == len(steps)


def test_the_curves_are_statistics_of_the_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of errors made up: quartiles, the median violation, and the mean of log ratios, pair by pair, with its error."""
    errors: dict[str, list[list[float]]] = {"a": [], "b": []}
    made = np.random.default_rng(5)

    def outcome(problem: Any, *_: object) -> tuple[float, float]:
        name, samples = problem
        while len(errors[name]) < 1 or len(errors[name][-1]) == 3:
            errors[name].append([])
        errors[name][-1].append(float(np.exp(made.normal()) / samples))
        return errors[name][-1][-1], -2 * errors[name][-1][-1]

    monkeypatch.setattr(processes, "process_count", lambda: 1)  # a copy of the process has its own list
    monkeypatch.setattr(learning, "_outcome", outcome)
    rows = np.stack([np.arange(10.0), np.ones(10)])
    pool = DrawnRows((rows,), np.ones((1, 10)), np.ones(10), np.linspace(0, 1, 10), 10)
    state: Any = {name: lambda data, name=name: (name, data[0].rows) for name in errors}
    total = pool.reduction(np.arange(10))
    steps, curves = learn(StudyData(total, pool, total), (np.arange(1),), state, 7, np.random.default_rng(0), silent)
    assert steps == [1, 3, 10]
    a, b = (np.array(errors[name][:7]) for name in ("a", "b"))  # one parameter: no count has more draws
    for made_up, curve in ((a, curves["a"]), (b, curves["b"])):
        np.testing.assert_allclose(curve.median, np.median(made_up, axis=0))
        np.testing.assert_allclose([curve.lower, curve.upper], np.percentile(made_up, [25, 75], axis=0))
        np.testing.assert_allclose(curve.violation, -2 * np.median(made_up, axis=0))
        ratio = np.log(a / made_up)
        np.testing.assert_allclose(curve.advantage, ratio.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(curve.advantage_error, ratio.std(axis=0, ddof=1) / np.sqrt(7), atol=1e-12)


def test_the_held_out_data_are_all_of_the_validation_log(leg: Experiment) -> None:
    total = empty(leg.equation.active())
    for run in leg.runs:
        for batch in run.signals.batches(run.held_out):
            blocks, _ = leg.equation.filtered_rows(batch)
            total = merge(total, tuple(Factor.from_columns(block) for block in blocks))
    assert_same(held_out(leg, silent), total)


def test_data_of_reduced_logs_are_those_of_the_logs(leg: Experiment, gathered: tuple[Reduction, DrawnRows]) -> None:
    """All training data, all samples of them, and the held-out data."""
    data = reduced_data(leg, reduce_logs(leg, silent, draws_rows=True))
    total, pool = gathered
    assert data.pool.are_all
    assert len(data.pool) == len(pool)
    assert_same(data.total, total)
    assert_same(data.pool.reduction(np.arange(len(pool))), total)
    for own, expected in zip(data.validation, held_out(leg, silent), strict=True):
        np.testing.assert_allclose(squared(own), squared(expected), rtol=1e-9, atol=1e-9)
