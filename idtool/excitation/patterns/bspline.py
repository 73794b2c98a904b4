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
    """Control points at even spaces in time."""

    name = "bspline"

    @override
    def frequencies(self) -> Array:
        """A control point by itself moves the joint there and back in about four spans."""
        count = self._spans() + _DEGREE - 2 * _FIXED
        return np.full(count, 2 * np.pi * self._spans() / (4 * self.duration))

    @override
    def functions(self, t: Array) -> MotionSamples:
        spans = self._spans()
        knots = np.pad(np.linspace(0, self.duration, spans + 1), _DEGREE, mode="edge")
        every = Spline(knots, np.eye(spans + _DEGREE)[:, _FIXED:-_FIXED], _DEGREE)
        f, df, ddf = (every.derivative(k)(t) if k else every(t) for k in range(3))
        return MotionSamples(*(np.ascontiguousarray(x.T) for x in (f, df, ddf)))

    def _spans(self) -> int:
        return int(np.clip(np.ceil(_SPANS * self.max_frequency * self.duration), 2 * _FIXED, _MAX_CONTROL_POINTS))
