"""The paper's leg (sample_logs/leg.*) and a stopwatch, for the other benchmarks."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

SAMPLES = Path(__file__).parents[1] / "sample_logs"
URDF = SAMPLES / "leg.urdf"
CONFIG = SAMPLES / "leg.yaml"
LOG = SAMPLES / "leg_train.mcap"


def leg_experiment(log: Path = LOG, holdout: float = 0.0) -> Experiment:
    """Experiment with the leg and one log of it."""
    return prepare(read_robot(URDF), read_config(CONFIG), [log], holdout=holdout)


def median_times(repetitions: int, *actions: Callable[[], object]) -> list[float]:
    """Median wall times of actions that take turns [s]."""
    seconds: list[list[float]] = [[] for _ in actions]
    for _ in range(repetitions):
        for k, action in enumerate(actions):
            started = time.perf_counter()
            action()
            seconds[k].append(time.perf_counter() - started)
    return [statistics.median(times) for times in seconds]
