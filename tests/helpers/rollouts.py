"""Made-up simulations, as the report and the pages take them."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.estimation.dataset.envelope import Trace
from idtool.estimation.evaluation.rollouts import HORIZONS, RolloutError, RolloutEvaluation

Array = NDArray[np.float64]


def experiment_of(units: Mapping[str, str], dt: float = 0.005) -> Any:
    """What `simulation_report` asks of an experiment: the joints, the units of their torque, and one log's rate."""
    return SimpleNamespace(
        equation=SimpleNamespace(joints=tuple(units)),
        model=SimpleNamespace(units=dict(units), joint_names=tuple(units)),
        runs=(SimpleNamespace(signals=SimpleNamespace(log=SimpleNamespace(dt=dt))),),
    )


def rollouts_of(curves: Mapping[str, Array], closed: bool = False, logs: int = 1, **changes: Any) -> RolloutEvaluation:
    """A made-up simulation: curves of ``measured`` and models, whose errors are 0.1, 0.2, …, the baseline's 0.9."""
    nv, points = curves["measured"].shape
    t = np.repeat(np.arange(points // 2) + 0.5, 2) * 0.01
    errors = {}
    for i, name in enumerate([*list(curves)[1:], "baseline"]):
        error = 0.9 if name == "baseline" else 0.1 * (i + 1)
        after = {seconds: (np.full(nv, 10 * (error * seconds) ** 2), 10) for seconds in HORIZONS}
        squares = np.full(nv, 1000 * error**2)
        errors[name] = RolloutError(squares, 4 * squares, 1000, 1000, {} if closed else after)
    contents = {
        "kind": "closed_loop" if closed else "open_loop",
        "window": None if closed else 0.5,
        "errors": errors,
        "traces": tuple(Trace(f"log {i}", t, dict(curves)) for i in range(logs)),
        "windows": 10,
        "available": 12,
        "diverged": dict.fromkeys(list(curves)[1:], 0),
        "failed": {},
    }
    return RolloutEvaluation(**{**contents, **changes})
