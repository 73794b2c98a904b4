"""Sets of inertia parameters (paper, sections III to V). A new set is one new file in this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

from idtool.sets.base import ConstraintSet, Inequality

__all__ = ["ConstraintSet", "Inequality", "constraint_sets", "tightest"]


@cache
def constraint_sets() -> dict[str, ConstraintSet]:
    """Every set by name, the loosest first."""
    found: dict[str, ConstraintSet] = {}
    for module in pkgutil.iter_modules(__path__):
        for _, member in inspect.getmembers(importlib.import_module(f"{__name__}.{module.name}"), inspect.isclass):
            if issubclass(member, ConstraintSet) and not inspect.isabstract(member):
                found[member.name] = member()
    return dict(sorted(found.items(), key=lambda item: item[1].tightness))


def tightest() -> ConstraintSet:
    """The set that says most."""
    return list(constraint_sets().values())[-1]
