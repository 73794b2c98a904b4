"""Instruments: a motion close to the measured one that is independent of the noise in q and v.

Simulated under the logged command (Janot, Vandanjon & Gautier 2014), or the measured one smoothed where there is none.
`two_stage` says what they are for.

Letters: nv joints; N samples; m_j coefficients of joint j's equation; Z_j, Y_j (n, m_j) rows of the torque equation
along the instruments' motion and the measured one, tau_j (n,) torque, all through the same low-pass. Units: SI.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.processes import shared_among_processes
from idtool.data.batches import BatchSpan
from idtool.data.filters import convolve, zero_phase_butterworth
from idtool.data.logs import JointLog
from idtool.data.power_density import power_density
from idtool.data.signals import Batch, Signals
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import Window
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.experiment import Experiment, Progress, Rows, Run
from idtool.estimation.evaluation.simulated_log import under_controller

Kind = Literal["closed_loop", "smoothed"]

_STANDS_OUT = 30.0  # power relative to the noise's, from which on it is motion
_CUTOFF_RATIO = 1.5  # of a smoothing's cut-off to the highest frequency of the motion
_LINES = 40  # of a spectrum, up to the band
_ORDER = 4  # of the smoothing, one way
_ALTERNATIVE = "or use least squares (--method ls)"


@dataclass(frozen=True)
class Instruments:
    """The motion that Z is taken along.

    Attributes
    ----------
    run
        The log that it belongs to, sample by sample.
    signals
        The motion.
    kind
        ``closed_loop``: simulated under the logged command, which knows nothing of the sensors' noise but for the
        state in which it begins, and a stable loop forgets that. ``smoothed``: the measured motion through a low-pass,
        as low as the motion allows. Noise below its cut-off is in Z as it is in Y and still biases: of what white noise
        on q does by way of a, (cut-off / band)⁵ is left; of what it does by way of v, (cut-off / band)³.
    cutoff_hz
        The smoothing's, per joint, shape (nv,); infinite: none.
    """

    run: Run
    signals: Signals
    kind: Kind
    cutoff_hz: Array


class _Motion(NamedTuple):
    """The motion of instruments as a log; other attributes as in `Instruments`."""

    log: JointLog
    kind: Kind
    cutoff_hz: Array


def instruments(experiment: Experiment, theta: Array, progress: Progress) -> list[Instruments]:
    """The instruments' motion along the training part of each log that has one.

    Simulated where there are a command and a controller for every joint, even if torque was logged too: a feed-forward
    that the configuration does not know makes the simulation follow less closely, not less free of noise. Elsewhere
    the measured motion is smoothed: simulated under the measured torque it would run away, and whatever keeps it from
    that brings the noise back.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients of the model that is simulated, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    One for each log with a training part, in their order.

    Raises
    ------
    ModelError
        If the model cannot be simulated, or runs away; or if the base moves, or there are contacts or wrench sensors.
    """
    if not experiment.has_only_joints:
        raise ModelError("--method iv", "needs a fixed base, no contacts and no wrench_sensors; use least squares")
    runs = [run for run in experiment.runs if run.train]

    def motion_along(run: Run, tell: Progress) -> _Motion:
        return _motion(experiment, run, theta, tell)

    motions = shared_among_processes(motion_along, runs, progress)
    return [_along(experiment, run, motion) for run, motion in zip(runs, motions, strict=True)]


def _motion(experiment: Experiment, run: Run, theta: Array, progress: Progress) -> _Motion:
    """The motion along a log: simulated or smoothed."""
    signals, controller = run.signals, experiment.config.controller
    if controller is not None and all(
        signals.log.has("qcmd", name) and controller.kp_of(name) is not None for name in signals.joints
    ):
        log = _simulated_log(experiment, run, theta, progress)
        return _Motion(log, "closed_loop", np.full(len(signals.joints), np.inf))
    q_in_motion = signals.channels.signal("q", signals.channels.longest_stretch(signals.channels.stretches()))
    cutoff = np.array([smoothing(q, signals.log.dt, signals.band_hz) for q in q_in_motion])
    return _Motion(_smoothed_log(signals, cutoff), "smoothed", cutoff)


def _along(experiment: Experiment, run: Run, motion: _Motion) -> Instruments:
    """Instruments with a motion along a log."""
    signals = run.signals
    config = experiment.config.model_copy(update={"velocity": "differentiated"})  # without noise as good as measured
    instrument_signals = Signals(motion.log, signals.joints, config, batch_samples=signals.batch_samples)
    # Where Z's sign must not be trusted is where Y's is lost in noise.
    instrument_signals.velocity_deadband = signals.velocity_deadband
    return Instruments(run, instrument_signals, motion.kind, motion.cutoff_hz)


def instrumented_rows(experiment: Experiment, made: Instruments) -> Rows:
    """Rows of a log's training part beside those of its instruments, batch after batch.

    Parameters
    ----------
    experiment
        Model and data.
    made
        The instruments of one of its logs.

    Returns
    -------
    Per joint the columns of Z_j, of Y_j, and the torque, shape (2 m_j + 1, n); and which of the n samples count, shape
    (n,): those in which the columns of Z_j are defined. To choose by those of Y_j would be to choose by the noise.
    """
    run, equation = made.run, experiment.equation

    def stacked_rows(batch: Batch, span: BatchSpan) -> tuple[list[Array], list[Mask]]:
        Y, _ = equation.filtered_rows(batch)
        Z, defined = equation.filtered_rows(made.signals.batch(span, made.signals.low_pass))
        return [np.concatenate([z[:-1], y]) for z, y in zip(Z, Y, strict=True)], defined

    return run.signals.batches(run.train).map_with_span(stacked_rows)


def instrumented_blocks(experiment: Experiment, made: Sequence[Instruments], progress: Progress) -> tuple[Blocks, ...]:
    """The training data as R-factors of [Z_j, Y_j, tau_j] of consecutive blocks, log by log.

    Raises
    ------
    LogError
        If a joint has no sample that counts.
    """
    of_run = {id(each.run): each for each in made}
    columns = instrumented_columns(experiment)
    return experiment.blocks(lambda run: instrumented_rows(experiment, of_run[id(run)]), progress, "reading", columns)


def instrumented_columns(experiment: Experiment) -> list[int]:
    """Number of columns of each joint's [Z_j, Y_j]."""
    return [2 * count for count in experiment.columns_of_coefficients]


