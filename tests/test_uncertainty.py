"""Standard errors against repeated draws, and what the data determine against what is known by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from idtool.config import Config
from idtool.effects import build_effects
from idtool.model import Model
from idtool.reduction import Factor
from idtool.regressor import LinearModel
from idtool.signals import Motion
from idtool.uncertainty import uncertainty

Build = Callable[..., Model]

INERTIAL = '<inertial><mass value="1"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial>'
TWO_R = f"""<robot name="planar"><link name="base"/><link name="one">{INERTIAL}</link><link name="two">{INERTIAL}</link>
<joint name="a" type="continuous"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/></joint>
<joint name="b" type="continuous"><origin xyz="0.5 0 0"/><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
</joint>
</robot>"""


def random_motion(rng: np.random.Generator, joints: int, count: int) -> Motion:
    q, v, a = rng.normal(size=(3, joints, count))
    t = np.arange(count) * 1e-3
    return Motion(t, q, v, a, np.zeros_like(q), np.zeros_like(q), np.full(joints, 1e-3), 1e-3)


@pytest.fixture
def planar(build: Build) -> LinearModel:
    """Two links in the vertical plane, with friction."""
    model = build(TWO_R, ["a", "b"])
    return LinearModel(model.names, build_effects(model, Config()))


def test_a_planar_arm_tells_what_is_known_by_hand(planar: LinearModel, rng: np.random.Generator) -> None:
    """In the plane x-z a link's h_y and all but I_yy are never seen; link one's m, I_yy and h_x go with link two's m.

    Seen alone are link one's h_z and link two's h_x, h_z and I_yy, and the friction.
    """
    columns = planar.columns(random_motion(rng, 2, 400))
    result = uncertainty(planar, tuple(map(Factor.of, columns)), np.ones(2))
    seen = {(c.owner, c.name) for c, known in zip(planar.coefficients, result.identifiable, strict=True) if known}
    rigid = {("one", "mc_z"), ("two", "mc_x"), ("two", "mc_z"), ("two", "I_yy")}
    friction = {(joint, name) for joint in "ab" for name in ("viscous", "coulomb")}
    assert seen == rigid | friction
    assert np.isinf(result.standard_error[~result.identifiable]).all()


@pytest.mark.parametrize("redundancy", [1.0, 2.0])
def test_standard_errors_are_the_spread_of_repeated_fits(
    planar: LinearModel, rng: np.random.Generator, redundancy: float
) -> None:
    """Of rows that repeat each other ``redundancy`` times, no more is believed than there is."""
    columns = planar.columns(random_motion(rng, 2, 150))
    active, noise, p = planar.active(), np.array([0.3, 2.0]), len(planar.coefficients)
    rows = np.zeros((2, 150, p))
    for j, block in enumerate(columns):
        rows[j][:, active[j]] = block[:-1].T / noise[j]
    pinv = np.linalg.pinv(rows.reshape(-1, p), rcond=1e-10)
    repeats = int(redundancy)
    blocks = [np.repeat(block, repeats, axis=1) for block in columns]
    result = uncertainty(planar, tuple(Factor.of(block, redundancy) for block in blocks), noise)
    spread = np.std(pinv @ rng.normal(size=(300, 2000)), axis=1)
    known = result.identifiable
    np.testing.assert_allclose(result.standard_error[known], spread[known], rtol=0.08)
