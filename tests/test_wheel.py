"""The package as a wheel: what a user has who installs it, away from the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from commands import FIT_FILES, LEG, SAMPLES, TRAIN, Result, files

CHECKOUT = SAMPLES.parent


@pytest.fixture(scope="module")
def site_packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory into which a wheel of idtool, built from a copy of its sources, is installed."""
    source, wheels, target = (tmp_path_factory.mktemp(name) for name in ("source", "wheels", "site-packages"))
    shutil.copytree(CHECKOUT / "idtool", source / "idtool", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(CHECKOUT / name, source)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", wheels, source], check=True)
    (wheel,) = wheels.iterdir()
    subprocess.run([*pip, "install", "--no-deps", "--target", target, wheel], check=True)
    return target


def from_wheel(site_packages: Path, *arguments: object, folder: Path) -> Result:
    """Run the wheel's idtool in a process of its own; its dependencies are those of the tests."""
    command = [sys.executable, "-m", "idtool", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(site_packages)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    return Result(done.returncode, done.stdout, done.stderr)


def test_the_regression_without_a_checkout_says_what_to_do(site_packages: Path, tmp_path: Path) -> None:
    done = from_wheel(site_packages, "validate", folder=tmp_path)
    assert (done.code, done.out) == (2, "")
    (line,) = done.err.splitlines()
    assert line.startswith("error: sample_logs/manifest.yaml: ")
    assert "idtool validate URDF LOG" in line
    assert files(tmp_path) == {}


def test_a_fit_finds_all_that_its_report_is_made_of(site_packages: Path, tmp_path: Path) -> None:
    done = from_wheel(site_packages, "fit", LEG, TRAIN, "--quick", "--out", tmp_path, folder=tmp_path)
    assert done.code == 0, done.err
    assert set(files(tmp_path)) == FIT_FILES