def smoothing(q: Array, dt: float, band_hz: float) -> float:
    """Cut-off below which a motion stands out of its noise [Hz]; infinite where it fills the band.

    Power above twice the band is taken for white noise on q.

    Parameters
    ----------
    q
        Positions, shape (N,).
    dt
        Sample time.
    band_hz
        The band.
    """
    a = np.diff(q, 2)  # whitens the motion, whose power at 1 Hz is a million times that at 30 Hz
    f, power = power_density(a, dt, min(len(a), round(_LINES / band_hz / dt)), "median")
    f, power = f[1:], power[1:]
    power = power / (2 * np.sin(np.pi * f * dt)) ** 4  # of q
    noise = np.median(power[f > 2 * band_hz]) if f[-1] > 2 * band_hz else 0.0
    stands_out = f[(power > _STANDS_OUT * noise) & (f <= band_hz)]
    highest = _CUTOFF_RATIO * float(stands_out.max(initial=f[0]))
    return highest if highest < band_hz else np.inf


def _smoothed_log(signals: Signals, cutoff: Array) -> JointLog:
    """A log with motion and torque through low-passes, joint by joint, and without velocities."""
    channels, dt = signals.channels, signals.log.dt

    def read(name: str, part: slice) -> Array:
        x = channels.signal(name, part)
        for row, hz in zip(x, cutoff if name in ("q", "tau") else [], strict=False):
            if np.isfinite(hz) and np.isfinite(row).all():
                row[:] = _low_passed(row, hz, dt)
        return x

    return _even_log(signals, channels.stretches(), [name for name in signals.log.signals if name != "v"], read)


def _low_passed(x: Array, cutoff: float, dt: float) -> Array:
    """A signal through a zero-phase low-pass, continued by its images in its ends, shape (N,).

    Cut-off [Hz], sample time [s].
    """
    kernel = zero_phase_butterworth(_ORDER, cutoff * dt)
    reach = len(kernel) // 2
    continued = np.pad(x, reach, mode="reflect", reflect_type="odd")
    return convolve(continued, kernel / kernel.sum())[2 * reach : 2 * reach + len(x)]


def _simulated_log(experiment: Experiment, run: Run, theta: Array, progress: Progress) -> JointLog:
    """The model under the logged command, from the measured state at the beginning of each stretch."""
    log, signals = run.signals.log, run.signals
    if not signals.controller.joints.all():
        signals = Signals(under_controller(log), signals.joints, experiment.config)
    mechanism = experiment.equation.mechanism(experiment.model, theta)
    simulated: dict[tuple[str, int], Array] = {}  # by signal and first sample
    parts = _simulated_parts(run)
    windows = [Window(signals, part) for part in parts]
    stage = f"simulating {log.path.name}"
    try:
        for batch in simulate(mechanism, windows, lambda share: progress(stage, share)):
            if batch.diverged.any():
                raise ModelError(mechanism.model.robot.path, "diverges under the logged command; check the controller")
            for w, window in enumerate(batch.windows):
                start, length = window.part.start, len(window)
                simulated["q", start] = batch.q[:, w, :length]
                simulated["tau", start] = batch.tau[:, w, :length]
    except ModelError as error:
        raise ModelError(error.where, f"{error.what}, {_ALTERNATIVE}") from None
    return _even_log(run.signals, parts, ["q", "tau"], lambda name, part: simulated[name, part.start])


def _simulated_parts(run: Run) -> list[slice]:
    """The training part, from the beginning of each stretch to the samples that derivatives at its end need."""
    parts = []
    for part in run.train:
        usable = next(s for s in run.signals.ranges if s.start <= part.start < s.stop)
        stretch = next(s for s in run.signals.channels.stretches() if s.start <= part.start < s.stop)
        parts.append(slice(stretch.start, part.stop + stretch.stop - usable.stop))
    return parts


def _even_log(signals: Signals, parts: list[slice], names: list[str], read: Callable[[str, slice], Array]) -> JointLog:
    """A log of the model's joints with the samples of another one, on its even clock; NaN beside the parts."""
    log = signals.log
    t = log.t.copy()
    samples = {name: np.full((len(log), len(signals.joints)), np.nan) for name in names}
    for part in parts:
        t[part] = signals.channels.times(part)[0] + log.dt * np.arange(part.stop - part.start)
        for name, x in samples.items():
            x[part] = read(name, part).T
    return JointLog(log.path, signals.joints, t, samples, tuple(parts), log.dt)
