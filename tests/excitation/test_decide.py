"""`idtool excite --decide`: theorems of the criterion, and what the command says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import idtool
from exciting import arm, excited

from idtool.api.excite import _make_task
from idtool.api.model import Model
from idtool.excitation.deciding import Discrimination, Separation
from idtool.excitation.design import predicted_signals
from idtool.excitation.explanations import Explanation
from idtool.excitation.feasibility import scale_to_limits
from idtool.excitation.patterns import Fourier, PatternSpec, Trajectory, TrajectorySegment
from idtool.robot.config import EffectEntry

DRAG = EffectEntry(effect="quadratic_drag", joint="b", parameters={"drag": 0.2})
SMALL_DRAG = EffectEntry(effect="quadratic_drag", joint="b", parameters={"drag": 0.05})
STRIBECK = EffectEntry(effect="stribeck_friction", joint="b", parameters={"stribeck": 0.5, "velocity": 0.4})
HYSTERESIS = EffectEntry(effect="presliding_hysteresis", joint="b", parameters={"amplitude": 0.4, "displacement": 0.03})
OFFSET = EffectEntry(effect="torque_offset", joint="b", parameters={"offset": 0.3})
ROTOR = EffectEntry(effect="rotor_inertia", joint="a", parameters={"inertia": 0.1})
QUICK = ("--iterations", "10", "--duration", "8", "--noise", "0.1")


def separation(
    folder: Path, a: tuple[EffectEntry, ...], b: tuple[EffectEntry, ...], config: str = "{}", noise: float = 0.1
) -> Separation:
    """Separation of two explanations on one random motion."""
    path = folder / "robot.urdf"
    path.write_text(arm())
    (folder / "robot.yaml").write_text(config)
    model = Model(path)
    task, _ = _make_task(
        model.robot, model.settings, None, None, noise, 500.0, 0.1, 0.0, "d", (), lambda stage, share: None
    )
    spec = PatternSpec(task.model, task.limits, task.limits.middle, 10.0)
    pattern = Fourier(spec)
    segment = TrajectorySegment(pattern, pattern.draw(np.random.default_rng(1)))
    trajectory = Trajectory((scale_to_limits(task, segment),))
    explanations = (Explanation("a", a, ""), Explanation("b", b, ""))
    discrimination = Discrimination(task, model.settings, *explanations)
    signals = predicted_signals(task, model.settings, trajectory, 500.0)
    return discrimination.separation([discrimination.rows([signals])])


def test_it_is_symmetric(tmp_path: Path) -> None:
    one = separation(tmp_path, (STRIBECK,), (HYSTERESIS,))
    other = separation(tmp_path, (HYSTERESIS,), (STRIBECK,))
    assert one.significance == pytest.approx(other.significance, rel=1e-6)
    assert one.rms == pytest.approx(other.rms, rel=1e-6)
    assert one.significance > 1


def test_it_is_zero_where_one_explanation_contains_the_other(tmp_path: Path) -> None:
    assert separation(tmp_path, (SMALL_DRAG,), (DRAG, OFFSET)).relative < 1e-6
    assert separation(tmp_path, (DRAG, OFFSET), (SMALL_DRAG,)).relative < 1e-6
    # a rotor on the first joint is inertia of its link, which is free
    assert separation(tmp_path, (ROTOR,), (STRIBECK,)).relative < 1e-6
    assert separation(tmp_path, (DRAG,), (STRIBECK,)).relative > 0.01


def test_torque_of_the_common_model_does_not_count(tmp_path: Path) -> None:
    little = separation(tmp_path, (DRAG,), (STRIBECK,), "friction: {viscous: 0.1, coulomb: 0.2}")
    much = separation(tmp_path, (DRAG,), (STRIBECK,), "friction: {viscous: 0.5, coulomb: 0.6}")
    assert much.significance == pytest.approx(little.significance, rel=1e-6)


def test_more_freedom_of_the_model_separates_less(tmp_path: Path) -> None:
    stiff = separation(tmp_path, (DRAG,), (STRIBECK,), "friction: {viscous: false, coulomb: true}")
    free = separation(tmp_path, (DRAG,), (STRIBECK,), "friction: {viscous: true, coulomb: true}")
    assert free.significance < 0.9 * stiff.significance


def test_it_is_in_units_of_the_noise(tmp_path: Path) -> None:
    one = separation(tmp_path, (DRAG,), (STRIBECK,), noise=0.1)
    twice = separation(tmp_path, (DRAG,), (STRIBECK,), noise=0.2)
    assert one.significance == pytest.approx(2 * twice.significance, rel=1e-9)
    assert one.rms == pytest.approx(twice.rms, rel=1e-9)  # N·m


@pytest.mark.slow
def test_the_command_beats_the_ordinary_design_and_says_so(tmp_path: Path) -> None:
    options = ("--iterations", "60", "--duration", "12", "--noise", "0.1")
    names = ("stribeck_friction:b", "presliding_hysteresis:b")
    report, log = excited(tmp_path, arm(), *options, "--decide", *names)
    decision = report["decide"]
    assert (decision["a"]["name"], decision["b"]["name"]) == names
    assert decision["a"]["source"] == "typical size"
    assert decision["joint"] == "b"
    assert decision["significance"] > 1.1 * decision["ordinary"]["significance"]
    assert decision["logged"] is None
    assert all(max(use.values()) <= 0.9 for use in report["use"].values())
    assert log.signals["vcmd"][0] == pytest.approx(0, abs=1e-9)
    assert log.signals["vcmd"][-1] == pytest.approx(0, abs=1e-9)
    assert "Two explanations" in (tmp_path / "out" / "motion.html").read_text()


def test_parameters_of_the_configuration_are_taken(tmp_path: Path) -> None:
    config = json.dumps({"effects": [DRAG.model_dump(exclude_none=True)]})
    report, _ = excited(tmp_path, arm(), *QUICK, "--decide", "quadratic_drag:b", "stribeck_friction:b", config=config)
    (effect,) = report["decide"]["a"]["effects"]
    assert effect["parameters"] == {"drag": 0.2}
    assert effect["units"] == {"drag": "N·m·s²/rad²"}
    assert report["decide"]["a"]["source"] == "configuration"
    assert report["decide"]["b"]["source"] == "typical size"


def test_explanations_of_files(tmp_path: Path) -> None:
    files = []
    for name, entries in (("one.yaml", [DRAG]), ("two.yaml", [STRIBECK, OFFSET])):
        content = {"effects": [entry.model_dump(exclude_none=True) for entry in entries]}
        (tmp_path / name).write_text(json.dumps(content))
        files.append(str(tmp_path / name))
    report, _ = excited(tmp_path, arm(), *QUICK, "--decide", *files)
    assert [effect["effect"] for effect in report["decide"]["b"]["effects"]] == ["stribeck_friction", "torque_offset"]


def test_without_the_option_nothing_is_decided(tmp_path: Path) -> None:
    report, _ = excited(tmp_path, arm(), *QUICK)
    assert report["decide"] is None


@pytest.mark.parametrize(
    ("explanations", "told"),
    [
        (("stribek:b", "quadratic_drag:b"), "stribek is not an effect; did you mean stribeck_friction?"),
        (("stribeck_friction:c", "quadratic_drag:b"), "c is not a joint of the model; available: a, b"),
        (("stribeck_friction", "quadratic_drag:b"), "stribeck_friction acts on a joint; give stribeck_friction:JOINT"),
        (("quadratic_drag:b", "quadratic_drag:b"), "are the same explanation; give two different ones"),
        (("external_contact:fore", "backlash:b"), "external_contact acts in certain time intervals"),
        (("payload:fore", "backlash:b"), "the parameters of payload:fore are not known; give them under effects"),
        (("rotor_inertia:a", "quadratic_drag:b"), "no log can decide between them"),
        (("missing.yaml", "quadratic_drag:b"), "missing.yaml: "),
    ],
)
def test_errors_a_user_can_act_on(tmp_path: Path, explanations: tuple[str, str], told: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(arm())
    done = idtool("excite", path, *QUICK, "--decide", *explanations, folder=tmp_path)
    assert done.code == 2
    assert told in done.err
    assert done.err.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} == {"robot.urdf"}
