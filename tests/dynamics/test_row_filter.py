"""Rows of the torque equation behind the elimination of contact forces, and how they change with the motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.quadruped import JOINTS, true_quadruped
from numpy.random import Generator
from standing_quadruped import quadruped_model, random_state

from idtool.data.filters import LowPass
from idtool.data.signals import Batch, Motion
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import build_effects
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.row_filter import ProjectedRows
from idtool.robot.config import EffectEntry

SAMPLES = 400
STEP = 1e-3  # s


def steady_motion(rng: Generator) -> Motion:
    """Joints and base that move slowly, with two feet on the ground."""
    motion = random_state(rng, SAMPLES)
    t = np.arange(SAMPLES) * STEP
    q, v, a = (0.3 * np.sin(rng.uniform(2, 9, (18, 1)) * t + rng.uniform(0, 6, (18, 1))) for _ in range(3))
    q[12:] = 0
    v[12:15] = 0
    contacts = motion.contacts
    assert contacts is not None
    level = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, SAMPLES))
    is_closed = np.zeros((5, SAMPLES), dtype=bool)
    is_closed[[0, 3]] = True
    closed = replace(contacts, world_to_base=level, is_closed=is_closed)
    return replace(motion, t=t, q=q, v=v, a=a, dt=STEP, contacts=closed)


def equation_of(folder: Path, rng: Generator, *effects: EffectEntry) -> LinearModel:
    model, config = quadruped_model(folder, true_quadruped(0), friction={"viscous": False, "coulomb": False})
    contacts = ContactModel(model, config.contacts, np.exp(rng.normal(size=18)))
    return LinearModel(model.names, build_effects(model, config.model_copy(update={"effects": effects})), {}, contacts)


@pytest.mark.parametrize("is_correlated", [False, True])
def test_columns_of_some_rows_are_filtered_as_those_of_all_rows(
    tmp_path: Path, rng: Generator, is_correlated: bool
) -> None:
    equation = equation_of(tmp_path, rng)
    if is_correlated:
        assert equation.contacts is not None
        correlation = np.corrcoef(rng.normal(size=(18, 40)))
        equation = replace(equation, contacts=equation.contacts.with_correlation(correlation))
    batch = Batch(steady_motion(rng), 0, 0, LowPass(40.0, 4, STEP, 5))
    row_filter = equation.row_filter(batch)
    assert isinstance(row_filter, ProjectedRows)
    for own_rows in ([4], [4, 13, 2]):
        columns = rng.normal(size=(len(own_rows), 3, SAMPLES))
        in_all_rows = np.zeros((18, 3, SAMPLES))
        in_all_rows[own_rows] = columns
        rows, filtered = row_filter.filter_columns(np.array(own_rows), columns)
        expected = row_filter.filter_rows(in_all_rows)
        np.testing.assert_allclose(filtered, expected[rows], atol=1e-12)
        others = np.setdiff1d(np.arange(18), rows)
        np.testing.assert_allclose(expected[others], 0, atol=1e-12)
        assert set(own_rows) <= set(rows)


def test_forces_that_explain_a_residual_are_those_that_made_it(tmp_path: Path, rng: Generator) -> None:
    contacts = equation_of(tmp_path, rng).contacts
    assert contacts is not None
    motion = steady_motion(rng)
    directions = contacts.unknown_directions(motion)
    forces = rng.normal(size=(len(directions), SAMPLES))
    forces[~directions.any(axis=1)] = 0  # open contacts
    residual = -np.einsum("kin,kn->in", directions, forces)
    np.testing.assert_allclose(contacts.unknown_forces(directions, residual), forces, atol=1e-5)


@pytest.mark.parametrize("joint", ["FL_thigh_joint", "RR_calf_joint"])
def test_change_by_a_position_includes_that_of_the_contacts(tmp_path: Path, rng: Generator, joint: str) -> None:
    """Of what is left behind the projector, which moves with the position too, by a joint of each standing leg."""
    generator_state = rng.bit_generator.state
    true = equation_of(tmp_path, rng)
    motion = steady_motion(rng)
    assert true.contacts is not None
    directions = true.contacts.unknown_directions(motion)
    forces = 50 * rng.normal(size=(len(directions), 1)) * np.ones(SAMPLES)
    of_bodies = -true.residual(motion, true.prior)
    motion = replace(motion, tau=of_bodies - np.einsum("kin,kn->in", directions, forces))

    offset = 1e-4
    rng.bit_generator.state = generator_state
    entry = EffectEntry(effect="encoder_offset", joint=joint, parameters={"offset": offset})
    displaced = equation_of(tmp_path, rng, entry)
    batch = Batch(motion, 0, 0, LowPass(40.0, 4, STEP, 5))
    row_filter = displaced.row_filter(batch)
    residual = row_filter.filter_rows(displaced.residual(motion, displaced.prior))

    model = LinearizedModel(true, true.prior, motion)
    np.testing.assert_allclose(model.residual, 0, atol=1e-4)
    zero = np.zeros(SAMPLES)
    change = model.torque_change_by_motion(JOINTS.index(joint), np.full(SAMPLES, offset), zero, zero)
    expected = true.row_filter(batch).filter_rows(-change)
    assert np.abs(expected).max() > 1e-4
    np.testing.assert_allclose(residual, expected, atol=0.02 * np.abs(expected).max())


def test_known_bodies_have_no_columns_and_their_torque_is_subtracted(tmp_path: Path, rng: Generator) -> None:
    friction = EffectEntry(effect="coulomb_friction", joint=JOINTS[0], parameters={"coulomb": 0.1})
    free = equation_of(tmp_path, rng, friction)
    for equation in (free, replace(free, contacts=None)):
        count = len(equation.effects[0].coefficients)  # of the bodies
        known = equation.prior[:count] * rng.uniform(0.5, 1.5, count)
        with_known = replace(equation, known_bodies=known)
        batch = Batch(steady_motion(rng), 0, 0, LowPass(40.0, 4, STEP, 5))
        own = with_known.filtered_columns(batch)
        rows = zip(own, equation.filtered_columns(batch), with_known.active(), equation.active(), strict=True)
        for own_block, block, own_active, active in rows:
            is_body = active < count
            np.testing.assert_array_equal(own_active, active[~is_body])
            np.testing.assert_allclose(own_block[:-1], block[:-1][~is_body], atol=1e-12)
            expected = block[-1] - known[active[is_body]] @ block[:-1][is_body]
            np.testing.assert_allclose(own_block[-1], expected, atol=1e-9)
        torque = with_known.filtered_torque(batch, equation.row_filter(batch))
        np.testing.assert_allclose(torque, [block[-1] for block in equation.filtered_columns(batch)], atol=1e-12)
