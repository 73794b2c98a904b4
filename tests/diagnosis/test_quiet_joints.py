"""Joints with only noise in their residual, of an arm of which only the first joint lacks something."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from disturbed import NOISE, experiment_of, nothing, silent, torque_on_joint
from numpy.typing import NDArray

from idtool.common.exceptions import SolverError
from idtool.diagnosis import quiet_joints as module
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.quiet_joints import quiet_joints

Array = NDArray[np.float64]
Torque = Callable[[Array, Array, Array, Array], Array]

BOTH = frozenset({"j1", "j2"})


def quiet_with(folder: Path, torque: Torque | None) -> frozenset[str]:
    hidden = nothing if torque is None else torque_on_joint(0, torque)
    return quiet_joints(linearize_fit(experiment_of(folder, hidden), silent), silent)


def test_white_noise_is_quiet(tmp_path: Path) -> None:
    assert quiet_with(tmp_path, None) == BOTH


@pytest.mark.parametrize(
    "torque",
    [
        lambda t, q, v, tau: 0.5 * NOISE * np.sign(v),
        lambda t, q, v, tau: NOISE * np.sin(2 * np.pi * 30 * t),  # above the motion's frequencies
        lambda t, q, v, tau: 0.2 * np.maximum(q - 0.7, 0) * (t < 8),  # only in the training data
    ],
    ids=["friction below the noise", "quick", "only in training"],
)
def test_what_is_missing_is_not_quiet(tmp_path: Path, torque: Torque) -> None:
    assert quiet_with(tmp_path, torque) == {"j2"}


def test_without_a_noise_floor_no_joint_is_quiet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: Any, **options: Any) -> Any:
        raise SolverError("solver", "as this test wants it")

    monkeypatch.setattr(module, "estimate_noise_floor", fail)
    assert quiet_with(tmp_path, None) == frozenset()
