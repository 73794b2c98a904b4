"""Failures at every stage of the diagnosis of a quadruped with resting joints: all files are written nevertheless."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_stages import STAGES, completed_search, copy_of_search
from resting_quadruped import OFFSET, OFFSET_JOINT, SPRING_JOINT, STIFFNESS, write_quadruped

import idtool
from idtool.diagnosis import diagnose as module
from idtool.diagnosis import effect_replacement, effect_search, reversal_rows
from idtool.diagnosis.effect_search import EffectSearch

pytestmark = pytest.mark.slow

HIDDEN = {("parallel_spring", SPRING_JOINT), ("torque_offset", OFFSET_JOINT)}
OPTIONS: dict[str, Any] = {"inertia": "fixed", "effects": ["parallel_spring", "torque_offset"], "simulation": False}
FILES = {"diagnosis.json", "diagnosis.html", "model.yaml", "identified.urdf"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_quadruped(tmp_path_factory.mktemp("quadruped"))


def written(files: tuple[Path, Path], folder: Path) -> dict[str, Any]:
    """The report of a diagnosis whose files are all there, and whole."""
    idtool.diagnose(*files, **OPTIONS).save(folder)
    assert {path.name for path in folder.iterdir()} == FILES
    assert (folder / "diagnosis.html").read_text().rstrip().endswith("</html>")
    model = idtool.Model(folder / "identified.urdf", folder / "model.yaml")
    again = idtool.validate(model, files[1], simulation=False)
    assert np.isfinite(again.rms.model["overall"])
    report = json.loads((folder / "diagnosis.json").read_text())
    assert isinstance(report, dict)
    return report


def named(report: dict[str, Any]) -> set[tuple[str, str]]:
    return {(step["effect"], step["joint"]) for step in report["steps"] if step["effect"] != "unknown"}


@pytest.fixture(scope="module")
def search(files: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> EffectSearch:
    """The search of a diagnosis in which nothing fails."""
    reports = []
    found = completed_search(lambda: reports.append(written(files, tmp_path_factory.mktemp("whole"))))
    (report,) = reports
    assert named(report) == HIDDEN
    sizes = {step["joint"]: step["parameters"] for step in report["steps"]}
    assert sizes[SPRING_JOINT]["stiffness"] == pytest.approx(STIFFNESS, rel=0.02)
    assert sizes[OFFSET_JOINT]["offset"] == pytest.approx(OFFSET, rel=0.02)
    assert not [notice for notice in report["notices"] if notice["code"] == "stage_skipped"]
    return found


@pytest.mark.parametrize("failure", [ValueError("as this test wants it"), KeyboardInterrupt()], ids=["fails", "Ctrl-C"])
@pytest.mark.parametrize("stage", STAGES)
def test_all_is_written_whatever_stage_fails(
    files: tuple[Path, Path],
    search: EffectSearch,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    stage: str,
    failure: BaseException,
) -> None:
    inner = getattr(module, stage)
    failed = []

    def fail(*arguments: Any, **options: Any) -> Any:
        if failed:  # Ctrl-C comes once
            return inner(*arguments, **options)
        failed.append(stage)
        raise failure

    monkeypatch.setattr(module, "EffectSearch", lambda *arguments: copy_of_search(search))
    monkeypatch.setattr(module, stage, fail)
    report = written(files, tmp_path / "out")
    assert failed
    assert named(report) == HIDDEN
    skipped = [notice["message"] for notice in report["notices"] if notice["code"] == "stage_skipped"]
    reason = "the diagnosis was interrupted" if isinstance(failure, KeyboardInterrupt) else "its evaluation failed"
    assert re.search(f" (was|were) skipped: {reason}", skipped[0])


@pytest.mark.parametrize("failure", [ValueError("as this test wants it"), KeyboardInterrupt()], ids=["fails", "Ctrl-C"])
@pytest.mark.parametrize("calls", [3, 9, 15])
def test_all_is_written_wherever_the_search_ends(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, calls: int, failure: BaseException
) -> None:
    """From the n-th fit of the search on, every fit fails until it gives up; Ctrl-C comes once."""
    inner, count = effect_search.linearize_fit, [0]

    def linearize_fit(*arguments: Any, **options: Any) -> Any:
        count[0] += 1
        if count[0] == calls or (count[0] > calls and isinstance(failure, ValueError)):
            raise failure
        return inner(*arguments, **options)

    for part in (effect_search, effect_replacement, reversal_rows):
        monkeypatch.setattr(part, "linearize_fit", linearize_fit)
    report = written(files, tmp_path / "out")
    assert count[0] >= calls
    assert named(report) <= HIDDEN
    if isinstance(failure, KeyboardInterrupt):
        (notice,) = [notice for notice in report["notices"] if notice["code"] == "search_interrupted"]
        assert notice["message"].startswith("the search was interrupted")
