"""`--rerun` where rerun is not installed, or its file cannot be; what it writes is tested in test_rerun.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from commands import LEG, TRAIN, refuse


@pytest.mark.parametrize("command", ["fit", "validate", "diagnose", "simulate"])
def test_that_it_is_missing_is_said_before_the_work(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    refuse(tmp_path, command, LEG, TRAIN, "--rerun", "leg.rrd", naming="--rerun: needs rerun, which is not installed")


@pytest.mark.parametrize("command", ["fit", "validate", "diagnose", "simulate"])
def test_that_its_file_cannot_be_written_is_said_before_the_work(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("idtool.reporting.rerun_recording.rerun_package", lambda: None)
    (tmp_path / "file").touch()
    naming = "file: is a file, but a folder is needed; give another --rerun"
    refuse(tmp_path, command, LEG, "none.mcap", "--rerun", "file/leg.rrd", naming=naming)
