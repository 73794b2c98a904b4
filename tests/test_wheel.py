"""The package as sdist and wheel: what a user has who installs it, away from the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from commands import FIT_FILES, SAMPLES, Result, files

CHECKOUT = SAMPLES.parent
MAX_WHEEL_SIZE = 12 << 20  # bytes


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of idtool, built from an sdist that is built from a copy of the sources; nothing is downloaded."""
    pytest.importorskip("hatchling", reason="hatchling builds the package; make test installs it")
    source, built = (tmp_path_factory.mktemp(name) for name in ("source", "built"))
    for name in ("idtool", "sample_logs"):
        shutil.copytree(CHECKOUT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md"):
        shutil.copy(CHECKOUT / name, source)
    hatchling = [sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", str(built)]
    subprocess.run(hatchling, cwd=source, check=True, capture_output=True)
    (sdist,) = built.glob("*.tar.gz")
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", built, sdist)
    (found,) = built.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def site_packages(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory into which the wheel is installed."""
    target = tmp_path_factory.mktemp("site-packages")
    pip("install", "--no-deps", "--no-index", "--target", target, wheel)
    return target


def pip(*arguments: object) -> None:
    """Run pip."""
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *map(str, arguments)]
    subprocess.run(command, check=True)


def from_wheel(site_packages: Path, *arguments: object, folder: Path) -> Result:
    """Run the wheel's idtool in a process of its own; its dependencies are those of the tests."""
    command = [sys.executable, "-m", "idtool", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(site_packages)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    return Result(done.returncode, done.stdout, done.stderr)


def test_the_wheel_is_small_and_contains_no_scripts_of_the_samples(wheel: Path, site_packages: Path) -> None:
    assert wheel.stat().st_size < MAX_WHEEL_SIZE
    assert {path.name for path in site_packages.iterdir()} - {"bin"} == {"idtool", f"{wheel.name[:12]}.dist-info"}
    suffixes = {path.suffix for path in (site_packages / "idtool" / "sample_logs").rglob("*") if path.is_file()}
    assert suffixes == {".urdf", ".yaml", ".json", ".xml", ".mcap", ".csv"}


@pytest.mark.slow
def test_a_sample_is_written_and_fitted(site_packages: Path, tmp_path: Path) -> None:
    done = from_wheel(site_packages, "sample", "leg", folder=tmp_path)
    assert done.code == 0, done.err
    leg, log = "sample_logs/leg.urdf", "sample_logs/leg_train.mcap"
    done = from_wheel(site_packages, "fit", leg, log, "--quick", folder=tmp_path)
    assert done.code == 0, done.err
    assert set(files(tmp_path / "leg_idtool")) == FIT_FILES


@pytest.mark.slow
def test_the_regression_runs_without_a_checkout(site_packages: Path, tmp_path: Path) -> None:
    done = from_wheel(site_packages, "validate", folder=tmp_path)
    assert done.code == 0, done.err
    assert files(tmp_path) == {}


def test_the_lock_contains_what_builds_the_package() -> None:
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
    assert project["dependency-groups"]["build"] == project["build-system"]["requires"]
    lock = (CHECKOUT / ".ci" / "requirements.txt").read_text()
    assert "\nhatchling==" in lock
    assert "\npytest==" not in lock
