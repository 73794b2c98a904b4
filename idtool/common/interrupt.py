"""Ctrl-C: at once while libraries are loaded, not at all while files are put in their places, else as Python has it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

CODE = 130  # of a process that was interrupted, as shells have it
LINE = "stopped\n"


def at_once() -> None:
    """End the process on Ctrl-C without a KeyboardInterrupt, which libraries that are being loaded swallow."""
    signal.signal(signal.SIGINT, _end)


def as_python_has_it() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, LINE.encode())
    os._exit(CODE)


@contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C takes effect after what is done here."""
    if threading.current_thread() is not threading.main_thread():  # others are not interrupted
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        signal.raise_signal(signal.SIGINT)
