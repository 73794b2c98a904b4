"""Memory that the C library keeps after it was freed, where that is glibc, and Python's search for garbage."""

from __future__ import annotations

import ctypes
import gc
import sys
from contextlib import suppress

_M_ARENA_MAX = -8  # mallopt(3): largest number of pools of memory


def release_freed_memory() -> None:
    """Return memory that was freed to the system: malloc_trim(3)."""
    if sys.platform.startswith("linux"):
        with suppress(AttributeError):
            ctypes.CDLL(None).malloc_trim(0)


def share_freed_memory() -> None:
    """Let all threads use the memory that one of them freed, which glibc keeps for that thread otherwise."""
    if sys.platform.startswith("linux"):
        with suppress(AttributeError):
            ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def pause_garbage_collection() -> None:
    """Look for no reference cycles while modules are imported: they make many objects and hardly any garbage."""
    gc.disable()


def resume_garbage_collection() -> None:
    """Look for them again if that was paused, but not among the objects that are there by now, which stay."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
