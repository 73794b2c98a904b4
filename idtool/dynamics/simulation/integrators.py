"""One step of time without a change of the dry friction's directions.

Shapes: n coordinates, W rollouts, as in `rollout_state`.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.simulation.forces import Forces
from idtool.dynamics.simulation.rollout_state import RolloutState, multiply, solve_acceleration

_GAMMA = 1 - np.sqrt(0.5)  # makes the implicit method L-stable


def runge_kutta(forces: Forces, start: RolloutState, h: Array) -> tuple[RolloutState, Array]:
    """Step of the classical method of order 4.

    Parameters
    ----------
    forces
        The forces on the mechanism.
    start
        Start of the step.
    h
        Its length, shape (W,) [s].

    Returns
    -------
    Its end, and the difference of its velocity from that of order 3 which has the acceleration at the end in place of
    the fourth one, shape (W,) [rad/s or m/s].
    """
    q, v = start.q, start.v
    half = h / 2
    a1 = start.a
    v2 = v + half * a1
    a2 = forces.state_after(start, half, q + half * v, v2).a
    v3 = v + half * a2
    a3 = forces.state_after(start, half, q + half * v2, v3).a
    v4 = v + h * a3
    a4 = forces.state_after(start, h, q + h * v3, v4).a
    q_end = q + h / 6 * (v + 2 * (v2 + v3) + v4)
    v_end = v + h / 6 * (a1 + 2 * (a2 + a3) + a4)
    end = forces.state_after(start, h, q_end, v_end)
    error = h / 6 * np.abs(end.a - a4).max(axis=0)
    return end, error


def linearly_implicit(forces: Forces, start: RolloutState, h: Array, damping: Array, stiffness: Array) -> RolloutState:
    """Step of the linearly implicit method ROS2, of order 2 whatever stiffness and damping it is given.

    Verwer, Spee, Blom & Hundsdorfer, A second-order Rosenbrock method applied to photochemical dispersion problems,
    SIAM J. Sci. Comput. 20 (1999), (2.6), for q' = v, v' = a.

    Parameters
    ----------
    forces
        The forces on the mechanism.
    start
        Start of the step.
    h
        Its length, shape (W,) [s].
    damping, stiffness
        Approximate decrease of the forces with velocities and positions, shape (W, n, n).
    """
    q, v, M, sticking = start.q, start.v, start.M, start.sticking
    g = _GAMMA * h
    K = g[:, None, None] * stiffness
    S = M + g[:, None, None] * (damping + K)
    drift = _GAMMA * multiply(M, forces.state_after(start, h, q, v).a - start.a)  # change of the forces with time alone
    dv1 = solve_acceleration(S, multiply(M, start.a) + drift - multiply(K, v), sticking)
    dq1 = v + g * dv1
    middle = forces.state_after(start, h, q + h * dq1, v + h * dv1)
    rest = v + h * dv1 - 2 * dq1
    dv2 = solve_acceleration(S, multiply(M, middle.a - 2 * dv1) - drift - multiply(K, rest), sticking)
    dq2 = rest + g * dv2
    return forces.state_after(start, h, q + h / 2 * (3 * dq1 + dq2), v + h / 2 * (3 * dv1 + dv2))
