"""Ctrl-C: ends the process at once while libraries load, waits while files are moved; otherwise KeyboardInterrupt."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_CODE = 130  # of an interrupted process, by the convention of shells
MESSAGE = "stopped\n"


def exit_on_interrupt() -> None:
    """End the process on Ctrl-C without a KeyboardInterrupt, which libraries that are being loaded swallow."""
    signal.signal(signal.SIGINT, _exit)


def restore_keyboard_interrupt() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _exit:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _exit(number: int, frame: FrameType | None) -> None:
    os.write(2, MESSAGE.encode())
    os._exit(EXIT_CODE)


@contextmanager
def delay_interrupt() -> Iterator[None]:
    """Delay Ctrl-C until the end of the block."""
    if threading.current_thread() is not threading.main_thread():  # Python interrupts only this one
        yield
        return
    received: list[int] = []
    previous_handler = signal.signal(signal.SIGINT, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
    if received:
        signal.raise_signal(signal.SIGINT)
