"""What may be wrong with a log, put into clean signals; where it is one joint's, into the second's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from inspected import Array, Signals, motion, torque


def lag(seconds: float) -> Callable[[Signals], None]:
    def late(s: Signals) -> None:
        s["v"][:, 1] = motion(s["t"] - seconds, 1, 1)

    return late


def late_and_slow(s: Signals) -> None:
    s["q"][:, 1], s["v"][:, 1] = motion(s["t"] / 5, 1), motion(s["t"] / 5 - 1e-4, 1, 1) / 5


def drop(name: str) -> Callable[[Signals], None]:
    def without(s: Signals) -> None:
        s[name][:, 1] = np.nan

    return without


def scale(name: str, factor: float) -> Callable[[Signals], None]:
    def scaled(s: Signals) -> None:
        s[name][:, 1] *= factor

    return scaled


def constant(name: str, value: float = 0.0) -> Callable[[Signals], None]:
    def stuck(s: Signals) -> None:
        s[name][:, 1] = value

    return stuck


def rounded(name: str, step: float) -> Callable[[Signals], None]:
    def coarse(s: Signals) -> None:
        s[name][:, 1] = np.round(s[name][:, 1] / step) * step

    return coarse


def held_samples(name: str, every: int) -> Callable[[Signals], None]:
    def slow(s: Signals) -> None:
        s[name][:, 1] = np.repeat(s[name][::every, 1], every)[: len(s["t"])]

    return slow


def clipped(name: str, level: float) -> Callable[[Signals], None]:
    def clip(s: Signals) -> None:
        s[name][:, 1] = np.clip(s[name][:, 1], -level, level)

    return clip


def frozen(name: str) -> Callable[[Signals], None]:
    def stopped(s: Signals) -> None:
        s[name][4000:4200, 1] = s[name][4000, 1]

    return stopped


def exchanged_velocities(s: Signals) -> None:
    s["v"][:, [1, 2]] = s["v"][:, [2, 1]]


def another_joints_velocity(s: Signals) -> None:
    s["v"][:, 1] = s["v"][:, 2]


def not_finite(s: Signals) -> None:
    s["tau"][4000:4010, 1] = np.inf


def at_rest(s: Signals) -> None:
    rng = np.random.default_rng(0)
    for name, level in {"q": 1e-5, "v": 3e-3, "tau": 0.02}.items():
        s[name][:, 1] = 0.7 + level * rng.normal(size=len(s["t"]))


def seldom_moving(s: Signals) -> None:
    t = np.clip(s["t"], 10.0, 19.0)
    s["q"][:, 1] = motion(t, 1)
    s["v"][:, 1] = np.where(t == s["t"], motion(t, 1, 1), 0.0)


def wrapped(s: Signals) -> None:
    s["q"][:, 1] = np.mod(s["q"][:, 1], 2 * np.pi)


def in_degrees(s: Signals) -> None:
    s["q"][:, 1] *= 180 / np.pi
    s["v"][:, 1] *= 180 / np.pi


def position_controlled(s: Signals) -> None:
    s["qcmd"] = np.stack([motion(s["t"] + 5e-3, j) for j in range(3)], axis=1)
    s["tau"][:, 1] = np.nan


def gap(s: Signals) -> None:
    s["t"][15000:] += 0.25


def long_gap(s: Signals) -> None:
    s["t"][15000:] += 2.0


def backward(s: Signals) -> None:
    s["t"][15000:] -= 3.0


def duplicates(s: Signals) -> None:
    s["t"][1000::2000] = s["t"][999::2000]


def late_stamps(s: Signals) -> None:
    s["t"] += 4e-4 * np.random.default_rng(0).random(len(s["t"]))


def moved_to(s: Signals, t: Array) -> None:
    for j in range(3):
        for name, x in {"q": motion(t, j), "v": motion(t, j, 1), "tau": torque(t, j)}.items():
            s[name][:, j] += x - {"q": motion, "v": lambda t, j: motion(t, j, 1), "tau": torque}[name](s["t"], j)


def hidden_jitter(s: Signals) -> None:
    moved_to(s, s["t"] + 2.5e-4 * np.random.default_rng(0).normal(size=len(s["t"])))


def repeated_rows(every: int) -> Callable[[Signals], None]:
    def repeated(s: Signals) -> None:
        rows = np.arange(0, len(s["t"]), every)[1:]
        for name in ("q", "v", "tau"):
            s[name][rows] = s[name][rows - 1]

    return repeated


def skipped_samples(s: Signals) -> None:
    t = np.cumsum(np.random.default_rng(0).choice([1.0, 2.0], size=len(s["t"]), p=[0.97, 0.03])) * 1e-3
    moved_to(s, t)
    for name in ("q", "v", "tau"):
        s[name] = s[name][: len(t)]
