"""Effects on two joints without weight or friction: entries, and their torque."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from arms import JOINTS
from numpy.typing import NDArray
from robots import chain, joint

from idtool.data.signals import Motion
from idtool.dynamics.effects import Effect, build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]

TWO = chain(joint("shoulder", "revolute", "l0", "l1"), joint("elbow", "revolute", "l1", "l2"))


def entry(effect: str, at: str = "elbow", **parameters: Any) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, "joint": at, "parameters": parameters}


def effects_of(build: Build, *entries: dict[str, Any], text: str = TWO) -> tuple[Effect, ...]:
    """The effects of entries, for a robot without friction."""
    friction = {"viscous": False, "coulomb": False}
    config = {"friction": friction, "effects": list(entries)}
    return build_effects(build(text, JOINTS, **config), parse_config(config, ""))[1:]


def random_motion(count: int = 500) -> Motion:
    """Random motion of two joints at random positions and torques, never slow."""
    q, a, tau = np.random.default_rng(1).normal(size=(3, 2, count))
    v = np.stack([np.linspace(0.3, 4, count), -np.linspace(4, 0.3, count)])
    return Motion(np.arange(count) * 1e-2, q, v, a, 5 * tau, 5 * tau, np.full(2, 1e-3), 1e-2)


def torque(build: Build, motion: Motion, *entries: dict[str, Any]) -> Array:
    """Torque of the effects alone, shape (2, N)."""
    linear = LinearModel(JOINTS, effects_of(build, *entries))
    return linear.torque(motion, linear.prior)
