"""How far simulations are from logs: sums and baselines by hand, which windows, and models that cannot be simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import chain, link

from idtool.data.logs import make_log, write_log
from idtool.dynamics.simulation.simulation import SimulatedWindows
from idtool.dynamics.simulation.windows import Window
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.evaluation import rollouts as module
from idtool.estimation.evaluation.rollouts import HORIZONS, RolloutError, RolloutEvaluation, evaluate_rollouts
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]
Build = Callable[..., Experiment]

DISC = '<inertial><mass value="1"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="{}"/></inertial>'
INERTIA = (0.03, 0.05)  # kg·m² about each joint's axis, which is vertical: no gravity acts on it
RATE = 200.0  # Hz
NAN = float("nan")


def quietly(stage: str, share: float) -> None:
    """Progress that nobody looks at."""


@pytest.fixture
def discs(tmp_path: Path) -> Build:
    """An experiment on discs that turn about one vertical axis, every log validated on."""

    def build(*logs: dict[str, Array], **config: Any) -> Experiment:
        urdf = chain(link(1), link(2))
        for i, inertia in enumerate(INERTIA, start=1):
            urdf = urdf.replace(f'<link name="l{i}"/>', f'<link name="l{i}">{DISC.format(inertia)}</link>')
        (tmp_path / "discs.urdf").write_text(urdf)
        paths = []
        for number, signals in enumerate(logs):
            paths.append(tmp_path / f"log{number}.csv")
            t = np.arange(len(signals["q"])) / RATE
            write_log(paths[-1], make_log(paths[-1], t, ("j1", "j2"), signals))
        return prepare(read_robot(tmp_path / "discs.urdf"), parse_config(config, "c.yaml"), [], paths)

    return build


def swinging(seconds: float) -> dict[str, Array]:
    """Two discs that swing, and the torque that it takes, by Newton's law."""
    t = np.arange(round(seconds * RATE)) / RATE
    phase = np.stack([3 * t, 4 * t + 1], axis=1)
    swing, rate = np.array([0.5, -0.3]), np.array([3.0, 4.0])
    a = -swing * rate**2 * np.sin(phase)
    second = INERTIA[1] * (a[:, 0] + a[:, 1])
    tau = np.stack([INERTIA[0] * a[:, 0] + second, second], axis=1)
    return {"q": swing * np.sin(phase), "v": swing * rate * np.cos(phase), "tau": tau}


def test_errors_are_summed_from_the_sample_after_the_start() -> None:
    departure = RolloutError.none(2)
    measured = SimpleNamespace(
        q=np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]]), v=np.array([[9.0, 1.0, NAN], [9.0, 1.0, 1.0]])
    )
    departure.add(measured, np.array([[5.0, 1.5, 2.0], [5.0, 0.0, 3.0]]), np.full((2, 3), 3.0), 0.01)
    assert departure.position.tolist() == [0.25, 9.0]
    assert (departure.samples, departure.speeds) == (2, 1)  # a sample at which a velocity is not known counts for none
    assert departure.velocity.tolist() == [4.0, 4.0]
    position = departure.rmse(("a", "b"), "position")
    assert position == pytest.approx({"a": 0.125**0.5, "b": 4.5**0.5, "overall": (9.25 / 4) ** 0.5})
    assert departure.rmse(("a", "b"), "velocity") == {"a": 2.0, "b": 2.0, "overall": 2.0}
    assert departure.horizon(("a", "b"), 0.01) == pytest.approx({"a": 0.5, "b": 0.0, "overall": 0.125**0.5})
    assert departure.horizon(("a", "b"), 0.05) is None


def test_rollouts_add_up() -> None:
    departure = RolloutError.none(1)
    for error, length in ((1.0, 3), (2.0, 7)):
        still = np.zeros((1, length))
        departure.add(SimpleNamespace(q=still, v=still), still + error, still, 0.01)
    assert departure.rmse(("a",), "position")["a"] == pytest.approx(((2 * 1 + 6 * 4) / 8) ** 0.5)
    assert departure.horizon(("a",), 0.01) == pytest.approx({"a": 2.5**0.5, "overall": 2.5**0.5})
    assert departure.horizon(("a",), 0.05) == pytest.approx({"a": 2.0, "overall": 2.0})  # of the longer one alone


