"""Online identification: where it converges to, that it stays in the set, and that it does not look ahead."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, bounds, point_parameters, synthetic

from idtool.adapt import Adaptation, adapt, adapt_report, convergence, time_to
from idtool.config import read_config
from idtool.ellipsoid import Ellipsoid
from idtool.exceptions import ConfigError, LogError
from idtool.experiment import Experiment, prepare
from idtool.identify import identify, solve
from idtool.inertia import POWERS
from idtool.recursive import RecursiveFit, units
from idtool.robot import Robot, read_robot
from idtool.sets import choose_set
from idtool.weights import weighted_rows

Array = NDArray[np.float64]
Made = Callable[..., Synthetic]

SAMPLES = Path(__file__).parents[1] / "sample_logs"
SETS = ["none", "semi", "full", "com_ellipsoid", "ellipsoid"]


def quiet(stage: str, share: float) -> None:
    """No progress shown."""


@pytest.fixture
def made(rng: np.random.Generator, robot_of: Callable[[str], Robot]) -> Made:
    """Rows of a robot of three joints and its true coefficients."""

    def make(count: int, each: int = 1, **config: Any) -> Synthetic:
        robot = robot_of(random_urdf(rng, 3, ["revolute", "prismatic"], mimic=0, massless=0))
        return synthetic(rng, robot, count, {**bounds(rng, robot, each), **config})

    return make


def started(made: Synthetic, name: str, kind: str = "euclidean") -> RecursiveFit:
    sets = [choose_set(body, name) for body in made.model.bodies]
    return RecursiveFit(made.linear, made.model, sets, kind, made.known)


def run(fit: RecursiveFit, made: Synthetic, tau: Array, gamma: float = 1.0) -> Array:
    """All samples one after the other; the estimates after each, shape (n, p)."""
    rows = made.Y @ fit.T
    everything = np.ones(len(rows), dtype=bool)
    found = []
    for W, torque in zip(np.moveaxis(rows, 1, 0), tau.T, strict=True):
        fit.update(W, torque, everything, gamma, 0.05, 1.0)
        found.append(fit.theta)
    return np.array(found)


def determined(made: Synthetic, scale: Array) -> Array:
    """Combinations of the coefficients that the rows determine, without unit, shape (rank, p)."""
    _, s, Vt = np.linalg.svd(np.concatenate(list(made.Y)) * scale)
    return np.asarray(Vt[: len(s)][s > 1e-9 * s[0]] / scale)


def pseudo(pi: Array) -> Array:
    """The second moments of the points [x; 1], written out."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = pi
    half = 0.5 * (xx + yy + zz)
    return np.array(
        [[half - xx, -xy, -xz, x], [-xy, half - yy, -yz, y], [-xz, -yz, half - zz, z], [x, y, z, m]],
    )


def trace_with(ellipsoid: Ellipsoid, pi: Array) -> float:
    """∫ (1 − the squared distance in semi-axes) dm, from the moments."""
    shape = ellipsoid.rotation @ np.diag(np.square(ellipsoid.semi_axes) ** -1.0) @ ellipsoid.rotation.T
    c, J = np.asarray(ellipsoid.center), pseudo(pi)
    spread = J[:3, :3] - np.outer(c, J[:3, 3]) - np.outer(J[:3, 3], c) + J[3, 3] * np.outer(c, c)
    return float(pi[0] - np.trace(shape @ spread))


