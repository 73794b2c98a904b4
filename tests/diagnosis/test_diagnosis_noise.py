"""Torque's noise is no effect, though a soft joint's torque equation takes it against itself."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import SAMPLES
from sentences import sentences

from idtool.diagnosis.diagnose import Options, diagnose
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_sample_logs_hide_nothing(robot: str) -> None:
    """Two robots of MuJoCo whose torque is logged with white noise, a tenth of it, and nothing else is amiss."""
    train, held_out = (Path(SAMPLES, f"{robot}_{part}.mcap") for part in ("train", "validate"))
    config = read_config(SAMPLES / f"{robot}.yaml")
    tried = prepare(read_robot(SAMPLES / f"{robot}.urdf"), config, [train], [held_out])
    found = diagnose(tried, Options(simulate=False), lambda stage, share: None)
    assert (found.verdict, found.steps, sentences(found.notices)) == ("no_disagreement", (), ())
    assert found.floor["overall"] == pytest.approx(found.after.train["overall"], rel=0.05)
