"""Paths of the project's files, and of logs of real robots, which are not part of it."""

from __future__ import annotations

from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
SAMPLES = CHECKOUT / "sample_logs"
CONFIGS = CHECKOUT / "configs"
SHARED = CHECKOUT.parent / "shared"
REAL = SHARED / "data"
