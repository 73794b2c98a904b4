"""Curves for drawing, of bounded size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.evaluation.envelope import Trace
from idtool.estimation.evaluation.validation import Evaluation

_MOST_VALUES = 60_000  # that all curves of torque hold together: some 450 kB of text
_MOST_LOGS = 6  # that are drawn
_DIGITS = 5  # of a curve's largest value
_MOST_DECIMALS = 12
_LATE = 1e4  # s: later times are drawn as time since the curve's first whole second


def curves(evaluation: Evaluation, model: str, units: Mapping[str, str], position: bool = True) -> dict[str, Any]:
    """What the plots are drawn from, of bounded size.

    Parameters
    ----------
    evaluation
        Its traces are drawn, the first few.
    model
        Whose torque is the ``predicted`` one.
    units
        Unit of the torque by joint, in the order of the curves.
    position
        Whether the joints' positions are drawn too, where the traces have them.

    Returns
    -------
    ``logs``, each with its name, times ``t`` [s] after ``start`` and ``joints``, each of these with its name, unit and
    curves; ``omitted``, the number of logs that are not drawn.
    """
    names = {"measured": "measured", "predicted": model, "residual": "residual", "prior": "prior"}
    names |= {"position": "q"} if position else {}
    return drawn(evaluation.traces, names, units, _MOST_VALUES)


def drawn(traces: Sequence[Trace], names: Mapping[str, str], units: Mapping[str, str], most: int) -> dict[str, Any]:
    """Traces as `curves` returns them.

    Parameters
    ----------
    traces
        One a log; the first few are drawn.
    names
        A curve's name on the page to that in the trace; one that a trace has not is left out.
    units
        By joint, in the order of the curves.
    most
        Values that all curves hold together.
    """
    logs = []
    values = sum(x.size for trace in traces[:_MOST_LOGS] for x in trace.curves.values())
    stretches = max(math.ceil(values / most), 1)
    for trace in traces[:_MOST_LOGS]:
        start = math.floor(trace.t[0]) if abs(trace.t[0]) > _LATE else 0
        coarse = {name: merged(trace.curves[k], stretches) for name, k in names.items() if k in trace.curves}
        joints = [
            {"name": joint, "unit": unit, **{name: rounded(x[j]) for name, x in coarse.items()}}
            for j, (joint, unit) in enumerate(units.items())
        ]
        t = merged(trace.t[None] - start, stretches)[0]
        logs.append({"name": trace.name, "start": start, "t": t.round(5).tolist(), "joints": joints})
    return {"logs": logs, "omitted": len(traces) - len(logs)}


def merged(x: Array, count: int) -> Array:
    """The least and greatest value of ``count`` stretches at a time; NaN only where all are.

    Where the curve falls, the greatest comes first, so that a smooth one is drawn smooth.

    Parameters
    ----------
    x
        Pairs of values, shape (rows, 2 stretches).
    count
        How many to take together.

    Returns
    -------
    Shape (rows, 2 ceil(stretches / count)).
    """
    short = -x.shape[1] % (2 * count)
    blocks = np.pad(x, [(0, 0), (0, short)], constant_values=np.nan).reshape(len(x), -1, 2 * count)
    low, high = np.fmin.reduce(blocks, axis=-1), np.fmax.reduce(blocks, axis=-1)
    around = np.pad(low + high, [(0, 0), (1, 1)], mode="edge")
    falls = around[:, 2:] < around[:, :-2]
    pairs = np.stack([np.where(falls, high, low), np.where(falls, low, high)], axis=-1)
    return np.asarray(pairs.reshape(len(x), -1))


def rounded(x: Array) -> list[float | None]:
    """A curve to five digits of its largest value; None breaks the line."""
    largest = float(np.fmax.reduce(np.abs(x), initial=0.0))
    decimals = _DIGITS - 1 - math.floor(math.log10(largest)) if largest else 0
    return [None if math.isnan(value) else value for value in x.round(min(decimals, _MOST_DECIMALS)).tolist()]