def test_the_true_model_follows_the_log_and_a_heavier_one_does_not(discs: Build) -> None:
    """Half the acceleration from the same start: after h, an error of a h² / 4, at any start of the swing."""
    experiment = discs(swinging(6))
    theta = experiment.equation.prior
    found = evaluate_rollouts(experiment, {"model": theta, "prior": 2 * theta}, True, quietly)
    assert (found.kind, found.window, found.windows, found.available) == ("open_loop", 1.0, 6, 6)
    assert (dict(found.diverged), found.failed) == ({"model": 0, "prior": 0}, {})
    model, prior = found.errors["model"], found.errors["prior"]
    assert model.rmse(("j1", "j2"), "position")["overall"] < 1e-3
    assert model.rmse(("j1", "j2"), "velocity")["overall"] < 1e-2
    early = prior.horizon(("j1", "j2"), 0.05)
    starts = np.arange(6)
    a = np.stack([0.5 * 9 * np.sin(3 * starts), 0.3 * 16 * np.sin(4 * starts + 1)])
    assert early is not None
    assert [early["j1"], early["j2"]] == pytest.approx(np.sqrt(np.mean(a**2, axis=1)) * 0.05**2 / 4, rel=0.1)


def test_open_loop_the_baseline_stays_as_it_was(discs: Build) -> None:
    """Of a motion at constant velocity: off by v k dt after k samples, in every window, and the velocity is right."""
    t = np.arange(round(4 * RATE)) / RATE
    q = np.stack([0.7 * t, -0.2 * t], axis=1)
    experiment = discs({"q": q, "tau": np.zeros_like(q)}, simulation={"window": 0.5})
    found = evaluate_rollouts(experiment, {}, True, quietly)
    baseline = found.errors["baseline"]
    k = np.arange(1, round(0.5 * RATE) + 1)
    # the last window ends a sample early: the log has none after it
    squares = (np.sum((k / RATE) ** 2) * 8 - 0.5**2) / (8 * len(k) - 1)
    assert baseline.rmse(("j1", "j2"), "position")["j1"] == pytest.approx(0.7 * squares**0.5, rel=1e-9)
    assert baseline.rmse(("j1", "j2"), "position")["j2"] == pytest.approx(0.2 * squares**0.5, rel=1e-9)
    assert baseline.rmse(("j1", "j2"), "velocity")["overall"] < 1e-9
    for seconds in HORIZONS:
        after = baseline.horizon(("j1", "j2"), seconds)
        assert after is not None
        assert after["j1"] == pytest.approx(0.7 * seconds, rel=1e-9)


@pytest.mark.parametrize("given", [True, False])
def test_closed_loop_the_baseline_is_the_command(discs: Build, given: bool) -> None:
    """Its velocity is the one commanded, else the derivative of the position commanded."""
    signals = swinging(3)
    ahead = {"qcmd": signals["q"] + [0.05, -0.02], **({"vcmd": signals["v"] + [1.0, 2.0]} if given else {})}
    experiment = discs(
        {"q": signals["q"], "v": signals["v"], **ahead}, controller={"kp": {"j1": 5, "j2": 5}, "kd": {"j1": 1, "j2": 1}}
    )
    found = evaluate_rollouts(experiment, {}, True, quietly)
    assert (found.kind, found.window, found.windows) == ("closed_loop", None, 1)
    baseline = found.errors["baseline"]
    position, velocity = (baseline.rmse(("j1", "j2"), quantity) for quantity in ("position", "velocity"))
    assert position == pytest.approx({"j1": 0.05, "j2": 0.02, "overall": (0.0029 / 2) ** 0.5}, rel=1e-9)
    wanted = (1.0, 2.0) if given else (0.0, 0.0)
    assert (velocity["j1"], velocity["j2"]) == pytest.approx(wanted, abs=2e-3)


