"""Options that several commands share: where a file goes, completion, and messages about mistakes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import LEG, TRAIN, idtool

EXCITE = ("excite", LEG, "--duration", "3", "--iterations", "1", "--slow", "0")
WRITERS: dict[str, tuple[tuple[object, ...], str]] = {
    "init": (("init", LEG, TRAIN), "leg.yaml"),
    "ellipsoids": (("ellipsoids", LEG), "ellipsoids.yaml"),
    "excite": (EXCITE, "excitation.mcap"),
    "reduce": (("reduce", LEG, TRAIN), "leg.idr"),
    "simulate": (("simulate", LEG, TRAIN), "simulated.mcap"),
}


@pytest.mark.parametrize(("arguments", "name"), WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("exists", [True, False])
def test_a_folder_gets_the_file(tmp_path: Path, arguments: tuple[object, ...], name: str, exists: bool) -> None:
    folder = tmp_path / "results"
    if exists:
        folder.mkdir()
    done = idtool(*arguments, "--out", folder, "--quiet")
    assert (done.code, done.err) == (0, "")
    assert (folder / name).is_file()


def test_an_export_into_a_folder(tmp_path: Path) -> None:
    fit = tmp_path / "fit"
    assert idtool("fit", LEG, TRAIN, "--quick", "--quiet", "--out", fit).code == 0
    for simulator, name in (("mujoco", "mujoco.xml"), ("drake", "drake.urdf")):
        assert idtool("export", fit, "--to", simulator, "--out", tmp_path / "sim", "--quiet").code == 0
        assert (tmp_path / "sim" / name).is_file()
    assert idtool("export", fit, "--to", "mujoco", "--out", tmp_path / "own.xml", "--quiet").code == 0
    assert (tmp_path / "own.xml").is_file()


COMPLETED = {
    "export OUT --to ": {"mujoco", "drake"},
    "fit a.urdf --method ": {"ls", "iv"},
    "diagnose a.urdf --inertia ": {"refit", "fixed"},
    "diagnose a.urdf --assume paral": {"parallel_spring"},
    "excite a.urdf --pattern ": {"fourier", "bspline", "shell"},
    "excite a.urdf --criterion ": {"d", "a", "e", "condition"},
}


@pytest.mark.parametrize(("words", "completions"), COMPLETED.items(), ids=COMPLETED)
def test_fixed_values_are_completed(words: str, completions: set[str]) -> None:
    typed = f"idtool {words}"
    environment = {"_IDTOOL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    command = [sys.executable, "-c", "from idtool.cli import main; main()"]
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=False)
    assert set(done.stdout.split()) == completions


MISTAKES: dict[str, tuple[tuple[object, ...], str]] = {
    "no simulator": (("export", "x", "--to", "gazebo"), "command: invalid value for '--to': "),
    "no number": (("study", LEG, TRAIN, "--draws", "many"), "command: invalid value for '--draws': should be a valid"),
    "negative seed": (("excite", LEG, "--seed", "-1"), "--seed: -1 is negative; give 0 or more"),
}


@pytest.mark.parametrize(("arguments", "message"), MISTAKES.values(), ids=MISTAKES)
def test_no_message_has_the_words_of_a_library(arguments: tuple[object, ...], message: str) -> None:
    done = idtool(*arguments)
    assert done.code == 2
    assert done.err.startswith(f"error: {message}")
    assert done.err.count("\n") == 1
    assert not any(words in done.err for words in ("Value error", "Input should", "unable to parse"))