@pytest.mark.parametrize("name", SETS)
def test_without_noise_it_comes_to_the_truth(made: Made, name: str) -> None:
    data = made(600)
    fit = started(data, name)
    B = determined(data, fit.units)
    error = np.linalg.norm((run(fit, data, data.tau) - data.theta) @ B.T, axis=1)
    assert error[-1] < 2e-3 * np.linalg.norm(B @ (data.linear.prior - data.theta))


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("each", [1, 2])
def test_every_estimate_is_in_its_set(made: Made, name: str, each: int) -> None:
    data = made(150, each)
    fit = started(data, name)
    theta = np.vstack([fit.theta, run(fit, data, data.noisy(0.5), gamma=0.95)])
    inertial = 10 * len(data.model.bodies)
    assert (theta[:, inertial:] >= 0).all()
    J = np.array([[pseudo(pi) for pi in row[:inertial].reshape(-1, 10)] for row in theta])
    least = np.linalg.eigvalsh(J)[..., 0]
    if name == "none":
        assert least.min() < 0
        return
    inertia = np.einsum("...ii->...", J[..., :3, :3])[..., None, None] * np.eye(3) - J[..., :3, :3]
    m, h = J[..., 3, 3], J[..., :3, 3]
    c = h / m[..., None]
    about = inertia - m[..., None, None] * (
        np.square(c).sum(-1)[..., None, None] * np.eye(3) - c[..., :, None] * c[..., None, :]
    )
    assert m.min() > 0
    assert np.linalg.eigvalsh(about).min() > 0
    if name == "semi":
        return
    assert least.min() > 0
    if each == 1 and name == "ellipsoid":
        for i, body in enumerate(data.model.bodies):
            assert min(trace_with(body.ellipsoids[0], row[10 * i : 10 * i + 10]) for row in theta) > 0
    if each == 1 and name == "com_ellipsoid":
        for i, body in enumerate(data.model.bodies):
            assert all(body.ellipsoids[0].contains(centre) for centre in c[:, i])


