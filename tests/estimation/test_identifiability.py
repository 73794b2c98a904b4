"""What each number rests on: shares by hand for a planar arm, ends by hand for an ellipsoid, and what always holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from legs import LENGTH, copies, image, legs, of_body
from numpy.typing import NDArray
from robots import chain, joint, random_urdf
from synthetic import Synthetic, bounds, random_states, synthetic

from idtool.dynamics.effects.effect import Coefficient
from idtool.estimation.dataset.equality_constraints import with_equal_bounds
from idtool.estimation.problem.estimate import Estimate, estimate
from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.estimation.uncertainty.identifiability import (
    Identifiability,
    InformationShares,
    combination,
    identifiability,
)
from idtool.estimation.uncertainty.standard_errors import Uncertainty, least_squares_uncertainty
from idtool.reporting.uncertainty_report import combination_name, source_text
from idtool.robot.config import Regularization
from idtool.robot.inertia import PARAMETER_NAMES, PI_SIZE
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Robots = Callable[[str], Robot]

NO_FRICTION = {"viscous": False, "coulomb": False}
WEAK = Regularization(kind="euclidean", weight=1e-6)
BODY = (
    '<inertial><origin xyz="{c}"/><mass value="{m}"/><inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/>'
)


def with_body(text: str, name: str, mass: float, center: str, moments: tuple[float, float, float]) -> str:
    """A URDF with an inertial for a link."""
    x, y, z = moments
    inside = BODY.format(c=center, m=mass, x=x, y=y, z=z) + "</inertial>"
    return text.replace(f'<link name="{name}"/>', f'<link name="{name}">{inside}</link>')


def two_links(text: str) -> str:
    text = with_body(text, "l1", 2.0, "0.2 0.01 0", (0.01, 0.03, 0.035))
    return with_body(text, "l2", 1.0, "0.15 -0.02 0.01", (0.004, 0.02, 0.02))


REACH = 0.4
PLANAR = two_links(
    chain(
        joint("j1", "revolute", "l0", "l1"),
        joint("j2", "revolute", "l1", "l2", f'<origin xyz="{REACH} 0 0"/><axis xyz="0 0 1"/>'),
    )
)
FORKED = two_links(
    f'<robot name="r"><link name="l0"/><link name="l1"/><link name="l2"/>{joint("j1", "revolute", "l0", "l1")}'
    f"{joint('j2', 'revolute', 'l0', 'l2')}</robot>"
)


@dataclass(frozen=True)
class Asked:
    """A robot, its identification, and what it rests on."""

    s: Synthetic
    estimate: Estimate
    found: Uncertainty
    answer: Identifiability

    def of(self, owner: str, name: str) -> InformationShares:
        return self.answer.sources[self.place(owner, name)]

    def place(self, owner: str, name: str) -> int:
        (k,) = [i for i, c in enumerate(self.s.linear.coefficients) if (c.owner, c.name) == (owner, name)]
        return k

    def name(self, k: int) -> str:
        c = self.s.linear.coefficients[k]
        return f"{c.owner}.{c.name}"

    def text(self, owner: str, name: str) -> str:
        fit = SimpleNamespace(experiment=SimpleNamespace(equation=self.s.linear))
        return source_text(fit, self.answer, self.place(owner, name))  # type: ignore[arg-type]


def ask(
    s: Synthetic,
    kind: str = "none",
    noise: float = 1e-3,
    prior: Regularization = WEAK,
    sigma: Array | None = None,
    inflated: float = 1.0,
) -> Asked:
    """What the torque with noise of a share of its own size says.

    ``sigma`` is what is thought of the noise, ``inflated`` how far the residual's scatter is above that.
    """
    bodies = with_equal_bounds(s.model, s.equalities).bodies
    sets = [choose_set(body, kind) for body in bodies]
    data = s.reduction(s.noisy(noise))
    solution = estimate(s.linear, bodies, data, sets, prior, s.equalities, noise=sigma)
    solution = replace(solution, noise=solution.noise if sigma is None else sigma)
    found = least_squares_uncertainty(s.linear, data, solution.noise, s.equalities)
    told = found.directions.soft  # not what was measured otherwise
    found = replace(found, covariance_y=inflated * (found.covariance_y - told) + told)
    answer = identifiability(s.model, s.linear, s.equalities, data, solution, found, lambda share: None)
    return Asked(s, solution, found, answer)


def planar(robot_of: Robots, count: int = 100, text: str = PLANAR, **config: Any) -> Synthetic:
    """The arm across gravity without friction, 0.8 times the prior in truth, so that units are the prior's own."""
    everything: Mapping[str, Any] = {"gravity": [0.0, -9.81, 0.0], "friction": NO_FRICTION, **config}
    s = synthetic(np.random.default_rng(2), robot_of(text), count, everything)
    return replace(s, theta=0.8 * s.linear.prior)


