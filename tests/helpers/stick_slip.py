"""Forward dynamics with dry friction by others' means: scipy's solve_ivp from one change of direction to the next.

After each change, every combination of directions that the joints at rest could take is tried until one fits: a joint
that is held takes no more friction than its level, one that slides starts with its friction against it.

Letters: q, v, a positions, velocities, accelerations (nv,), M mass matrix (nv, nv), h bias (nv,), s direction of the
friction (nv,): ±1 sliding, 0 held.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

# Where nothing moves, steps would grow until they miss what happens in them.
_EXACT: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12, "max_step": 0.01}
_ZERO = 1e-10  # rad/s: two joints whose velocities are nearer to zero than this stop together
_START = 1e-13  # rad/s: a joint that starts has this velocity, so that its next stop is a change of sign
_TIE = 1e-9  # by how much a condition may be missed, relative to the level


@dataclass
class StickSlip:
    """A machine of nv joints.

    Attributes
    ----------
    dynamics
        (q, v) to M, h.
    torque
        (t, q, v) to all torque but dry friction, (nv,).
    level
        v to the friction's level, (nv,); a joint has friction if its level is above zero at rest.
    changes
        When which joint took up which direction, in the order of time.
    """

    dynamics: Callable[[Array, Array], tuple[Array, Array]]
    torque: Callable[[float, Array, Array], Array]
    level: Callable[[Array], Array]
    changes: list[tuple[float, int, int]] = field(default_factory=list)

    def run(self, q: Array, v: Array, samples: Array) -> tuple[Array, Array]:
        """Positions and velocities at ascending times, the first of them the start; shape (nv, N)."""
        n, t = len(q), float(samples[0])
        rubbing = np.flatnonzero(self.level(np.zeros(n))).tolist()
        states = np.empty((2 * n, len(samples)))
        states[:, 0] = state = np.concatenate([q, v])
        s = self.directions(t, state)
        while t < samples[-1]:
            state[n:] += np.where((state[n:] == 0) & (s != 0), s * _START, 0.0)
            events = [self._event(j, s) for j in rubbing]
            leg = solve_ivp(self._slope(s), (t, samples[-1]), state, events=events, dense_output=True, **_EXACT)
            passed = (samples > t) & (samples <= leg.t[-1])
            if passed.any():
                states[:, passed] = leg.sol(samples[passed])
            t, state = float(leg.t[-1]), leg.y[:, -1].copy()
            if leg.status == 1:
                changing = [j for j, times in zip(rubbing, leg.t_events, strict=True) if len(times)]
                after = self._after(t, state, s, rubbing, changing)
                self.changes += [(t, int(j), int(after[j])) for j in np.flatnonzero(after != s)]
                s = after
        return states[:n], states[n:]

    def directions(self, t: float, state: Array, slipping: Mapping[int, int] = {}) -> Array:
        """The one combination of directions that the laws of friction allow; ``slipping`` ones are known already."""
        v = state[len(state) // 2 :]
        level = self.level(v)
        for choice in product(*(self._choices(j, v[j], level[j], slipping) for j in range(len(v)))):
            s = np.array(choice)
            a, pull = self.forces(t, state, s)
            holds, starts = np.abs(pull) <= level * (1 + _TIE), a * s >= -_TIE * level
            if np.where(s == 0, holds, starts | (v != 0) | (level == 0)).all():
                return s
        raise AssertionError(f"no direction of friction fits at {t} s")

    def _choices(self, j: int, v: float, level: float, slipping: Mapping[int, int]) -> Sequence[int]:
        if j in slipping:
            return [slipping[j]]
        if not level:
            return [1]
        return [int(np.sign(v))] if v else [0, 1, -1]

    def forces(self, t: float, state: Array, s: Array) -> tuple[Array, Array]:
        """Acceleration, and what friction has to hold."""
        q, v = state.reshape(2, -1)
        v = np.where(s == 0, 0.0, v)
        M, h = self.dynamics(q, v)
        force, free = self.torque(t, q, v) - h, s != 0
        a = np.zeros(len(q))
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (force - s * self.level(v))[free])
        return a, force - M @ a

    def _slope(self, s: Array) -> Callable[[float, Array], Array]:
        def slope(t: float, state: Array) -> Array:
            return np.concatenate([np.where(s == 0, 0.0, state[len(s) :]), self.forces(t, state, s)[0]])

        return slope

    def _event(self, j: int, s: Array) -> Callable[[float, Array], float]:
        """What falls to zero where a joint stops or slips."""

        def left(t: float, state: Array) -> float:
            if s[j]:
                return float(state[len(s) + j] * s[j])
            return float(self.level(np.zeros(len(s)))[j] - abs(self.forces(t, state, s)[1][j]))

        left.terminal, left.direction = True, -1  # type: ignore[attr-defined]
        return left

    def _after(self, t: float, state: Array, s: Array, rubbing: Sequence[int], changing: Sequence[int]) -> Array:
        """The directions after some joints stopped, which sets them to rest, or slipped."""
        v = state[len(s) :]
        for j in rubbing:
            if s[j] and (j in changing or v[j] * s[j] < _ZERO):
                v[j] = 0.0
        pull = self.forces(t, state, s)[1]
        return self.directions(t, state, {j: int(np.sign(pull[j])) for j in changing if not s[j]})