def test_none_is_plain_recursive_least_squares(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """The normal equations of all samples, each forgotten by its age, and of a prior of one unit's deviation."""
    monkeypatch.setattr(RecursiveFit, "noise", property(lambda fit: np.ones(len(fit.squares))))
    data = made(80, friction={"viscous": False, "coulomb": False})
    fit, tau, gamma = started(data, "none"), data.noisy(0.1), 0.97
    theta = run(fit, data, tau, gamma)
    scale = np.array([c.scale for c in data.linear.coefficients])
    for last in (0, 7, 79):
        age = gamma ** (last - np.arange(last + 1))
        Y, y = data.Y[:, : last + 1], tau[:, : last + 1]
        grown = max(np.sum(age.shape[0] and y**2) / np.square(Y @ data.linear.prior).sum(), 1.0)
        P = np.einsum("jnk,n,jnl->kl", Y, age, Y) + np.diag(scale**-2.0 * (1 / grown + 1e-8))
        q = np.einsum("jnk,n,jn->k", Y, age, y) + scale**-2.0 * (1 / grown + 1e-8) * data.linear.prior
        np.testing.assert_allclose(theta[last] / scale, np.linalg.solve(P, q) / scale, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["full", "ellipsoid"])
@pytest.mark.parametrize("kind", ["euclidean", "pullback"])
def test_it_tracks_the_constrained_optimum_of_what_is_not_forgotten(made: Made, name: str, kind: str) -> None:
    data = made(300)
    fit = started(data, name, kind)
    run(fit, data, data.noisy(1.0), gamma=0.98)
    P, q = fit.normal()
    A = np.asarray(np.linalg.cholesky(P).T, dtype=np.float64)
    b = np.asarray(np.linalg.solve(A.T, q), dtype=np.float64)
    problem = replace(fit.problem, A=A, b=b, constant=0.0)  # one piece a body: z is x
    best = problem.cost(solve(problem)[0])
    x, free = (np.asarray(np.linalg.solve(*pair), dtype=np.float64) for pair in ((fit.T, fit.theta), (P, q)))
    assert -1e-6 * best < problem.cost(x) - best < 0.2
    assert best > problem.cost(free) + 0.5  # so that the set matters


def test_it_comes_to_the_fit_of_the_whole_log(made: Made) -> None:
    data = made(1500)
    tau = data.noisy(0.03)
    fit = started(data, "ellipsoid")
    theta = run(fit, data, tau)
    sets = [choose_set(body, "ellipsoid") for body in data.model.bodies]
    whole = identify(data.linear, data.model.bodies, data.reduction(tau), sets, data.config.regularization, data.known)
    B = determined(data, fit.units)
    start, offline, online = (np.linalg.norm(B @ (t - data.theta)) for t in (theta[0], whole.theta, theta[-1]))
    assert np.linalg.norm(B @ (whole.theta - theta[-1])) < 0.02 * start, (start, offline, online)


def test_forgetting_follows_a_payload_and_remembering_does_not(made: Made) -> None:
    data = made(1200)
    heavier = data.theta.copy()
    heavier[20:30] += point_parameters(np.array([0.5]), np.array([data.model.bodies[2].ellipsoids[0].center]))
    tau = np.concatenate([data.tau[:, :600], (data.Y @ heavier)[:, 600:]], axis=1)
    errors = []
    for gamma in (0.97, 1.0):
        fit = started(data, "ellipsoid")
        theta = run(fit, data, tau, gamma)[-1]
        B = determined(data, fit.units)
        errors.append(np.linalg.norm(B @ (theta - heavier)) / np.linalg.norm(B @ (data.theta - heavier)))
    assert errors[0] < 0.15
    assert errors[1] > 0.8


def test_a_prior_that_only_holds_a_place_does_not_hold_it_back(made: Made) -> None:
    data = made(1200)
    bodies = tuple(replace(body, pi=1e-3 * body.pi) for body in data.model.bodies)
    model = replace(data.model, bodies=bodies)
    rigid = replace_coefficients(data, 1e-3)
    sets = [choose_set(body, "ellipsoid") for body in bodies]
    fit = RecursiveFit(rigid.linear, model, sets, "euclidean", data.known)
    theta = run(fit, rigid, data.tau)
    B = determined(data, units(data.linear, data.model))
    assert np.linalg.norm(B @ (theta[-1] - data.theta)) < 0.02 * np.linalg.norm(B @ data.theta)


def replace_coefficients(data: Synthetic, factor: float) -> Synthetic:
    """The same torque equation with a prior and sizes of inertia so much smaller."""
    rigid = data.linear.effects[0]
    rigid.coefficients = tuple(
        replace(c, prior=factor * c.prior, scale=factor * (c.scale or 0.0)) for c in rigid.coefficients
    )
    return data


def test_typical_sizes_of_friction_are_what_the_joint_carries(made: Made) -> None:
    data = made(1)
    found = units(data.linear, data.model)
    inertial = 10 * len(data.model.bodies)
    scale = np.array([c.scale or np.nan for c in data.linear.coefficients])
    np.testing.assert_array_equal(found[:inertial], scale[:inertial])
    support = data.model.support()
    for c, size in zip(data.linear.coefficients[inertial:], found[inertial:], strict=True):
        j = data.linear.joints.index(c.owner)
        power = POWERS[0] if data.model.joints[j].kind == "prismatic" else POWERS[1]
        carried = sum(scale[10 * i + int(power)] for i in np.flatnonzero(support[:, j]))
        assert size == pytest.approx(9.81 * carried)


@pytest.fixture(scope="module")
def leg() -> Experiment:
    """The sample leg."""
    robot, config = read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml")
    return prepare(robot, config, [SAMPLES / "leg_train.mcap"], holdout=0.0)


def adapted(experiment: Experiment, name: str, forgetting: float = 20.0) -> Adaptation:
    sets = [choose_set(body, name) for body in experiment.model.bodies]
    return adapt(experiment, sets, forgetting, progress=quiet)


def test_tighter_sets_converge_sooner_on_the_leg(leg: Experiment) -> None:
    """Remark 5: from the URDF's figures to a tenth of their error against the fit of the whole log."""
    sets = [choose_set(body, "ellipsoid") for body in leg.model.bodies]
    reduction = leg.reduce(quiet)
    target = identify(leg.equation, leg.model.bodies, reduction, sets, leg.config.regularization, leg.known)
    rows = weighted_rows(leg.equation, reduction, target.noise)[:, :-1]
    seconds: dict[str, float] = {}
    for name in ("none", "full", "ellipsoid"):
        found = adapted(leg, name)
        error = convergence(found, target.theta, rows)
        assert error[0] == 1
        assert error[-1] < 0.1
        seconds[name] = time_to(found.t, error) or np.inf
        assert found.prediction_rms(leg.equation.joints)["overall"] < 1.2 * target.noise.mean()
    assert seconds["ellipsoid"] <= seconds["full"] + 0.1
    assert seconds["full"] < 0.8 * seconds["none"]


def test_the_end_of_a_log_does_not_change_its_beginning(leg: Experiment) -> None:
    cut = 4000
    (signals,) = (run.signals for run in leg.runs)
    kept = {name: x.copy() for name, x in signals.log.signals.items()}
    before = adapted(leg, "ellipsoid")
    try:
        for x in signals.log.signals.values():  # what was calibrated stays
            x[cut:] *= 1.1
        after = adapted(leg, "ellipsoid")
    finally:
        for name, x in kept.items():
            signals.log.signals[name][:] = x
    np.testing.assert_array_equal(before.t, after.t)
    same = (before.theta == after.theta).all(axis=1)
    changed = before.t[np.argmin(same)]
    assert same[before.t < changed].all()
    assert not same[before.t >= changed].any()
    first = signals.log.t[signals.ranges[0].start] - signals.log.t[0]
    assert cut * signals.log.dt - 0.3 < changed + first < cut * signals.log.dt + 0.3


def test_two_logs_follow_each_other(leg: Experiment) -> None:
    both = replace(leg, runs=leg.runs * 2)
    once, twice = adapted(leg, "full"), adapted(both, "full")
    assert twice.samples == 2 * once.samples
    assert twice.t[-1] == pytest.approx(2 * once.t[-1])
    assert (np.diff(twice.t) > 0).all()
    assert len(twice.t) <= 2002


def test_the_report_is_plain_data(leg: Experiment) -> None:
    found = adapted(leg, "full", np.inf)
    report = json.loads(json.dumps(adapt_report(found, leg), allow_nan=False))
    assert report["forgetting"] is None
    assert report["joints"] == ["abad", "hip", "knee"]
    assert report["constraints"] == dict.fromkeys(report["bodies"], "full")
    assert len(report["t"]) == len(report["theta"]) == len(found.t)
    assert len(report["coefficients"]) == len(report["theta"][0]) == 66
    assert set(report["prediction_rms"]) == {"abad", "hip", "knee", "overall"}
    for i, name in enumerate(report["bodies"]):
        body = report["final"]["bodies"][name]
        assert body["pi"] == report["theta"][-1][10 * i : 10 * i + 10]
        assert body["mass"] == body["pi"][0]
        assert body["realizable"]
        assert len(body["inertia_com"]) == 6
    assert report["final"]["friction"]["knee"]["coulomb"] == report["theta"][-1][-1]
    assert report["final"]["friction"]["knee"]["offset"] is None


@pytest.mark.parametrize("forgetting", [0.0, -1.0, np.nan])
def test_a_time_constant_must_be_positive(leg: Experiment, forgetting: float) -> None:
    with pytest.raises(ConfigError, match="time constant"):
        adapted(leg, "full", forgetting)


def test_a_log_that_the_filters_use_up_is_refused(leg: Experiment) -> None:
    (run_of_log,) = leg.runs
    short = replace(leg, runs=(replace(run_of_log, train=(slice(500, 540),)),))
    with pytest.raises(LogError, match="too short"):
        adapted(short, "full")


def test_the_error_is_that_of_the_parameters_that_the_data_determine() -> None:
    class Short:
        theta = np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 7.0], [1.0, 3.0, 9.0]])
        units = np.array([1.0, 3.0, 1.0])

    rows = np.array([[100.0, 0.0, 0.0], [0.0, 0.01, 0.0]])  # the torque hardly depends on the second
    error = convergence(Short(), np.array([1.0, 3.0, 0.0]), rows)  # type: ignore[arg-type]
    np.testing.assert_allclose(error, [1.0, np.sqrt(0.5), 0.0], atol=1e-12)


def test_the_time_to_an_error_is_that_after_which_it_stays() -> None:
    t, error = np.arange(6.0), np.array([1.0, 0.05, 0.3, 0.1, 0.09, 0.0])
    assert time_to(t, error) == 3.0
    assert time_to(t, error, 0.5) == 1.0
    assert time_to(t[:3], error[:3]) is None
    assert time_to(t, np.zeros(6)) == 0.0
