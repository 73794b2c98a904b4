"""One step of time in which the dry friction's directions stay as they are.

Shapes: n coordinates, W rollouts, as in `moment`.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.simulation.forces import Forces
from idtool.dynamics.simulation.rollout_state import RolloutState, multiply, solve_acceleration

_GAMMA = 1 - np.sqrt(0.5)  # makes the implicit method L-stable


def runge_kutta(forces: Forces, start: RolloutState, h: Array) -> tuple[RolloutState, Array]:
    """A step of the classical method of order 4.

    Parameters
    ----------
    forces
        What acts.
    start
        Where it begins.
    h
        Its length, shape (W,) [s].

    Returns
    -------
    Its end, and by how much its velocity differs from that of order 3 which has the acceleration at the end in place of
    the fourth one, shape (W,) [rad/s or m/s].
    """
    q, v, half = start.q, start.v, h / 2
    v2 = v + half * start.a
    a2 = forces.state_after(start, half, q + half * v, v2).a
    v3 = v + half * a2
    a3 = forces.state_after(start, half, q + half * v2, v3).a
    v4 = v + h * a3
    a4 = forces.state_after(start, h, q + h * v3, v4).a
    v5 = v + h / 6 * (start.a + 2 * (a2 + a3) + a4)
    end = forces.state_after(start, h, q + h / 6 * (v + 2 * (v2 + v3) + v4), v5)
    return end, h / 6 * np.abs(end.a - a4).max(axis=0)


def linearly_implicit(forces: Forces, start: RolloutState, h: Array, damping: Array, stiffness: Array) -> RolloutState:
    """A step of the linearly implicit method ROS2, of order 2 whatever the stiffness and damping it is told.

    Verwer, Spee, Blom & Hundsdorfer, A second-order Rosenbrock method applied to photochemical dispersion problems,
    SIAM J. Sci. Comput. 20 (1999), (2.6), for q' = v, v' = a.

    Parameters
    ----------
    forces
        What acts.
    start
        Where it begins.
    h
        Its length, shape (W,) [s].
    damping, stiffness
        By how much the forces fall with velocities and positions, about, shape (W, n, n).
    """
    q, v, M, held = start.q, start.v, start.M, start.sticking
    g = _GAMMA * h
    K = g[:, None, None] * stiffness
    S = M + g[:, None, None] * (damping + K)
    drift = _GAMMA * multiply(M, forces.state_after(start, h, q, v).a - start.a)  # of the forces by themselves
    dv1 = solve_acceleration(S, multiply(M, start.a) + drift - multiply(K, v), held)
    dq1 = v + g * dv1
    middle = forces.state_after(start, h, q + h * dq1, v + h * dv1)
    rest = v + h * dv1 - 2 * dq1
    dv2 = solve_acceleration(S, multiply(M, middle.a - 2 * dv1) - drift - multiply(K, rest), held)
    dq2 = rest + g * dv2
    return forces.state_after(start, h, q + h / 2 * (3 * dq1 + dq2), v + h / 2 * (3 * dv1 + dv2))
