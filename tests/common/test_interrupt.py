"""Ctrl-C ends a command at any moment, says so in a line, and leaves no file half written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from commands import LEG, TRAIN, idtool

from idtool.common.interrupt import delay_interrupt, exit_on_interrupt, restore_keyboard_interrupt
from idtool.common.outputs import write_all

IDTOOL = str(Path(sys.executable).with_name("idtool"))


def interrupted(folder: Path, *command: object, after: float) -> tuple[int, str]:
    """Exit code and standard error of a command that is interrupted after so many seconds."""
    with subprocess.Popen(
        [IDTOOL, *map(str, command)], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            running.wait(after)
        except subprocess.TimeoutExpired:
            running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
    return running.returncode, said


@pytest.fixture(scope="module")
def start() -> float:
    """How long the interpreter takes at the most to come to the command line, on a machine with other work too [s]."""
    taken = []
    for _ in range(3):
        begun = time.monotonic()
        subprocess.run([IDTOOL, "--version"], capture_output=True, check=True)
        taken.append(time.monotonic() - begun)
    return 1.5 * max(taken)


@pytest.mark.parametrize("after", [0.0, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("command", [("fit", LEG, TRAIN), ("excite", LEG, "--duration", "60")], ids=["fit", "excite"])
def test_a_command_that_is_interrupted_says_so_and_leaves_nothing(
    tmp_path: Path, command: tuple[object, ...], after: float, start: float
) -> None:
    code, said = interrupted(tmp_path, *command, "--out", tmp_path / "out" / "e.mcap", after=start + after)
    if command[0] == "excite" and code == 0:  # it writes the best so far
        assert {path.name for path in (tmp_path / "out").iterdir()} == {"e.mcap", "e.html"}
        return
    assert (code, said) == (130, "stopped\n")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_what_libraries_make_of_an_interrupt_while_they_are_loaded_does_not_matter(tmp_path: Path) -> None:
    """An import that swallows it does not keep the command going."""
    (tmp_path / "swallows.py").write_text(
        "import os, signal, time\n"
        "from idtool.common.interrupt import exit_on_interrupt\n"
        "exit_on_interrupt()\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT); time.sleep(5)\nexcept BaseException: pass\n"
        "print('went on')\n"
    )
    done = subprocess.run([sys.executable, "swallows.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "stopped\n")


def test_while_files_are_put_in_their_places_it_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace = os.replace

    def hit(source: Path, target: Path) -> None:
        signal.raise_signal(signal.SIGINT)
        replace(source, target)

    monkeypatch.setattr(os, "replace", hit)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            write_all(tmp_path, {"a": "1", "b": "2"})
    finally:
        signal.signal(signal.SIGINT, before)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "1", "b": "2"}


def test_only_the_main_thread_is_interrupted() -> None:
    done: list[str] = []

    def work() -> None:
        with delay_interrupt():
            done.append("done")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == ["done"]


def test_who_calls_idtool_as_a_library_keeps_his_own_handler() -> None:
    before = signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, own := lambda number, frame: None)
        restore_keyboard_interrupt()
        assert signal.getsignal(signal.SIGINT) is own
        exit_on_interrupt()
        restore_keyboard_interrupt()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_output_that_nobody_reads_or_that_has_no_room(tmp_path: Path) -> None:
    for target, code, said in (
        ("| head -1", 0, ""),
        ("> /dev/full", 2, "error: standard output: cannot be written to"),
    ):
        line = f"set -o pipefail; {IDTOOL} inspect {TRAIN} {target}"
        done = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code
        assert done.stderr.startswith(said)
        assert done.stderr.count("\n") == bool(said)


def test_an_output_that_cannot_be_is_refused_before_the_work_is_done(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for command in ("fit", "diagnose", "study", "adapt", "validate"):
        done = idtool(command, LEG, "none.mcap", "--out", "file", folder=tmp_path)
        assert (done.code, done.err) == (2, "error: file: is a file, but a folder is needed; give another --out\n")


@pytest.mark.parametrize(
    ("place", "what"),
    [
        ("link", "is a link to nothing, but a folder is needed"),
        ("link/below", "is a link to nothing, but a folder is needed"),
        ("/proc/idtool", "cannot be written to (No such file or directory)"),
    ],
)
def test_a_place_that_takes_no_files_is_noticed_before_the_logs_are_read(place: str, what: str, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("nowhere")
    for command in ("fit", "diagnose", "study", "adapt", "validate"):
        done = idtool(command, LEG, "none.mcap", "--out", place, folder=tmp_path)
        assert (done.code, done.out) == (2, "")
        assert done.err.endswith(f"{what}; give another --out\n")
        assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_an_interrupt_during_the_work_is_said_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hit(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("idtool.api.fit.run_fit", hit)
    done = idtool("fit", LEG, TRAIN, "--out", tmp_path / "out")
    assert (done.code, done.out, done.err) == (130, "", "stopped\n")
    assert not (tmp_path / "out").exists()
