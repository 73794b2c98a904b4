"""Torque errors of logs with unusual stamps."""

from __future__ import annotations

from pathlib import Path

import pytest
from paths import SAMPLES

import idtool


@pytest.mark.parametrize("stamp", ["nan", "-3e12"])
def test_a_stamp_that_is_none_does_not_matter(tmp_path: Path, stamp: str) -> None:
    """The first sample has no time, or one that is absurd."""
    lines = (SAMPLES / "leg_validate.csv").read_text().splitlines()
    _, _, rest = lines[1].partition(",")
    (tmp_path / "log.csv").write_text("\n".join([lines[0], f"{stamp},{rest}", *lines[2:2000]]))
    result = idtool.validate(SAMPLES / "leg.urdf", tmp_path / "log.csv", simulation=False)
    assert result.rms.model["overall"] > 0