def test_of_logs_of_both_kinds_those_with_a_command_are_simulated(discs: Build) -> None:
    torque = swinging(3)
    command = {"q": torque["q"], "v": torque["v"], "qcmd": torque["q"]}
    for logs in ((torque, command), (command, torque)):
        experiment = discs(*logs, controller={"kp": {"j1": 5, "j2": 5}})
        found = evaluate_rollouts(experiment, {"model": experiment.equation.prior}, True, quietly)
        assert (found.kind, found.windows, found.available, len(found.traces)) == ("closed_loop", 1, 1, 1)


@pytest.mark.parametrize(("many_joints", "windows"), [(2, 60), (1, 15), (0.1, 1)])
def test_of_many_joints_fewer_windows_are_simulated(
    discs: Build, monkeypatch: pytest.MonkeyPatch, many_joints: float, windows: int
) -> None:
    """60 s, less by the square of how many times as many joints there are, and one window at least."""
    monkeypatch.setattr(module, "_MANY_JOINTS", many_joints)
    experiment = discs(swinging(80))
    found = evaluate_rollouts(experiment, {"model": experiment.equation.prior}, True, quietly)
    assert (found.windows, found.available) == (windows, 80)


def test_of_a_long_log_windows_are_simulated_that_spread_over_it(discs: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute of two logs, 150 and 50 s long; what the simulation gave is what is compared."""
    seen: dict[str, list[int]] = {}

    def nearly(mechanism: object, windows: Sequence[Window], tell: object) -> Iterator[SimulatedWindows]:
        for window in windows:
            part, channels = window.part, window.signals.channels
            seen.setdefault(window.signals.log.path.name, []).append(part.start)
            q, v = channels.signal("q", part)[:, None], window.signals.velocity(part)[:, None]
            yield SimulatedWindows((window,), q + 0.1, v - 0.2, q, np.array([window is windows[-1]]))

    monkeypatch.setattr(module, "simulate", nearly)
    experiment = discs(swinging(150), swinging(50))
    found = evaluate_rollouts(experiment, {"model": experiment.equation.prior}, True, quietly)
    assert (found.windows, found.available) == (60, 200)
    starts = {name: np.array(samples) / RATE for name, samples in seen.items()}
    assert [len(t) for t in starts.values()] == [45, 15]
    for t, seconds in zip(starts.values(), (150, 50), strict=True):
        assert t[0] < 3
        assert t[-1] > seconds - 5
        assert set(np.round(np.diff(t))) <= {3, 4}
    model = found.errors["model"]
    assert model.rmse(("j1", "j2"), "position") == pytest.approx({"j1": 0.1, "j2": 0.1, "overall": 0.1})
    assert model.rmse(("j1", "j2"), "velocity")["overall"] == pytest.approx(0.2)
    assert found.diverged == {"model": 1}
    drawn = found.traces[0].curves
    there = np.isfinite(drawn["model"]) & np.isfinite(drawn["measured"])
    assert there.mean() > 0.25
    np.testing.assert_allclose((drawn["model"] - drawn["measured"])[there], 0.1, atol=1e-9)


def test_a_model_that_cannot_be_simulated_does_not_keep_the_others(discs: Build) -> None:
    experiment = discs(swinging(3), swinging(3))
    theta = experiment.equation.prior
    found: RolloutEvaluation = evaluate_rollouts(experiment, {"model": theta, "prior": 0 * theta}, True, quietly)
    assert set(found.errors) == {"model", "baseline"}
    assert set(found.failed) == {"prior"}
    assert "discs.urdf: cannot be simulated" in found.failed["prior"]
    assert found.errors["model"].rmse(("j1", "j2"), "position")["overall"] < 1e-3
    assert all("prior" not in trace.curves for trace in found.traces)
