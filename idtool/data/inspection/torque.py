"""The source of a logged torque: a sensor, or the command.

Letters: q position [rad or m], v velocity [rad/s or m/s], tau torque or force [N·m or N], N samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.number_text import short_number
from idtool.data.inspection.records import Signal, TorqueSource

Runs = Mapping[str, Sequence[Array]]

_MAX_LAW_RESIDUAL = 1e-3  # of tau's deviation: a control law's rounding leaves no more
_DELAYS = (0, 1, 2)  # samples by which the law may act late
_MIN_EXCITATION = 1e-2  # an acceleration this close to a line in q and v makes any torque look like a law
_MIN_SENSOR_NOISE = 1e-5  # of tau's deviation: no sensor is that quiet, unless it is smoothed
_MIN_SHARED_NOISE = 0.95  # share of tau's fast changes that those of q and v explain
_MAX_SHARED_NOISE = 0.7
_MAX_FAST_CHANGE = 2.0  # fast changes over noise
_MAX_STALE_SHARE = 0.3  # share of repeated values
_MIN_SAMPLES = 256  # samples of a stretch
_WINDOW = 50  # samples
_ROUNDING_NOISE = 1.5 / np.sqrt(12)  # noise below this many steps may be the rounding's


def torque_source(runs: Runs, tau: Signal) -> TorqueSource:
    """Tell a measured torque from a commanded one.

    Commanded: tau is a linear function of q, v and their commands, or its noise is theirs. Measured: it carries noise
    of its own. Where neither is plain, as with a torque without noise, held for several samples or rounded coarsely,
    the answer is ``unknown``.

    Parameters
    ----------
    runs
        The joint's signals by name; of each its stretches without a gap, of shape (N,).
    tau
        The summary of the torque.
    """
    if max(len(x) for x in runs["tau"]) < _MIN_SAMPLES:
        return TorqueSource("unknown", "no segment without gaps is long enough to decide")
    law = _control_law(runs, tau)
    if law is not None:
        return TorqueSource("commanded", law)
    stale = tau.stale or 0.0
    if stale > _MAX_STALE_SHARE:
        repeats = f"{100 * stale:.0f} % of its values repeat the previous one"
        return TorqueSource("unknown", f"{repeats}: the sensor or the controller is slow")
    spread = float(np.std(np.concatenate(runs["tau"])))
    if tau.step is None and tau.noise < _MIN_SENSOR_NOISE * spread:
        return TorqueSource("unknown", "it has no noise: it was computed, or a sensor's torque was smoothed")
    if tau.step is not None and tau.noise < _ROUNDING_NOISE * tau.step:
        return TorqueSource("unknown", f"its noise is smaller than its resolution of {short_number(tau.step)}")
    changes = np.concatenate([np.diff(x, 2) for x in runs["tau"]])
    fast_change = 1.4826 * float(np.median(np.abs(changes))) / np.sqrt(6)
    if fast_change > _MAX_FAST_CHANGE * tau.noise:
        return TorqueSource("unknown", "it changes too fast between samples for its noise to be estimated")
    share = _shared_noise(runs)
    if share > _MIN_SHARED_NOISE:
        return TorqueSource(
            "commanded", f"{100 * share:.0f} % of its noise comes from q and v, as under feedback control"
        )
    if share < _MAX_SHARED_NOISE:
        return TorqueSource("measured", f"it has its own noise, {short_number(tau.noise, 2)} rms")
    return TorqueSource("unknown", f"{100 * share:.0f} % of its noise comes from q and v")


def _control_law(runs: Runs, tau: Signal) -> str | None:
    """The control law that tau follows to the last digit, in words; None if it follows none."""
    names = [name for name in ("q", "v", "qcmd", "vcmd") if name in runs]
    if _is_poorly_excited(runs):
        return None
    for delay in _DELAYS:
        rows = _law_rows(runs, names, delay)
        columns, torque = rows[:, :-1], rows[:, -1]
        is_free = (torque > tau.minimum) & (torque < tau.maximum)  # a law is cut off at the drive's limits
        columns, torque = columns[is_free], torque[is_free]
        if len(torque) < _MIN_SAMPLES:
            return None
        gains, residual = _fit_line(columns, torque)
        rounding = 0.4 * (tau.step or 0.0) / torque.std()
        if residual < max(_MAX_LAW_RESIDUAL, min(rounding, 20 * _MAX_LAW_RESIDUAL)):
            terms = " ".join(f"{gain:+.4g} {name}" for gain, name in zip(gains, names, strict=True))
            late = f" with a delay of {delay} sample period{'s' if delay > 1 else ''}" if delay else ""
            return (
                f"it equals {terms} + constant{late}, to within {short_number(residual, 1)} of its standard deviation"
            )
    return None


def _law_rows(runs: Runs, names: Sequence[str], delay: int) -> Array:
    """The named signals, ``delay`` samples earlier, and tau, thinned to a bounded number of rows."""
    rows = []
    for *signals, tau in zip(*(runs[name] for name in names), runs["tau"], strict=True):
        columns = [x[: len(x) - delay] for x in signals]
        rows.append(np.stack([*columns, tau[delay:]], axis=1))
    stride = max(sum(len(r) for r in rows) >> 14, 1)
    return np.concatenate([r[::stride] for r in rows])


def _fit_line(columns: Array, x: Array) -> tuple[Array, float]:
    """Gains of the least-squares fit of x by the columns and a constant, and its residual's deviation over x's."""
    centred = columns - columns.mean(axis=0)
    gains = np.linalg.lstsq(centred, x - x.mean(), rcond=None)[0]
    residual = np.std(x - centred @ gains)
    return gains, float(residual / max(np.std(x), np.finfo(float).tiny))


def _is_poorly_excited(runs: Runs) -> bool:
    """True if the acceleration is itself a line in q and v, as in a single sine."""
    q = np.concatenate([x[1:-1] for x in runs["q"]])
    v = np.concatenate([x[2:] - x[:-2] for x in runs["q"]])
    a = np.concatenate([np.diff(x, 2) for x in runs["q"]])
    _, residual = _fit_line(np.stack([q, v], axis=1), a)
    return residual < _MIN_EXCITATION


def _shared_noise(runs: Runs) -> float:
    """Share of the power of tau's fast changes that those of q and v, now and a sample or two ago, explain.

    Second differences, in windows so short that the gain of any feedback is as good as constant; the median window, as
    dry friction jumps in some.
    """
    names = [name for name in ("q", "v") if name in runs]
    shares = []
    for *signals, tau in zip(*(runs[name] for name in names), runs["tau"], strict=True):
        columns = []
        for x in signals:
            change = np.diff(x, 2)
            columns += [change[2 - delay : len(change) - delay] for delay in _DELAYS]
        columns.append(np.diff(tau, 2)[2:])
        count = len(columns[0]) // _WINDOW
        windows = np.stack(columns, axis=1)[: count * _WINDOW].reshape(count, _WINDOW, len(columns))
        torque_windows = windows[:, :, -1]
        Q, _ = np.linalg.qr(windows[:, :, :-1])
        explained = np.sum(np.einsum("wsc,ws->wc", Q, torque_windows) ** 2, axis=1)
        total = np.sum(torque_windows**2, axis=1)
        shares.append(explained / np.maximum(total, np.finfo(float).tiny))
    chance = (len(columns) - 1) / _WINDOW
    return float((np.median(np.concatenate(shares)) - chance) / (1 - chance))
