"""Where the project's files are, and logs of real robots, which are no part of it."""

from __future__ import annotations

from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
SAMPLES = CHECKOUT / "sample_logs"
CONFIGS = CHECKOUT / "configs"
SHARED = CHECKOUT.parent / "shared"
REAL = SHARED / "data"
