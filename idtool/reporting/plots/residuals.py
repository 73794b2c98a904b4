"""Torque residuals of two models, by state and by frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.units import position_units
from idtool.diagnosis.records import ResidualProfile
from idtool.reporting.plots.figure import SHORT, Figure, FigureGroup, Panel, PlotlyTrace, curve, figure
from idtool.reporting.plots.sampling import largest_indices, round_significant

_MAX_VALUES = 16_000  # that all residuals hold together: some 130 kB of text
_MIN_POINTS = 12  # of a curve
_MAX_POINTS = 200
_CURVES_PER_JOINT = 38  # of a joint: 2 models, each with 5 views of 3 and 2 spectra of 2
_COLORS = ("c1", "c5")  # of the two models
AXES = {
    "position": "position [{q}]",
    "velocity": "velocity [{q}/s]",
    "acceleration": "acceleration [{q}/s²]",
    "torque": "torque [{tau}]",
    "torque_rate": "rate of change of torque [{tau}/s]",
    "distance_since_reversal": "distance since the last reversal [{q}]",
    "time": "time [s]",
}


@dataclass(frozen=True)
class ResidualFigures:
    """Residuals of two models.

    Attributes
    ----------
    names
        Names of the two models.
    models
        The two models in a sentence.
    groups
        A joint's figures.
    """

    names: tuple[str, str]
    models: str
    groups: list[FigureGroup]


def residual_figures(
    before: Mapping[str, ResidualProfile],
    after: Mapping[str, ResidualProfile],
    units: Mapping[str, str],
    names: tuple[str, str],
    models: str,
) -> ResidualFigures:
    """Residuals of two models against state, time and frequency, of bounded size.

    Parameters
    ----------
    before, after
        Theirs, by joint.
    units
        Unit of the torque, by joint.
    names, models
        See `ResidualFigures`.
    """
    joints = [joint for joint in units if joint in before and joint in after]
    points = min(max(_MAX_VALUES // max(_CURVES_PER_JOINT * len(joints), 1), _MIN_POINTS), _MAX_POINTS)
    groups = []
    for joint in joints:
        pair = (before[joint], after[joint])
        q = position_units({joint: units[joint]})[joint]
        drawn = [
            *(_bin_figure(joint, pair, name, units[joint], q, names, points) for name in before[joint].against),
            _density_figure(joint, pair, units[joint], names, points),
            _amplitude_figure(joint, pair, units[joint], q, names, points),
        ]
        groups.append(FigureGroup(joint, [one for one in drawn if one.data and one.data[0]["x"]]))
    return ResidualFigures(names, models, groups)


def _bin_figure(
    joint: str, pair: Sequence[ResidualProfile], name: str, tau: str, q: str, names: tuple[str, str], points: int
) -> Figure:
    """Mean and root mean square in bins of a quantity."""
    curves = []
    for residual, model, color in zip(pair, names, _COLORS, strict=True):
        if name not in residual.against:
            continue
        kept = largest_indices(residual.rms[name], points)
        at = round_significant(residual.against[name][kept].tolist())
        mean = round_significant(residual.mean[name][kept].tolist())
        rms = round_significant(residual.rms[name][kept].tolist())
        curves += [curve(f"mean {model}", at, mean, color, 1.6), curve(f"RMS {model}", at, rms, color, 1.6, "dot")]
    return _figure(joint, AXES.get(name, name).format(q=q, tau=tau), f"residual [{tau}]", curves, names)


def _density_figure(
    joint: str, pair: Sequence[ResidualProfile], tau: str, names: tuple[str, str], points: int
) -> Figure:
    """Amplitude density over frequency."""
    curves = [
        _spectrum(residual.frequency, residual.density, model, color, points)
        for residual, model, color in zip(pair, names, _COLORS, strict=True)
    ]
    return _figure(joint, "frequency [Hz]", f"residual [{tau}/√Hz]", curves, names, log=True)


def _amplitude_figure(
    joint: str, pair: Sequence[ResidualProfile], tau: str, q: str, names: tuple[str, str], points: int
) -> Figure:
    """Amplitude over periods per turn."""
    curves = [
        _spectrum(residual.angle, residual.amplitude, model, color, points)
        for residual, model, color in zip(pair, names, _COLORS, strict=True)
    ]
    turn = "periods per turn" if q == "rad" else "periods per 2π m"
    return _figure(joint, turn, f"residual [{tau}]", curves, names)


def _spectrum(at: Array, height: Array, name: str, color: str, points: int) -> PlotlyTrace:
    """A spectrum; of lines that are too many, the highest of every few."""
    kept = largest_indices(height, points)
    return curve(name, round_significant(at[kept].tolist()), round_significant(height[kept].tolist()), color, 1.6)


def _figure(
    joint: str, x_title: str, y_title: str, curves: list[PlotlyTrace], names: tuple[str, str], log: bool = False
) -> Figure:
    panel = Panel(y_title, curves, log=log, axis={} if log else {"rangemode": "tozero"})
    quantity, _, _ = x_title.partition(" [")
    description = f"Residual of {joint} against {x_title}, {names[0]} and {names[1]}"
    return figure(f"against {quantity}", x_title, [panel], description, SHORT)
