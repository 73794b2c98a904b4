"""What `idtool init` makes of the logs themselves: which joints, which topic, what torque, and what is odd."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refuse
from prescribed_motions import Log, silent
from recordings import State, ros2, write_mcap
from sentences import sentences, texts
from spatial_arm import ARM, JOINTS
from starts import arm, as_csv, as_states, robot

from idtool.common.exceptions import ConfigError, LogError
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot
from idtool.setup.log_summary import LogSummary, summarize_logs

MIMIC = (
    '<link name="finger"/><joint name="close" type="revolute"><parent link="tool"/><child link="finger"/>'
    '<axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="9" velocity="9"/><mimic joint="roll" multiplier="-0.5"/>'
    "</joint></robot>"
)


def told(folder: Path, *logs: Path, text: str = ARM, **given: Any) -> LogSummary:
    """What logs tell, with a configuration given."""
    return summarize_logs(read_robot(robot(folder, text)), logs, parse_config(given, "given.yaml"), silent)


def csv(folder: Path, log: Log, *signals: str, name: str = "run.csv") -> Path:
    return as_csv(folder / name, log, signals=signals)


def moved() -> Log:
    """Four seconds of the arm, with commands."""
    log = arm(4.0)
    return {**log, "qcmd": log["q"] + 0.01}


def without(log: Mapping[str, Any], signal: str, joint: int, value: float = 0.0) -> Log:
    """A log in which a joint's signal never changes."""
    column = log[signal].copy()
    column[:, joint] = value
    return {**log, signal: column}


def test_torque_that_never_changes_is_none_where_there_is_a_command(tmp_path: Path) -> None:
    seen = told(tmp_path, csv(tmp_path, without(moved(), "tau", 1), "q", "v", "tau", "qcmd"))
    assert (seen.joints, seen.commanded) == (JOINTS, ("lift",))
    assert not seen.logs[0].has("tau", "lift")  # so that trials take the controller's
    assert seen.logs[0].has("tau", "turn")
    assert any("treated as if it were not logged: lift" in warning for warning in sentences(seen.notices))


def test_torque_that_never_changes_is_that_of_a_passive_joint_where_it_is_asked_for(tmp_path: Path) -> None:
    log = csv(tmp_path, without(moved(), "tau", 1), "q", "v", "tau")
    seen = told(tmp_path, log, joints=list(JOINTS))
    assert (seen.joints, seen.commanded, seen.without_torque) == (JOINTS, (), {})
    assert seen.logs[0].has("tau", "lift")


@pytest.mark.parametrize("tau", ["zero", "missing"])
def test_joint_that_moves_without_torque_is_not_held_still_without_a_word(tmp_path: Path, tau: str) -> None:
    log = csv(tmp_path, without(moved(), "tau", 1, 0.0 if tau == "zero" else np.nan), "q", "v", "tau")
    seen = told(tmp_path, log)
    assert seen.joints == ("turn", "roll")
    assert seen.locked["lift"].reason == "has neither torque nor position command in run.csv"
    assert seen.without_torque == {"lift": "run.csv"}
    assert "these locked joints move in the logs, which affects the torque of the other joints: lift" in sentences(
        seen.notices
    )


def test_joints_that_stand_still_are_no_reason_for_a_word(tmp_path: Path) -> None:
    still = without(without(moved(), "q", 1, 0.3), "v", 1)
    seen = told(tmp_path, csv(tmp_path, still, "q", "v", "tau"))
    assert (seen.joints, seen.without_torque, sentences(seen.notices)) == (("turn", "roll"), {}, ())
    still = without(still, "tau", 1, np.nan)
    seen = told(tmp_path, csv(tmp_path, still, "q", "v", "tau"))
    assert (seen.joints, seen.without_torque, sentences(seen.notices)) == (("turn", "roll"), {}, ())
    asked = told(tmp_path, csv(tmp_path, still, "q", "v", "tau"), joints=list(JOINTS))
    assert asked.commanded == ()
    assert (asked.joints, asked.moving, asked.identifiable) == (JOINTS, ("turn", "roll"), ("turn", "roll"))
    assert any("so they cannot be identified: lift" in warning for warning in sentences(asked.notices))


def test_gains_are_needed_of_a_joint_that_is_asked_for_though_it_stands_still(tmp_path: Path) -> None:
    still = without(without(moved(), "q", 1, 0.3), "v", 1)
    assert told(tmp_path, csv(tmp_path, still, "q", "v", "qcmd"), joints=list(JOINTS)).commanded == JOINTS


def test_of_a_log_with_torque_and_one_with_commands_joints_are_commanded(tmp_path: Path) -> None:
    logs = csv(tmp_path, moved(), "q", "v", "tau", name="a.csv"), csv(tmp_path, moved(), "q", "qcmd", name="b.csv")
    assert told(tmp_path, *logs).commanded == JOINTS
    assert told(tmp_path, logs[0]).commanded == ()


def test_joints_given_as_held_still_are(tmp_path: Path) -> None:
    seen = told(tmp_path, csv(tmp_path, moved(), "q", "v", "tau"), locked_joints={"lift": 0.2})
    assert seen.joints == ("turn", "roll")
    assert seen.locked["lift"].reason == "locked in the configuration"
    assert any(warning.startswith("these locked joints move") for warning in sentences(seen.notices))
    with pytest.raises(ConfigError, match="is not an actuated joint of the URDF"):
        told(tmp_path, csv(tmp_path, moved(), "q", "v", "tau"), joints=["left"])


