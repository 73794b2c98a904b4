"""B-splines of degree 5, whose first and last three control points are the home pose."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline as Spline
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples
from idtool.excitation.patterns.linear import LinearPattern

_DEGREE = 5  # the acceleration is three times differentiable
_FIXED = 3  # control points at each end: position, velocity and acceleration there
_SPANS = 2.5  # knots in a period of the highest frequency
_MAX_CONTROL_POINTS = 160  # control points of a joint


class BSpline(LinearPattern):
    """Control points at even intervals of time."""

    name = "bspline"

    @override
    def frequencies(self) -> Array:
        count = self._spans() + _DEGREE - 2 * _FIXED
        # A control point by itself moves the joint there and back in about four spans.
        return np.full(count, 2 * np.pi * self._spans() / (4 * self.duration))

    @override
    def functions(self, t: Array) -> MotionSamples:
        spans = self._spans()
        knots = np.pad(np.linspace(0, self.duration, spans + 1), _DEGREE, mode="edge")
        control_points = np.eye(spans + _DEGREE)[:, _FIXED:-_FIXED]
        basis = Spline(knots, control_points, _DEGREE)
        f = basis(t)
        df = basis.derivative(1)(t)
        ddf = basis.derivative(2)(t)
        return MotionSamples(np.ascontiguousarray(f.T), np.ascontiguousarray(df.T), np.ascontiguousarray(ddf.T))

    def _spans(self) -> int:
        """Number of intervals between knots."""
        return int(np.clip(np.ceil(_SPANS * self.max_frequency * self.duration), 2 * _FIXED, _MAX_CONTROL_POINTS))
