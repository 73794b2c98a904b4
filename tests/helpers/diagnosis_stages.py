"""Stages of a diagnosis beside the search, for tests in which one of them fails: functions of `diagnosis.diagnose`."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import pytest

from idtool.diagnosis import diagnose as module
from idtool.diagnosis.effect_search import EffectSearch

STAGES = (
    "find_data_faults",
    "order_effects",
    "evaluate_errors",
    "residual_structure",
    "structured_noise_floor",
    "localize_residual",
    "localize_unexplained",
    "effect_profile",
    "estimate_on_parts",
    "_held_out_notices",
    "residual_maps",
)


def completed_search(run_diagnosis: Callable[[], object]) -> EffectSearch:
    """Search of a diagnosis as it ended, for `copy_of_search`."""
    searches = []

    class Kept(EffectSearch):
        def run(self) -> None:
            super().run()
            searches.append(copy_of_search(self))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "EffectSearch", Kept)
        run_diagnosis()
    (search,) = searches
    return search


def copy_of_search(search: EffectSearch) -> EffectSearch:
    """Copy of a completed search, which does not run again."""
    other = copy(search)
    other.model = copy(search.model)
    other.model.added = [replace(effect) for effect in search.added]
    other.removed = list(search.removed)
    other.failed = dict(search.failed)
    setattr(other, "run", lambda: None)  # noqa: B010
    return other
