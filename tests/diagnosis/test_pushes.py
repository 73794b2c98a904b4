"""Pushes that come and go slowly are found with link, point and profile; what joints do by themselves is none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
from commands import idtool
from disturbed import Array, Hidden, experiment_of, torque_on_joint
from hidden_effects.case_files import write_case
from hidden_effects.case_list import Case
from hidden_effects.effects import HiddenEffect
from spatial_arm import NOISE, RATE, Log, experiment, recorded, spec_of, written

from idtool.diagnosis.bursts import find_bursts
from idtool.dynamics.effects.data_summary import Burst

SECONDS = 8.0
FORCE = np.array([4.0, -3.0, 5.0])
POINT = np.array([0.1, -0.05, 0.2])
WINDOWS = ((2.0, 2.4), (5.1, 6.3))


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


def half_sines(t: Array) -> Array:
    """Share of the force that acts."""
    share = np.zeros_like(t)
    for begin, end in WINDOWS:
        inside = (t > begin) & (t < end)
        share[inside] = np.sin(np.pi * (t[inside] - begin) / (end - begin))
    return share


def trapezoids(t: Array) -> Array:
    """The same, with rises and falls of 0.1 s."""
    return sum(np.clip(np.minimum(t - begin, end - t) / 0.1, 0.0, 1.0) for begin, end in WINDOWS)


def steep_trapezoids(t: Array) -> Array:
    """The same, with rises and falls of 0.01 s: as sharp as a contact."""
    return sum(np.clip(np.minimum(t - begin, end - t) / 0.01, 0.0, 1.0) for begin, end in WINDOWS)


def pushed(link: str, share: Callable[[Array], Array]) -> Log:
    """MuJoCo's arm with a force at a point of a link."""
    model = spec_of().compile()
    body = model.body(link).id

    def act(data: Any) -> None:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        force = share(np.array([data.time - 0.5 / RATE]))[0] * FORCE
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ POINT
        mujoco.mj_applyFT(model, data, force, np.zeros(3), point, body, data.qfrc_applied)

    return recorded(model, SECONDS, act, steps=2)


def found(folder: Path, log: Log) -> tuple[Burst, ...]:
    urdf, csv = written(folder, log, noise=NOISE)
    tried = experiment(urdf, csv)
    return find_bursts(tried, tried.equation.prior, silent)


@pytest.mark.parametrize("share", [half_sines, trapezoids])
def test_a_push_is_found_with_its_link_point_and_profile(tmp_path: Path, share: Callable[[Array], Array]) -> None:
    (burst,) = found(tmp_path, pushed("fore", share))
    assert burst.link == "fore"
    np.testing.assert_allclose(burst.windows, WINDOWS, atol=0.03)
    np.testing.assert_allclose(burst.point, POINT, atol=0.01)
    t = np.arange(0.0, SECONDS, 0.01)
    np.testing.assert_allclose(np.interp(t, *np.transpose(burst.profile)), share(t), atol=0.06)


def test_what_begins_sharply_may_be_a_contact_or_a_push(tmp_path: Path) -> None:
    """Only the push has a profile in time; which of the two explains more is for the search to find out."""
    contact, push = found(tmp_path, pushed("fore", steep_trapezoids))
    assert not contact.link
    assert push.link == "fore"
    np.testing.assert_allclose(contact.windows, WINDOWS, atol=0.01)
    np.testing.assert_allclose(push.windows, WINDOWS, atol=0.04)
    np.testing.assert_allclose(push.point, POINT, atol=0.01)


def test_a_push_of_another_link_needs_that_link(tmp_path: Path) -> None:
    """The third joint feels nothing of it, which no force at a fixed point of the third link does in all poses."""
    bursts = found(tmp_path, pushed("upper", trapezoids))
    assert "upper" in [burst.link for burst in bursts]


def test_windows_that_disagree_are_no_push(tmp_path: Path) -> None:
    """One force in the first, and joints that have nothing to do with each other in the second."""
    log = pushed("fore", lambda t: trapezoids(t) * (t < 4))
    second = np.clip(np.minimum(log["t"] - 5.1, 6.3 - log["t"]) / 0.1, 0.0, 1.0)
    log["tau"] += np.outer(second, [2.0, 0.0, 0.0]) + np.outer(second * np.sin(7 * log["t"]), [0.0, 2.0, 1.0])
    assert found(tmp_path, log) == ()


def on_both(first: Callable[..., Array], second: Callable[..., Array]) -> Hidden:
    """Torques on both joints."""
    hidden = [torque_on_joint(0, first), torque_on_joint(1, second)]
    return lambda *state: hidden[0](*state) + hidden[1](*state)


def window(t: Array) -> Array:
    """From 5 to 8 s, come and gone within 0.3 s each."""
    return np.clip(np.minimum(t - 5.0, 8.0 - t) / 0.3, 0.0, 1.0)


NO_PUSHES: dict[str, Hidden] = {
    "each joint as it likes": on_both(
        lambda t, q, v, tau: 2 * window(t), lambda t, q, v, tau: 2 * window(t) * np.sin(3 * t)
    ),
    "friction of both joints for a time": on_both(
        lambda t, q, v, tau: window(t) * np.tanh(v / 0.01), lambda t, q, v, tau: window(t) * np.tanh(v / 0.01)
    ),
    "shaking of both joints": on_both(
        lambda t, q, v, tau: window(t) * np.sin(40 * t), lambda t, q, v, tau: window(t) * np.sin(40 * t)
    ),
    "both joints near a position": on_both(
        lambda t, q, v, tau: 10 * np.maximum(q - 0.7, 0.0), lambda t, q, v, tau: 10 * np.maximum(q - 0.5, 0.0)
    ),
    "steps of both joints all the time": on_both(
        lambda t, q, v, tau: np.sign(np.sin(0.9 * t)), lambda t, q, v, tau: np.sign(np.sin(1.7 * t))
    ),
}


@pytest.mark.parametrize("hidden", NO_PUSHES.values(), ids=NO_PUSHES)
def test_what_joints_do_by_themselves_is_no_push(tmp_path: Path, hidden: Hidden) -> None:
    experiment = experiment_of(tmp_path, hidden)
    assert find_bursts(experiment, experiment.equation.prior, silent) == ()


@pytest.mark.slow
@pytest.mark.parametrize("form", ["trapezoid_push", "half_sine_push"])
def test_diagnose_names_the_contact_and_leaves_noise(tmp_path: Path, form: str) -> None:
    hidden = HiddenEffect("external_contact", None, "lower", "strong", {"form": form})
    files = write_case(Case(form, "planar2", (hidden,), 3, "refit", 24.0), tmp_path / "case")
    command = ["diagnose", files.urdf, files.log, "--config", files.config, "--out", tmp_path / "out", "--json"]
    done = idtool(*command, "--no-simulation")
    assert done.code == 0, done.err
    (step,) = done.json["steps"]
    assert (step["effect"], step["link"]) == ("external_contact", "lower")
    assert done.json["gap_closed"]["overall"] > 0.98
