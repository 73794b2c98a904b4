"""Findings on the clock of a log and on its completeness: stamps, lost samples, repeated rows."""

from __future__ import annotations

from collections.abc import Iterator

from idtool.common.names import count_text
from idtool.common.notice import Notice, Severity
from idtool.common.number_text import short_number
from idtool.data.inspection.records import Stamps

MAX_JITTER = (
    0.1  # samples that a step is off: differencing neighbouring positions is then wrong by a tenth of the velocity
)
MIN_SHARE = 0.005  # share of samples repeated or lost without a gap: fewer are not worth a word
MAX_REPEATED_SHARE = 0.05  # share of the samples: the rate is wrong by as much, which the stamps and v show to a fit
MAX_SKIPPED_SHARE = (
    0.01  # share of the steps: the rate is wrong by as much, an acceleration by twice that, and no stamp shows it
)
MAX_DUPLICATE_SHARE = 0.1  # share of the samples: as many stamps are made up
MAX_LOST_SHARE = 0.01  # share of the time: less is the ordinary end of a part, which costs a fit nothing
MIN_SHORT_SHARE = 0.05  # share of samples in segments too short for a filter to settle in
MAX_SHORT_SHARE = 0.5  # the same, from which on hardly anything remains

_DIFFERENTIATED = "the numerical derivative of q is noisy, so a fit uses the logged v if it is less noisy"


def sampling_jitter(dt: float, stamps: Stamps) -> Iterator[Notice]:
    """Stamps that are not even, or samples that were not taken at their stamps.

    The steps from stamp to stamp count: a clock that drifts does a fit no harm.
    """
    unevenness = _unevenness(dt, stamps)
    if stamps.step_jitter > MAX_JITTER:
        deviation = f"the time between stamps varies by {short_number(stamps.step_jitter, 2)} sample periods rms"
        advice = f"{_DIFFERENTIATED}; log the sensor's own time"
        yield Notice("time_jitter", "warning", None, deviation, advice)
    elif unevenness > MAX_JITTER:
        deviation = (
            "according to the motion, the actual sampling times deviate from the evenly spaced stamps by "
            f"{short_number(unevenness, 2)} sample periods rms"
        )
        advice = f"the stamps were rounded or generated; {_DIFFERENTIATED}; log the sensor's own time"
        yield Notice("time_jitter", "warning", None, deviation, advice)


def skipped_samples(dt: float, stamps: Stamps) -> Iterator[Notice]:
    """Samples that were lost without a gap in the stamps.

    Where the stamps stray they may show the loss, so that it is no fault beside the jitter.
    """
    if stamps.sampling is None or _unevenness(dt, stamps) > MAX_JITTER:
        return
    lost_share = stamps.sampling.skipped - stamps.repeated
    if lost_share > MIN_SHARE:
        skipped = f"{100 * stamps.sampling.skipped:.1f} % of the steps"
        share = f"according to the motion, {skipped} are two or more sample periods long"
        meaning = f"samples were lost without a gap in the stamps; {_DIFFERENTIATED}; log the sensor's own time"
        if lost_share > MAX_SKIPPED_SHARE and stamps.step_jitter <= MAX_JITTER:
            yield Notice("dropped_samples", "warning", None, share, meaning)
        else:
            yield Notice("few_samples_dropped", "note", None, share, meaning)


def _unevenness(dt: float, stamps: Stamps) -> float:
    """Standard deviation of the samples' real instants about an even spacing, in samples; 0 where it is not known."""
    if stamps.sampling is None:
        return 0.0
    return stamps.sampling.jitter_ms / (1e3 * dt)


def repeated_rows(stamps: Stamps) -> Iterator[Notice]:
    """Rows that repeat the one before in every joint."""
    if stamps.repeated > MIN_SHARE:
        share = f"{100 * stamps.repeated:.1f} % of the samples repeat the previous one in every joint"
        meaning = f"the log was sampled faster than its source; {_DIFFERENTIATED}; log at the source's rate"
        if stamps.repeated > MAX_REPEATED_SHARE:
            yield Notice("stale", "warning", None, share, meaning)
        else:
            yield Notice("few_samples_stale", "note", None, share, meaning)


def gaps(duration: float, stamps: Stamps) -> Iterator[Notice]:
    """Time that was lost between segments; ``duration`` is that of the log [s]."""
    if stamps.gaps:
        longest = stamps.longest_gaps[0]
        extent = (
            f"{count_text(stamps.gaps, 'gap')}, {short_number(stamps.lost)} s in total; the longest is "
            f"{short_number(longest.lost)} s, "
            f"{longest.start:.3f} s after the start"
        )
        meaning = "filters do not cross gaps: samples next to a gap are not used, and short segments not at all"
        if stamps.lost > MAX_LOST_SHARE * duration:
            yield Notice("dropped_samples", "warning", None, extent, meaning)
        else:
            yield Notice("small_gaps", "note", None, extent, meaning)


def short_segments(segments: int, stamps: Stamps) -> Iterator[Notice]:
    """Segments too short to be of use; ``segments`` is the number of all."""
    if segments < 2 or stamps.short < MIN_SHORT_SHARE:
        return
    extent = (
        f"gaps and missing values divide the log into {segments} segments: {100 * stamps.short:.0f} % of it is in "
        "segments shorter than 0.5 s"
    )
    too_short = stamps.short > MAX_SHORT_SHARE
    severity: Severity = "problem" if too_short else "warning"
    rest = "hardly any usable data remain for the fit" if too_short else "a fit may have to omit these segments"
    advice = "fill in single missing values, or log without gaps"
    meaning = f"these segments are shorter than the settling time of a filter, so {rest}: {advice}"
    if stamps.gaps:
        yield Notice("dropped_samples", severity, None, extent, meaning)
    else:
        yield Notice("short_stretches", severity, None, extent, meaning)


def disordered_stamps(samples: int, stamps: Stamps) -> Iterator[Notice]:
    """Stamps that do not advance; ``samples`` is the number of all."""
    if stamps.duplicates:
        severity: Severity = "warning" if stamps.duplicates > MAX_DUPLICATE_SHARE * samples else "note"
        number = f"{count_text(stamps.duplicates, 'stamp')} equal to the previous one"
        cause = "the clock is coarse, or rows were written twice"
        meaning = f"{cause}; if the sensor's own time is logged, name its column in `log.columns`"
        yield Notice("duplicate_stamps", severity, None, number, meaning)
    if stamps.backward:
        number = f"{count_text(stamps.backward, 'stamp')} earlier than the previous one"
        cause = "the file contains two recordings, or the clock was set"
        meaning = f"{cause}; the log is split there: check that the parts belong together"
        yield Notice("backward_stamps", "warning", None, number, meaning)