def test_joint_that_follows_another_is_neither_identified_nor_held(tmp_path: Path) -> None:
    log = moved()
    more = {name: np.column_stack([log[name], log[name][:, 2]]) for name in ("q", "v", "tau")}
    file = as_csv(tmp_path / "run.csv", {**log, **more}, (*JOINTS, "close"), ("q", "v", "tau"))
    seen = told(tmp_path, file, text=ARM.replace("</robot>", MIMIC))
    assert (seen.joints, seen.locked) == (JOINTS, {})


def test_position_far_beyond_the_limits_is_said(tmp_path: Path) -> None:
    log = moved()
    degrees = {**log, "q": np.rad2deg(log["q"]), "v": np.rad2deg(log["v"])}
    seen = told(tmp_path, csv(tmp_path, degrees, "q", "v", "tau"))
    (said,) = [warning for warning in texts(seen.notices) if "limits" in warning]
    assert said.startswith("run.csv: q is far outside the URDF's limits: turn, lift, roll (")
    assert "set log.scale of q and v to 0.0174533" in said
    scale = dict.fromkeys(JOINTS, np.pi / 180)
    assert not told(tmp_path, csv(tmp_path, degrees, "q", "v", "tau"), log={"scale": {"q": scale, "v": scale}}).notices
    beyond = {**log, "q": log["q"] + 3.5}  # a zero that is off
    assert not told(tmp_path, csv(tmp_path, beyond, "q", "v", "tau")).notices
    free = ARM.replace('lower="-3" upper="3"', 'lower="0" upper="0"')
    assert not told(tmp_path, csv(tmp_path, log, "q", "v", "tau"), text=free).notices


def test_problems_are_said_and_notes_are_not(tmp_path: Path) -> None:
    stuck = told(tmp_path, csv(tmp_path, without(moved(), "v", 1), "q", "v", "tau"))
    (said,) = texts(stuck.notices)
    assert said.startswith("run.csv: lift: v is 0 throughout while q moves; the channel was not recorded")
    assert told(tmp_path, csv(tmp_path, moved(), "q", "tau")).notices == ()  # that v is missing is a note


def test_without_any_torque_the_error_names_the_columns_that_were_left_over(tmp_path: Path) -> None:
    file = csv(tmp_path, moved(), "q", "v", "tau")
    file.write_text(file.read_text().replace("tau_", "current_"))
    with pytest.raises(LogError) as caught:
        told(tmp_path, file)
    said = str(caught.value)
    assert "has neither torque nor position command in run.csv: turn, lift, roll" in said
    assert "map the column of the torque to tau_turn in log.columns, and set its N·m per unit in log.scale" in said
    assert "ignored: current_turn, current_lift, current_roll" in said
    refuse(tmp_path, "init", tmp_path / "arm.urdf", file, naming="current_turn", file="run.csv")


def mcap(folder: Path, name: str = "run.mcap", **topics: Sequence[State]) -> Path:
    return write_mcap(folder / name, *(ros2(states, f"/{topic}") for topic, states in topics.items()))


def only(states: Sequence[State], count: int = 3, *signals: str) -> list[State]:
    """The states of the first joints, with some signals alone."""
    kept = [
        (state.position, state.velocity if "v" in signals else (), state.effort if "tau" in signals else ())
        for state in states
    ]
    cut = [[values[:count] for values in one] for one in kept]
    return [State(s.stamp, JOINTS[:count], *one, "", s.logged) for s, one in zip(states, cut, strict=True)]


def test_topic_is_the_one_with_most_joints_then_most_signals(tmp_path: Path) -> None:
    states = as_states(arm(4.0))
    two, bare, whole = only(states, 2, "v", "tau"), only(states, 3, "v"), only(states, 3, "v", "tau")
    assert told(tmp_path, mcap(tmp_path, two=two, whole=whole)).topic == "/whole"
    assert told(tmp_path, mcap(tmp_path, bare=bare, whole=whole)).topic == "/whole"
    far = only(states, 1, "v", "tau")
    with pytest.raises(LogError, match="neither torque nor position command"):  # joints go before signals
        told(tmp_path, mcap(tmp_path, far=far, bare=only(states, 2)))


def test_topic_that_is_no_log_is_passed_over(tmp_path: Path) -> None:
    """One whose time stands still; and efforts that are sent to the joints, which have the type of their states."""
    states = as_states(arm(4.0))
    held = [replace(state, stamp=states[0].stamp) for state in states]
    assert told(tmp_path, mcap(tmp_path, held=held, joint_states=states)).topic == "/joint_states"
    commands = [replace(state, position=(), velocity=()) for state in states]
    assert told(tmp_path, mcap(tmp_path, joint_command=commands, joint_states=states)).joints == JOINTS


def test_topic_is_one_that_all_logs_have(tmp_path: Path) -> None:
    states = as_states(arm(4.0))
    both = mcap(tmp_path, whole=states, part=only(states, 2, "v", "tau"))
    seen = told(tmp_path, both, mcap(tmp_path, "other.mcap", part=only(states, 2, "v", "tau")))
    assert (seen.topic, seen.joints) == ("/part", ("turn", "lift"))
    with pytest.raises(LogError, match="no topic in common"):
        told(tmp_path, both, mcap(tmp_path, "other.mcap", else_=states))
