"""Recordings of the quadruped of benchmarks/ground in MuJoCo; each motion is simulated once for all tests."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from ground.logs import RATE, Recording, Sensors, recording_of, simulated_states
from ground.plant import Physics
from ground.quadruped import true_quadruped
from ground.robot import Array
from ground.robots import motion

TRUTH = true_quadruped(0)
LONGEST = 5.0  # s


def record_quadruped(
    kind: str, seconds: float, seed: int = 0, sensors: Sensors | None = None, slippery_foot: str | None = None
) -> Recording:
    """Recording of the first seconds, at most 5, of a motion of a kind; a foot may stand on ice."""
    assert seconds <= LONGEST
    samples = slice(round(seconds * RATE))
    states = {name: x[samples] for name, x in _states(kind, seed, slippery_foot).items()}
    return recording_of(TRUTH, states, sensors or Sensors(), seed)


@cache
def _states(kind: str, seed: int, slippery_foot: str | None) -> Mapping[str, Array]:
    physics = Physics(slippery_feet={slippery_foot: 0.05} if slippery_foot else {})
    states = simulated_states(TRUTH, motion(TRUTH, kind, LONGEST, seed), LONGEST, physics)
    for x in states.values():
        x.flags.writeable = False  # they are those of all tests
    return states
