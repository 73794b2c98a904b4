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
    found: dict[str, type[Shape]] = {}
    for module in pkgutil.iter_modules(__path__):
        for _, member in inspect.getmembers(importlib.import_module(f"{__name__}.{module.name}"), inspect.isclass):
            if issubclass(member, Shape) and not inspect.isabstract(member):
                found[member.kind] = member
    return found
