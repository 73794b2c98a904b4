"""Exciting motions, one file a pattern. A pattern's motions begin and end at rest at the home pose."""

from __future__ import annotations

from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec
from idtool.excitation.patterns.bspline import BSpline
from idtool.excitation.patterns.fourier import Fourier
from idtool.excitation.patterns.shell import Shell
from idtool.excitation.patterns.slow import SlowSweeps
from idtool.excitation.patterns.standstill import Standstill
from idtool.excitation.patterns.trajectory import Trajectory, TrajectorySegment

__all__ = [
    "PATTERNS",
    "Fourier",
    "MotionSamples",
    "Pattern",
    "PatternSpec",
    "SlowSweeps",
    "Standstill",
    "Trajectory",
    "TrajectorySegment",
]

PATTERNS: dict[str, type[Pattern]] = {kind.name: kind for kind in (Fourier, BSpline, Shell)}  # that are searched
