"""The verdict on a model: the stated rules, and what the commands make of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, TRAIN, VALIDATE, idtool

import idtool as package
from idtool.common.notice import Notice
from idtool.reporting.results.rollouts import Horizon, MotionErrors, Simulation, WindowCount
from idtool.reporting.results.verdict import VerdictReason
from idtool.reporting.verdict import motion_reason, next_steps, problem_reasons, torque_reason, worst_level

UNITS = {"hip": "N·m", "knee": "N·m"}


def errors(hip: float, knee: float) -> dict[str, float | None]:
    """Errors by joint, and of both."""
    return {"hip": hip, "knee": knee, "overall": ((hip**2 + knee**2) / 2) ** 0.5}


def torque(error: float, spread: float, prior: float | None = None, floor: float | None = None) -> VerdictReason:
    """Reason by an error that is the same for both joints."""
    prior_errors = None if prior is None else errors(prior, prior)
    noise = None if floor is None else errors(floor, floor)
    shares: Mapping[str, float | None] = {"hip": error / spread, "knee": error / spread}
    return torque_reason(errors(error, error), shares, UNITS, prior_errors, noise, "On held-out data")


TORQUE = {
    "small": (torque(1.0, 10.0), "good", 0.1),
    "large": (torque(4.0, 10.0), "do_not_use", 0.4),
    "large, but noise": (torque(4.0, 10.0, floor=3.0), "good", 0.4),
    "worse than the URDF": (torque(2.0, 10.0, prior=1.5), "do_not_use", 0.2),
    "no better than the URDF, but noise": (torque(2.0, 10.0, prior=1.9, floor=1.9), "good", 0.2),
}


@pytest.mark.parametrize(("reason", "level", "share"), TORQUE.values(), ids=TORQUE)
def test_torque(reason: VerdictReason, level: str, share: float) -> None:
    assert reason.level == level
    assert reason.figure == pytest.approx(share)


def test_joints_with_little_torque_count_little() -> None:
    """A joint that carries nothing has a large relative error, which matters to nobody."""
    reason = torque_reason(errors(0.5, 0.05), {"hip": 0.05, "knee": 1.0}, UNITS, None, None, "On held-out data")
    assert reason.level == "good"
    assert reason.figure == pytest.approx(0.05, rel=0.01)


def test_fitted_data_do_not_tell_prediction() -> None:
    shares = {"hip": 0.1, "knee": 0.1}
    reason = torque_reason(errors(1, 1), shares, UNITS, None, None, "On the data that it was fitted to", True)
    assert reason.level == "torque_only"


def simulation(*horizons: tuple[float, float, float], lost: int = 0, **changes: Any) -> Simulation:
    """A simulation with position errors of the model and of a robot that stands still, after some times."""
    still = MotionErrors(position=errors(0.5, 0.5), velocity=errors(1, 1))
    fields: dict[str, Any] = {
        "kind": "open_loop",
        "window": 1.0,
        "windows": WindowCount(simulated=10, of=10),
        "seconds": 10.0,
        "units": {"hip": "rad", "knee": "rad"},
        "position": errors(0.1, 0.1),
        "velocity": errors(0.1, 0.1),
        "baseline": still,
        "prior": None,
        "horizon": [
            Horizon(seconds=after, position=errors(own, own), baseline=errors(stands, stands), prior=None)
            for after, own, stands in horizons
        ],
        "lost": lost,
        "prior_lost": None,
    }
    return Simulation(**{**fields, **changes})


MOTION = {
    "for long": (simulation((0.01, 0.001, 0.1), (0.1, 0.01, 0.2), (0.5, 0.1, 0.5)), "good", 0.5),
    "for 0.1 s": (simulation((0.01, 0.001, 0.1), (0.1, 0.01, 0.2), (0.5, 0.3, 0.5)), "torque_only", 0.1),
    "only later again": (simulation((0.01, 0.05, 0.1), (0.1, 0.01, 0.2), (0.5, 0.1, 0.5)), "torque_only", 0.0),
    "runs away": (simulation((0.01, 0.001, 0.1), (0.5, 0.1, 0.5), lost=2), "torque_only", None),
    "follows its command": (simulation(kind="closed_loop", window=None), "good", 0.2),
    "does not follow": (
        simulation(kind="closed_loop", window=None, position=errors(0.4, 0.4)),
        "torque_only",
        0.8,
    ),
    "not simulated": (None, "torque_only", None),
}


@pytest.mark.parametrize(("simulated", "level", "figure"), MOTION.values(), ids=MOTION)
def test_motion(simulated: Simulation | None, level: str, figure: float | None) -> None:
    reason = motion_reason(simulated, "it was not simulated")
    assert reason.level == level
    assert reason.figure == (None if figure is None else pytest.approx(figure))


def test_problems_forbid_use() -> None:
    notices = [
        Notice("jitter", "warning", None, "some jitter"),
        Notice("wrong_sign", "problem", "hip", "the torque has the wrong sign"),
        Notice("not_realizable", "problem", None, "judged by another rule"),
    ]
    (reason,) = problem_reasons(notices)
    assert (reason.level, reason.text) == ("do_not_use", "hip: the torque has the wrong sign.")
    assert worst_level([torque(1.0, 10.0), reason]) == "do_not_use"


def reason(about: str, level: str, figure: float | None = 1.0) -> VerdictReason:
    return VerdictReason.model_validate({"about": about, "level": level, "figure": figure, "text": "."})


@pytest.mark.parametrize(
    ("reasons", "starts"),
    [
        ([reason("torque", "good"), reason("motion", "good")], ["Use the model for control and simulation"]),
        ([reason("torque", "good"), reason("motion", "torque_only", None)], ["Use the model for feedforward"]),
        ([reason("torque", "torque_only"), reason("motion", "good")], ["Use the model for feedforward"]),
        ([reason("motion", "torque_only", 0.05)], ["Use the model for feedforward", "Find out what the model lacks"]),
        ([reason("torque", "do_not_use"), reason("motion", "torque_only")], ["Find out what the model lacks"]),
        ([reason("data", "do_not_use"), reason("torque", "do_not_use")], ["First correct the data"]),
        ([reason("torque", "good"), reason("bodies", "do_not_use")], ["Fit again with tighter constraints"]),
        ([reason("torque", "good"), reason("data", "do_not_use")], ["Fit again with another solver"]),
    ],
)
def test_what_to_do_next_follows_from_the_worst_reason(reasons: list[VerdictReason], starts: list[str]) -> None:
    steps = next_steps(reasons)
    assert len(steps) == len(starts)
    assert all(step.startswith(start) for step, start in zip(steps, starts, strict=True))


def test_the_sample_leg_is_good(tmp_path: Path) -> None:
    done = idtool("fit", LEG, TRAIN, "--validate", VALIDATE, "--strict", "--out", tmp_path, "--json")
    assert done.code == 0
    assert done.json["verdict"] == "good"
    assert [reason["about"] for reason in done.json["verdict_reasons"]] == ["torque", "motion", "bodies", "data"]
    assert done.json["noise_floor"]["overall"] == pytest.approx(0.108, rel=0.05)
    assert done.json["next"][0].startswith("Use the model for control and simulation")
    assert done.err.startswith("Verdict: good\n✓ torque: On held-out data, the torque error is 2.2 %")
    page = (tmp_path / "report.html").read_text()
    parts = ('<p class="verdict good">Good</p>', "What to do next", "<nav>", 'id="part-2"')
    places = [page.index(part) for part in parts]
    assert places == sorted(places)


def test_a_wrong_sign_must_not_be_used(tmp_path: Path) -> None:
    """Neither the model that is fitted to such a log, nor its validation."""
    log = package.Log(TRAIN)
    wrong = package.Log.from_arrays("wrong", log.t, log.joints, q=log.q, v=log.v, tau=-log.tau).save(tmp_path / "w.csv")
    done = idtool("validate", LEG, wrong, "--strict", "--no-simulation", "--out", tmp_path / "out")
    assert done.code == 1
    assert done.out.startswith("Verdict: do not use\n✗ torque: On these logs, the torque error is ")
    assert "--strict: the verdict is that the model must not be used" in done.out
    assert idtool("validate", LEG, wrong, "--no-simulation", "--out", tmp_path / "out").code == 0


def test_a_problem_of_the_log_is_the_first_reason() -> None:
    log = package.Log(TRAIN)
    tau = np.asarray(log.tau) * [1, -1, 1]
    result = package.fit(LEG, package.Log.from_arrays("wrong", log.t, log.joints, q=log.q, v=log.v, tau=tau))
    first = result.verdict_reasons[0]
    assert (first.about, first.level) == ("data", "do_not_use")
    assert "hip" in first.text
    assert result.next[0].startswith("First correct the data")


def test_what_was_not_simulated_is_good_for_torque_only(tmp_path: Path) -> None:
    result = package.fit(LEG, TRAIN, quick=True)
    assert result.verdict == "torque_only"
    assert result.noise_floor is None
    assert "as with --quick or --no-simulation" in result.verdict_reasons[1].text
