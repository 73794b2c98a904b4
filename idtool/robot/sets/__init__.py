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
    found: dict[str, ConstraintSet] = {}
    for module in pkgutil.iter_modules(__path__):
        for _, member in inspect.getmembers(importlib.import_module(f"{__name__}.{module.name}"), inspect.isclass):
            if issubclass(member, ConstraintSet) and not inspect.isabstract(member):
                found[member.name] = member()
    return dict(sorted(found.items(), key=lambda item: item[1].tightness))


def choose_set(body: Body, name: str | None = None) -> ConstraintSet:
    """The set of that name, or the tightest; where a body lacks what it needs, the tightest below that it has."""
    known = constraint_sets()
    wanted = known[name] if name else None
    if wanted is not None and wanted.applies_to(body):
        return wanted
    most = wanted.tightness if wanted else len(known)
    return [s for s in known.values() if s.automatic and s.applies_to(body) and s.tightness <= most][-1]