HIDDEN = {"l2.m": 1.0, "l1.mc_x": -REACH, "l1.I_zz": -(REACH**2)}  # leaves I_1 + m_2 l² and mc_x1 + m_2 l as they are


def test_a_planar_arm_by_hand(robot_of: Robots) -> None:
    """With much data the only motion left is HIDDEN, by a prior's spread: its shares are what is not by the data.

    mc_y_1, mc_x_2, mc_y_2 and I_2 are determined; all else of a plane's bodies is felt by no joint.
    """
    asked = ask(planar(robot_of))
    units = {asked.name(k): float(c.scale or 1) for k, c in enumerate(asked.s.linear.coefficients)}
    moved = {name: share / units[name] for name, share in HIDDEN.items()}
    whole = np.linalg.norm(list(moved.values()))
    for k, basis in enumerate(asked.answer.sources):
        name = asked.name(k)
        if name in moved:
            assert basis.data == pytest.approx(1 - abs(moved[name]) / whole, abs=0.01)
            assert basis.information_source == ("combination" if basis.data > 0.5 else "prior")
        elif name in ("l1.mc_y", "l2.mc_x", "l2.mc_y", "l2.I_zz"):
            assert basis.information_source == "data"
            assert basis.data > 0.98
        else:
            assert basis.information_source == "prior"
            assert basis.prior == pytest.approx(1, abs=1e-6)
            assert basis.data == pytest.approx(0, abs=1e-6)
    assert {asked.of(*name.split(".")).information_source for name in moved} == {"combination", "prior"}


def test_what_moves_together_by_hand(robot_of: Robots) -> None:
    """m_2 up, I_1 and mc_x_1 down; what is felt by no joint moves with nothing, what is determined not with these."""
    asked = ask(planar(robot_of))
    determined = {"l1.mc_y", "l2.mc_x", "l2.mc_y", "l2.I_zz"}
    for k, basis in enumerate(asked.answer.sources):
        name = asked.name(k)
        partners = {asked.name(i): tied for i, tied in basis.moves_with}
        if name in HIDDEN:
            signs = {other: np.sign(HIDDEN[name] * share) for other, share in HIDDEN.items() if other != name}
            assert partners == pytest.approx(signs, abs=0.01)
        else:
            assert set(partners) <= (determined - {name} if name in determined else set())


def test_combinations_are_those_of_the_base(robot_of: Robots) -> None:
    asked = ask(planar(robot_of))
    base = asked.answer.base
    assert {asked.name(k) for k in base.own} == {"l1.mc_x", "l1.mc_y", "l1.I_zz", "l2.mc_x", "l2.mc_y", "l2.I_zz"}
    units = {asked.name(k): float(c.scale or 1) for k, c in enumerate(asked.s.linear.coefficients)}
    named = [asked.name(base.own[i]) for i in asked.of("l2", "m").combinations]
    weight = {name: abs(HIDDEN[name]) * units["l2.m"] / units[name] for name in ("l1.mc_x", "l1.I_zz")}
    assert named == sorted(weight, key=lambda name: -weight[name])  # those first of which it is the most
    assert asked.of("l1", "m").combinations == ()
    assert asked.answer.determined.all()
    truth = base.B @ asked.s.theta
    half = asked.answer.standard_error * asked.answer.coverage_factor
    assert (np.abs(asked.answer.value - truth) < 2 * half).all()
    np.testing.assert_allclose(asked.answer.value, base.B @ asked.estimate.theta)


