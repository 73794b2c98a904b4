"""Solids that bound a body's mass. A new shape is one new file in this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

from idtool.robot.shapes.base import Shape
from idtool.robot.shapes.hull import Hull

__all__ = ["Hull", "Shape", "known_shapes"]


@cache
def known_shapes() -> dict[str, type[Shape]]:
    """Every shape by its kind."""
    shapes: dict[str, type[Shape]] = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for _, member in inspect.getmembers(module, inspect.isclass):
            if issubclass(member, Shape) and not inspect.isabstract(member):
                shapes[member.kind] = member
    return shapes
