"""Advice about files that cannot be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.input_files import missing_file_advice
from idtool.common.safe_yaml import read_yaml
from idtool.robot.urdf.reading import read_robot


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("leg.urdf", "leg_train.mcap", "legs.yaml"):
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("leg_tran.mcap", "did you mean leg_train.mcap?"),
        ("LEG_train.MCAP", "did you mean leg_train.mcap?"),
        ("leg.yaml", "did you mean legs.yaml?"),  # not leg.urdf
        ("run9.mcap", "check the path"),
        ("no/leg.urdf", "check the path"),
        ("a\0b/leg.urdf", "check the path"),
    ],
)
def test_a_missing_file_has_a_similar_one_or_none(folder: Path, name: str, expected: str) -> None:
    assert missing_file_advice(folder / name) == expected


def test_a_file_that_cannot_be_read_comes_with_advice(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"\(No such file or directory\); did you mean leg\.urdf\?"):
        read_robot(folder / "lge.urdf")
    with pytest.raises(ConfigError, match=r"\(No such file or directory\); check the path"):
        read_yaml(folder / "none.yaml")
    with pytest.raises(ConfigError, match=r"\(Is a directory\); give a file"):
        read_yaml(folder)