def test_the_words(robot_of: Robots) -> None:
    asked = ask(planar(robot_of))
    assert asked.text("l2", "I_zz").startswith("l2 I_zz: determined by the data")
    assert asked.text("l1", "m") == "l1 mass: prior only"
    head, _, tail = asked.text("l2", "m").partition(": determined by the data only in a combination: ")
    assert head == "l2 mass"
    combined, _, partners = tail.partition("; correlated with ")
    assert combined == "l1 I_zz + 0.16 l2 mass"
    assert set(partners.split(" and ")) == {"l1 m·c_x", "l1 I_zz"}
    assert asked.of("l1", "I_zz").prior > 0.9
    assert asked.text("l1", "I_zz").startswith("l1 I_zz: prior only; correlated with ")
    less = InformationShares("prior", 0.1, 0.2, 0.7, (None, 3.0), (), ())
    open_ended = InformationShares("constraints", 0.1, 0.6, 0.3, (None, 3.0), ((10, 0.5), (0, -0.4), (1, 0.3)), ())
    asked = replace(asked, answer=replace(asked.answer, sources=(less, open_ended, *asked.answer.sources[2:])))
    assert asked.text("l1", "m") == "l1 mass: mostly prior (70 %)"
    assert (
        asked.text("l1", "mc_x") == "l1 m·c_x: limited by the constraints (60 %); correlated with l2 mass and l1 mass"
    )


def forked(robot_of: Robots, **config: Any) -> Synthetic:
    """Two bodies on upright axes, the second one at rest: nothing of it is felt."""
    rng = np.random.default_rng(5)
    states = random_states(rng, 80, 2)
    states[:, :, 1] = 0.0
    everything: Mapping[str, Any] = {"gravity": [0.0, 0.0, -9.81], "friction": NO_FRICTION, **config}
    s = synthetic(rng, robot_of(FORKED), 80, everything, states)
    return replace(s, theta=0.8 * s.linear.prior)


def ask_forked(robot_of: Robots, inflated: float = 1.0, kind: str = "none", **config: Any) -> Asked:
    """With as much noise as is thought, and next to no prior."""
    s = forked(robot_of, **config)
    return ask(s, kind, 0.1, Regularization(kind="none"), np.array([0.1 * s.tau[0].std(), 1.0]), inflated)


def test_a_body_that_rests_is_the_priors(robot_of: Robots) -> None:
    asked = ask_forked(robot_of)
    for name in PARAMETER_NAMES:
        basis = asked.of("l2", name)
        assert (basis.information_source, basis.moves_with, basis.range) == ("prior", (), (None, None))
        assert (basis.data, basis.constraints, basis.prior) == pytest.approx((0, 0, 1), abs=1e-6)
        assert asked.text("l2", name).endswith(": prior only")
    seen = {asked.name(k): sees for k, sees in zip(asked.answer.base.own, asked.answer.determined, strict=True)}
    assert seen == {"l1.I_zz": True, "l2.I_zz": False}
    assert np.isinf(asked.answer.standard_error[~asked.answer.determined]).all()


CENTER, AXES = (0.1, -0.05, 0.02), (0.5, 0.02, 0.1)


def test_an_ellipsoid_pins_the_static_moment_of_a_known_mass(robot_of: Robots) -> None:
    """h_k within m (c_k ± a_k): what that is less than the body's own size is the constraints' share."""
    mass = 0.6
    bound = {"center": list(CENTER), "semi_axes": list(AXES)}
    asked = ask_forked(robot_of, kind="ellipsoid", bounding_ellipsoids={"l2": [bound]}, known={"mass": {"l2": mass}})
    for k, name in enumerate(("mc_x", "mc_y", "mc_z")):
        basis = asked.of("l2", name)
        ends = mass * (CENTER[k] - AXES[k]), mass * (CENTER[k] + AXES[k])
        assert basis.range == pytest.approx(ends, abs=3e-3 * mass * AXES[k] + 1e-4)
        size = float(asked.s.linear.coefficients[asked.place("l2", name)].scale or 0)
        pinned = 1 - min(mass * AXES[k] / size, 1)
        assert (basis.data, basis.constraints) == pytest.approx((0, pinned), abs=0.01)
        assert basis.information_source == ("constraints" if pinned > 0.5 else "prior")
    assert asked.of("l2", "mc_x").information_source == "prior"
    assert asked.of("l2", "mc_y").information_source == "constraints"
    words = asked.text("l2", "mc_y")
    low, high = asked.of("l2", "mc_y").range
    share = f"{100 * asked.of('l2', 'mc_y').constraints:.0f} %"
    assert words == f"l2 m·c_y: limited by the constraints, {low:.3g} to {high:.3g} ({share})"


def test_a_mass_known_exactly_can_be_no_other(robot_of: Robots) -> None:
    asked = ask_forked(robot_of, kind="full", known={"mass": {"l2": 0.6}})
    basis = asked.of("l2", "m")
    assert basis.range == pytest.approx((0.6, 0.6), rel=1e-4)
    assert basis.information_source in ("constraints", "data")
    assert basis.prior < 0.01


