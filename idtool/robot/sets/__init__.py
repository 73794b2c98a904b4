"""Sets of inertia parameters (paper, sections III to V). A new set is one new file in this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

from idtool.robot.body import Body
from idtool.robot.sets.base import ConstraintSet

__all__ = ["ConstraintSet", "choose_set", "constraint_sets"]


@cache
def constraint_sets() -> dict[str, ConstraintSet]:
    """Every set by name, the loosest first."""
    sets: dict[str, ConstraintSet] = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for _, member in inspect.getmembers(module, inspect.isclass):
            if issubclass(member, ConstraintSet) and not inspect.isabstract(member):
                sets[member.name] = member()
    return dict(sorted(sets.items(), key=lambda item: item[1].tightness))


def choose_set(body: Body, name: str | None = None) -> ConstraintSet:
    """The named set, or the tightest; where it does not apply to the body, the tightest looser one that does."""
    sets = constraint_sets()
    max_tightness = len(sets)
    if name:
        if sets[name].applies_to(body):
            return sets[name]
        max_tightness = sets[name].tightness
    applicable = [s for s in sets.values() if s.automatic and s.applies_to(body) and s.tightness <= max_tightness]
    return applicable[-1]
