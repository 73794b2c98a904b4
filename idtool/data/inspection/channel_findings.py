"""Findings on one channel of a joint: missing, not filled, clipped, stale, frozen, too coarse."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.names import count_text
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.inspection.records import FrozenStretches, InspectedJoint, Signal

MAX_STUCK_SHARE = 0.005  # share of samples while moving: fewer may gather at a turning point
MIN_STALE_SHARE = 0.02  # share of the samples while a channel changes: fewer are not worth a word
MAX_STALE_SHARE = 0.05  # the same: less makes a channel late by a twentieth of a sample in the mean, which is no matter
MAX_STALE_SHARE_IF_STUCK = 0.3  # the same of a channel at its extremes, on the way to which it may repeat values
MAX_ROUNDING_NOISE = 0.02  # rounding noise over the signal's rms
BAND_FACTOR = 5.0  # times the velocity's band: about what a fit's filter lets through


def missing_channels(name: str, joint: InspectedJoint, has_wrench_sensor: bool = False) -> Iterator[Notice]:
    """Channels that the joint lacks.

    Parameters
    ----------
    name, joint
        The joint.
    has_wrench_sensor
        True if the log has a force and a moment, which may stand in for the torque.
    """
    if "q" not in joint.signals:
        meaning = "the joint cannot be used; name its column in `log.columns`, or leave it out of `joints`"
        yield Notice("missing_position", "problem", name, "q is missing", meaning)
    if "v" not in joint.signals:
        yield Notice("missing_velocity", "note", name, "v is missing", "it is differentiated from q")
    if "tau" not in joint.signals:
        if "qcmd" in joint.signals:
            meaning = "it is computed from the command: give the joint's gains under `controller`"
            yield Notice("torque_from_command", "note", name, "tau is missing, but qcmd is available", meaning)
        elif has_wrench_sensor:
            meaning = "a wrench sensor can replace it for the links that it carries: list it under `wrench_sensors`"
            yield Notice("missing_torque", "warning", name, "tau is missing", meaning)
        else:
            meaning = "the joint cannot be identified; name the torque's column in `log.columns`, or log qcmd"
            yield Notice("missing_torque", "problem", name, "tau is missing", meaning)


def channel_findings(
    name: str, joint: InspectedJoint, frozen: Mapping[str, FrozenStretches], dt: float
) -> Iterator[Notice]:
    """All findings on single channels of a joint.

    Parameters
    ----------
    name, joint
        The joint.
    frozen
        Frozen stretches, by signal.
    dt
        Nominal sample time [s].
    """
    for signal, figures in joint.signals.items():
        if figures.not_finite:
            number = f"{signal} is not finite in {count_text(figures.not_finite, 'sample')}"
            meaning = "these rows are left out, and the log is split there"
            yield Notice("not_finite", "warning", name, number, meaning)
        if joint.moves:
            if signal in ("v", "tau"):
                yield from _constant(name, signal, figures)
            if signal in ("q", "v", "tau"):
                yield from _stale_or_clipped(name, signal, joint)
            if signal in frozen:
                yield _frozen(name, signal, frozen[signal])
            yield from _coarse(name, signal, joint, dt)


def _constant(name: str, signal: str, figures: Signal) -> Iterator[Notice]:
    if figures.constant:
        instead = "set `velocity: differentiated`" if signal == "v" else "name the right column in `log.columns`"
        value = f"{signal} is {short_number(figures.minimum + 0.0)} throughout while q moves"  # 0, not -0
        yield Notice("stale", "problem", name, value, f"the channel was not recorded; {instead}")


def _stale_or_clipped(name: str, signal: str, joint: InspectedJoint) -> Iterator[Notice]:
    """A channel that is read too seldom sits at its extremes too, so that is asked first."""
    figures = joint.signals[signal]
    repeats = figures.stale or 0.0
    stuck = figures.stuck > MAX_STUCK_SHARE
    share = f"{100 * repeats:.1f} % of the samples of {signal} repeat the previous one while it changes"
    meaning = "the channel is read too rarely, which delays it by half its update period; check the bus"
    if repeats > (MAX_STALE_SHARE_IF_STUCK if stuck else MAX_STALE_SHARE):
        yield Notice("stale", "warning", name, share, meaning)
    elif stuck:
        yield from _clipped(name, signal, joint)
    elif repeats > MIN_STALE_SHARE:
        yield Notice("few_samples_stale", "note", name, share, meaning)


def _clipped(name: str, signal: str, joint: InspectedJoint) -> Iterator[Notice]:
    """A channel at its extremes. Whether the drive or the sensor cut the torque off is for the model to tell."""
    figures = joint.signals[signal]
    extremes = (
        f"its extremes, {short_number(figures.minimum)} and {short_number(figures.maximum)}, in "
        f"{100 * figures.stuck:.1f} % of the samples"
    )
    if signal == "tau":
        meaning = "larger values were cut off, which biases the fit; reduce the excitation, or raise the limit"
        yield Notice("torque_at_extremes", "warning", name, f"tau stays at {extremes}", meaning)
    elif signal == "v":
        meaning = "larger values were cut off; set `velocity: differentiated`, or raise the limit"
        yield Notice("clipped", "warning", name, f"v stays at {extremes}, while q continues to move", meaning)
    elif "v" in joint.signals and not joint.signals["v"].constant:
        meaning = "positions beyond them were cut off; stay within the encoder's range"
        yield Notice("clipped", "warning", name, f"q stays at {extremes}, while v shows motion", meaning)


def _frozen(name: str, signal: str, frozen: FrozenStretches) -> Notice:
    extent = (
        f"{signal} keeps one value for {short_number(frozen.seconds)} s in total while the joint moves, first "
        f"{frozen.start:.3f} s into the log"
    )
    return Notice("stale", "warning", name, extent, "the channel was frozen: remove these parts from the log")


def _coarse(name: str, signal: str, joint: InspectedJoint, dt: float) -> Iterator[Notice]:
    noise = _rounding_noise(signal, joint, dt)
    if noise > MAX_ROUNDING_NOISE:
        disturbed = "velocity" if signal == "q" else signal
        step = joint.signals[signal].step
        instead = {
            "q": "a fit uses the logged v where it is less noisy; otherwise",
            "v": "a fit differentiates q where that is less noisy; otherwise",
        }.get(signal, "use a larger excitation, or")
        consequence = f"{100 * noise:.0f} % (rms) of noise in the {disturbed}"
        rounding = f"{signal} has a resolution of {short_number(step)}, which causes {consequence}"
        yield Notice(
            "coarse_channel",
            "warning",
            name,
            rounding,
            f"the resolution is too coarse: {instead} lower `filter.cutoff_hz`",
        )


def _rounding_noise(signal: str, joint: InspectedJoint, dt: float) -> float:
    """Noise that rounding makes, over the rms of the quantity that it disturbs; 0 where it is nothing to a fit.

    Rounding is white noise of step²/12. In v and tau it counts as it is; in q, as the velocity that differentiating
    it up to a frequency B makes: step² dt (2 pi)² B³ / 18.
    """
    figures = joint.signals[signal]
    if figures.step is None or figures.constant:
        return 0.0
    if signal in ("v", "tau"):
        return float(figures.step / np.sqrt(12) / figures.rms)
    if signal == "q" and joint.speed_rms > 0:
        band = min(BAND_FACTOR * (joint.band_hz or 0.0), 0.5 / dt)
        return float(figures.step * 2 * np.pi * np.sqrt(dt * band**3 / 18) / joint.speed_rms)
    return 0.0