@pytest.mark.parametrize("error", [0.1, 0.5])
@pytest.mark.parametrize("inflated", [1.0, 100.0])
def test_a_measured_mass_is_as_good_as_data(robot_of: Robots, error: float, inflated: float) -> None:
    """Two spreads of one number: 1/√(1 + (scale / error)²) of the prior's is left.

    However the torque's residual scatters: the body is not felt.
    """
    fact = {"value": 0.7, "standard_error": error}
    asked = ask_forked(robot_of, inflated, known={"mass": {"l2": fact}})
    assert asked.found.standard_error[asked.place("l2", "m")] == pytest.approx(error)
    scale = asked.s.linear.coefficients[asked.place("l2", "m")].scale or 0
    assert asked.of("l2", "m").data == pytest.approx(1 - 1 / np.hypot(1, scale / error), abs=1e-3)


def test_more_data_never_lower_their_share(robot_of: Robots) -> None:
    s = planar(robot_of, 240)
    sigma = 0.3 * s.tau.std(axis=1)
    shares = []
    for count in (1, 2, 3, 5, 10, 30, 240):
        part = replace(s, Y=s.Y[:, :count])
        shares.append([basis.data for basis in ask(part, noise=0.01, sigma=sigma).answer.sources])
    steps = np.diff(shares, axis=0)
    assert (steps > -1e-6).all()
    assert (steps.sum(axis=0) > 0.1).sum() >= 6


def test_noisier_data_have_a_smaller_share(robot_of: Robots) -> None:
    """And a residual whose scatter is that of four times the noise counts as four times the noise."""
    s = planar(robot_of, 40)
    sigma = 0.3 * s.tau.std(axis=1)
    plain, noisier, scattered = (
        np.array([basis.data for basis in ask(s, sigma=times * sigma, inflated=inflated).answer.sources])
        for times, inflated in ((1.0, 1.0), (4.0, 1.0), (1.0, 16.0))
    )
    assert (noisier <= plain + 1e-9).all()
    assert (noisier < plain - 0.03).sum() >= 4
    np.testing.assert_allclose(scattered, noisier, atol=1e-6)


@pytest.mark.parametrize("kind", ["none", "full", "ellipsoid"])
@pytest.mark.parametrize("seed", [1, 2])
def test_shares_make_one_and_ranges_hold_the_value(robot_of: Robots, kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=2, kinds=("revolute",), mimic=0, massless=0))
    asked = ask(synthetic(rng, robot, 60, bounds(rng, robot)), kind, noise=0.3)
    theta = asked.estimate.theta
    grounds = set()
    for k, basis in enumerate(asked.answer.sources):
        shares = {"data": basis.data, "constraints": basis.constraints, "prior": basis.prior}
        assert sum(shares.values()) == pytest.approx(1, abs=1e-9)
        assert min(shares.values()) >= 0
        low, high = basis.range
        assert low is None or low <= theta[k] + 1e-6
        assert high is None or high >= theta[k] - 1e-6
        if basis.information_source in ("constraints", "prior"):
            assert shares[basis.information_source] == max(basis.constraints, basis.prior)
        else:
            assert basis.information_source == "combination" or asked.found.identifiable[k]
            assert basis.data >= 0.5 or basis.data == max(shares.values())
        assert (basis.information_source == "data") <= (basis.data >= 0.5)
        assert all(i != k and 0.3 <= abs(tied) <= 1 + 1e-9 for i, tied in basis.moves_with)
        assert len(basis.moves_with) <= 3
        ties = [abs(tied) for _, tied in basis.moves_with]
        assert ties == sorted(ties, reverse=True)
        assert kind != "none" or basis.constraints < 1e-4  # as accurate as ranges are
        assert asked.text(*asked.name(k).split(".")).startswith(basis_head(asked, k))
        grounds.add(basis.information_source)
    assert len(grounds) >= 2
    if kind == "ellipsoid":
        assert any(basis.constraints > 0.05 for basis in asked.answer.sources)


def basis_head(asked: Asked, k: int) -> str:
    c = asked.s.linear.coefficients[k]
    return f"{c.owner} {'mass' if c.name == 'm' else c.name.replace('mc_', 'm·c_')}: "


