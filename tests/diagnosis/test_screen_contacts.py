"""Screening on a floating base: unknown contact forces take a column from one row to others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from ground.logs import config_text, write_csv
from ground.robot import urdf_text
from numpy.typing import NDArray
from prescribed_motions import silent
from quadruped_recordings import TRUTH, record_quadruped

import idtool
from idtool.api.data import load_experiment
from idtool.common.safe_yaml import parse_yaml
from idtool.data.signals import Motion
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.screen import screen_pairs, screen_probes, with_free_parameters
from idtool.diagnosis.trial import with_fixed_inertia
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> LinearizedFit:
    """The true robot with fixed inertia on a log in which it sways."""
    folder = tmp_path_factory.mktemp("quadruped")
    write_csv(folder / "stand.csv", record_quadruped("stand", 3.0))
    (folder / "true.urdf").write_text(urdf_text(TRUTH))
    config = dict(parse_yaml(Path("quadruped.yaml"), config_text(TRUTH).encode()))
    model = idtool.Model(folder / "true.urdf", config=config)
    experiment = load_experiment(model, folder / "stand.csv", holdout=0.0)
    return linearize_fit(with_fixed_inertia(experiment), silent)


def torque_of(kind: int, motion: Motion) -> Array:
    """Made-up torque on all rows, shape (18, N)."""
    phase = np.arange(18)[:, None] * (kind + 1)
    return np.asarray(np.sin(7 * (kind + 1) * motion.t + phase))


def probe_of(kind: int) -> Probe:
    """A probe that acts on all rows, by itself in the equation of each."""

    def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
        return {row: own[None] for row, own in enumerate(torque_of(kind, motion))}

    return Probe(f"made up {kind}", None, None, columns, 1, lambda c, information: None)


def normal_equations(fit: LinearizedFit, kinds: list[int]) -> tuple[Array, Array]:
    """Information and score of made-up torques once the model's own directions are eliminated, from dense rows."""
    size = len(fit.information)
    P, CC, h = np.zeros((size, len(kinds))), np.zeros((len(kinds), len(kinds))), np.zeros(len(kinds))
    equation = fit.experiment.equation
    for run in fit.experiment.runs:
        for batch in fit.experiment.batches(run, held_out=False):
            row_filter = equation.row_filter(batch, fit.row_equation, fit.reversal_margin)
            made_up = np.stack([torque_of(kind, batch.motion) for kind in kinds], axis=1)
            columns = row_filter.filter_rows(made_up)
            blocks = equation.filtered_columns(batch, row_filter)
            for row, (active, block) in enumerate(zip(equation.active(), blocks, strict=True)):
                weight = (row_filter.shares[row] > 0) / fit.noise[row]
                Q = fit.directions[active].T @ (block[:-1] * weight)
                e = (block[-1] - fit.theta[active] @ block[:-1]) * weight
                C = columns[row] * weight
                P += Q @ C.T
                CC += C @ C.T
                h += C @ e
    X = np.linalg.solve(fit.information, P)
    return CC - P.T @ X, h


def test_probe_on_several_rows_has_the_coefficient_of_dense_rows(fit: LinearizedFit) -> None:
    screened = screen_probes(fit, [probe_of(0), probe_of(1)], silent)
    for kind, own in enumerate(screened):
        information, score = normal_equations(fit, [kind])
        assert own.failure is None
        np.testing.assert_allclose(own.c, np.linalg.solve(information, score), rtol=1e-6)
        np.testing.assert_allclose(own.information, information, rtol=1e-6)


def test_pair_of_such_probes_has_those_of_dense_rows(fit: LinearizedFit) -> None:
    (pair,) = screen_pairs(fit, [probe_of(0), probe_of(1)], [(0, 1)], silent)
    information, score = normal_equations(fit, [0, 1])
    np.testing.assert_allclose(pair.c, np.linalg.solve(information, score), rtol=1e-6)


def test_such_a_probe_has_no_coefficient_once_its_parameter_is_free(fit: LinearizedFit) -> None:
    free = with_free_parameters(fit, probe_of(0), silent)
    assert free is not fit
    (again,) = screen_probes(free, [probe_of(0)], silent)
    assert np.abs(again.c).max() == 0
