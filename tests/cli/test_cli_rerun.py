"""`--rerun` where rerun is not installed; what it writes is tested in test_rerun.py."""

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
