"""What all tests share."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from robots import leg_urdf

from idtool.common.exceptions import ConfigError
from idtool.robot.config import Config, parse_config, read_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot, read_robot

settings.register_profile("idtool", deadline=None, derandomize=True, max_examples=30)
settings.load_profile("idtool")

gc.disable()  # until all tests are collected: a quarter of the time that this takes


def pytest_collection_finish() -> None:
    """Collect garbage from now on, but leave out what thousands of collected tests hold to the end."""
    gc.freeze()
    gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-docs", action="store_true", help="write outputs that have changed into README and docs")


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run."""
    return np.random.default_rng(20170413)


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str | bytes, str], Path]:
    """Writes a file of the given contents and name."""

    def write(contents: str | bytes, name: str) -> Path:
        path = tmp_path / name
        path.write_bytes(contents if isinstance(contents, bytes) else contents.encode())
        return path

    return write


@pytest.fixture
def robot_of(written: Callable[[str | bytes, str], Path]) -> Callable[[str | bytes], Robot]:
    """Reads a robot from its URDF's text."""
    return lambda text: read_robot(written(text, "robot.urdf"))


@pytest.fixture
def build(robot_of: Callable[[str | bytes], Robot]) -> Callable[..., RobotModel]:
    """The model of a URDF, a configuration and the joints logged."""
    return lambda text, logged, **config: build_model(robot_of(text), parse_config(config, "robot.yaml"), logged)


@pytest.fixture
def leg(rng: np.random.Generator) -> str:
    """The leg of `leg_urdf`."""
    return leg_urdf(rng)


@pytest.fixture
def short_study(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies without local solvers and the many draws of few samples, where only files and words matter."""
    monkeypatch.setattr("idtool.estimation.study.study.LOCAL", {})
    monkeypatch.setattr("idtool.estimation.study.learning._FEW_SAMPLES_FACTOR", 1)


@pytest.fixture
def read(written: Callable[[str | bytes, str], Path]) -> Callable[[str | bytes], Config]:
    """Reads a configuration from its text."""
    return lambda text: read_config(written(text, "robot.yaml"))


@pytest.fixture
def refusal(read: Callable[[str | bytes], Config]) -> Callable[[str | bytes], str]:
    """The error that a configuration's text gives, checked to be one line that names the file."""

    def refused(text: str | bytes) -> str:
        with pytest.raises(ConfigError) as caught:
            read(text)
        where, file, message = str(caught.value).partition("robot.yaml: ")
        assert where
        assert file
        assert "\n" not in message
        assert len(message) < 200
        return message

    return refused
