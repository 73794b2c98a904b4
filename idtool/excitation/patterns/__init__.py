"""Motions that excite: one file a pattern. A pattern's motions begin and end at rest at one pose."""

from __future__ import annotations

from idtool.excitation.patterns.base import Pattern, Samples, Setting
from idtool.excitation.patterns.bspline import BSpline
from idtool.excitation.patterns.fourier import Fourier
from idtool.excitation.patterns.shell import Shell
from idtool.excitation.patterns.slow import Slow
from idtool.excitation.patterns.standstill import Standstill
from idtool.excitation.patterns.trajectory import Part, Trajectory

__all__ = ["PATTERNS", "Fourier", "Part", "Pattern", "Samples", "Setting", "Slow", "Standstill", "Trajectory"]

PATTERNS: dict[str, type[Pattern]] = {kind.name: kind for kind in (Fourier, BSpline, Shell)}  # that are searched
