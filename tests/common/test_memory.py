"""Garbage collection while modules are imported, and afterwards."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import gc, sys
import idtool.reporting.terminal.base as base
made = base.Terminal.__init__
def make(*arguments):
    print("paused" if not gc.isenabled() else "running")
    made(*arguments)
    print("paused" if not gc.isenabled() else "running", gc.get_freeze_count() > 1000)
base.Terminal.__init__ = make
sys.argv = ["idtool", "inspect", "none.csv"]
"""


@pytest.mark.parametrize(
    ("front", "expected"),
    [("idtool.__main__", ["paused", "running True"]), ("idtool.cli", ["running", "running False"])],
)
def test_garbage_is_not_collected_while_a_command_is_loaded(front: str, expected: list[str]) -> None:
    script = f"{SCRIPT}from {front} import main; main()"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout.splitlines() == expected