def test_a_set_takes_its_share_off_the_priors(robot_of: Robots) -> None:
    """The data's is the same whatever the set."""
    rng = np.random.default_rng(1)
    robot = robot_of(random_urdf(rng, size=2, kinds=("revolute",), mimic=0, massless=0))
    s = synthetic(rng, robot, 60, bounds(rng, robot))
    sigma = 0.3 * s.tau.std(axis=1)
    none, ellipsoid = (ask(s, kind, 0.3, sigma=sigma).answer.sources for kind in ("none", "ellipsoid"))
    np.testing.assert_allclose([b.data for b in none], [b.data for b in ellipsoid], atol=1e-9)
    assert all(b.prior <= a.prior + 1e-6 for a, b in zip(none, ellipsoid, strict=True))
    assert sum(b.prior for b in ellipsoid) < sum(a.prior for a in none) - 1


def test_a_copy_rests_on_what_its_original_does(robot_of: Robots) -> None:
    """Mirrored in x, z: ranges are images, and what is reflected moves the other way."""
    names = ("FL", "FR")
    s = legs(robot_of, names, count=60, friction=NO_FRICTION, mirror=copies(names, joints=False))
    asked = ask(s, "ellipsoid", noise=0.3)
    signs = image(np.ones(PI_SIZE), (1, -1, 1))
    for i in range(1, LENGTH + 1):
        own, copy = of_body(s, f"FL_link{i}"), of_body(s, f"FR_link{i}")
        for k, sign in enumerate(signs):
            left, right = asked.answer.sources[own.start + k], asked.answer.sources[copy.start + k]
            assert (left.information_source, left.data, left.constraints) == (
                right.information_source,
                right.data,
                right.constraints,
            )
            ends = [None if end is None else sign * end for end in left.range][:: int(sign)]
            assert list(right.range) == pytest.approx(ends)
            assert right.moves_with == tuple((j, sign * tied) for j, tied in left.moves_with)
            low, high = right.range
            theta = asked.estimate.theta[copy.start + k]
            assert low is None or low <= theta + 1e-6
            assert high is None or theta <= high + 1e-6
    assert any(basis.range[0] is not None for basis in asked.answer.sources)
    assert any(basis.moves_with for basis in asked.answer.sources[PI_SIZE * LENGTH :])


def test_both_legs_data_count_for_a_copy(robot_of: Robots) -> None:
    """The right leg rests, so that alone its base parameters were unknown."""
    names = ("FL", "FR")
    s = legs(robot_of, names, count=60, friction=NO_FRICTION, mirror=copies(names, joints=False))
    Y = s.Y.copy()
    Y[LENGTH:] = 0.0
    sigma = np.repeat([0.01, 1.0], LENGTH)
    moved = ask(replace(s, Y=Y), "full", sigma=sigma)
    assert moved.answer.determined.all()
    copied = moved.answer.sources[PI_SIZE * LENGTH :]
    assert any(basis.information_source == "data" for basis in copied)


def coefficient(owner: str, name: str, scale: float | None) -> Coefficient:
    return Coefficient("rigid_body", owner, name, "", 0.0, scale)


SOME = (
    coefficient("thigh", "m", 2.0),
    coefficient("thigh", "mc_x", 0.5),
    coefficient("shank", "I_xx", 0.01),
    coefficient("knee", "viscous", None),
    coefficient("shank", "I_zz", 0.02),
)


@pytest.mark.parametrize(
    ("row", "own", "name", "order"),
    [
        ([0, 1.0, 0, 0, 0], 1, "thigh m·c_x", [1]),
        ([0.117, 0, 1.0, 0, -1.0], 2, "shank I_xx + 0.117 thigh mass − shank I_zz", [2, 0, 4]),
        ([0, 0, -0.25, 0, 1.0], 4, "shank I_zz − 0.25 shank I_xx", [4, 2]),
        ([3.0, 1.0, 1.0, 2.0, 1.0], 4, "shank I_zz + 3 thigh mass + 2 knee viscous + thigh m·c_x + …", [4, 0, 3, 1, 2]),
    ],
)
def test_combinations_by_name(row: list[float], own: int, name: str, order: list[int]) -> None:
    """Its own coefficient first, then what weighs most in units of sizes; where a size is not known, 1 stands in."""
    base = BaseParameters(np.array([0, own]), np.array([np.eye(5)[0], row]))
    terms = combination(base, 1, SOME)
    assert [k for k, _ in terms] == order
    assert [share for _, share in terms] == [row[k] for k in order]
    assert combination_name(base, 1, SOME) == name
