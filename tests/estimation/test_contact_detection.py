"""Contacts of a quadruped in MuJoCo by the torque of its legs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import Recording, config_text, write_csv
from ground.quadruped import FEET, JOINTS
from ground.robot import prior_robot, urdf_text
from quadruped_recordings import TRUTH, record_quadruped

from idtool.common.exceptions import LogError
from idtool.common.safe_yaml import parse_yaml
from idtool.data.base_sensors import needed_channels
from idtool.data.controller import with_unknown_torque
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.sensor_channels import with_sensors
from idtool.estimation.dataset.contact_detection import with_detected_contacts
from idtool.robot.config import Config, parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot


@pytest.fixture(scope="module")
def walk() -> Recording:
    return record_quadruped("walk", 4.0, seed=1)


@pytest.fixture(scope="module")
def hang() -> Recording:
    return record_quadruped("hang", 2.0)


def settings(flag: str | None, flag_of_rope: str | None = None) -> Config:
    """Configuration in which all feet have a flag of one kind, and the rope has; None: their own."""
    content: dict[str, Any] = dict(parse_yaml(Path("quadruped.yaml"), config_text(TRUTH).encode()))
    if flag is not None:
        content["contacts"] = [
            {**contact, "flag": flag} if contact["kind"] == "point" else contact for contact in content["contacts"]
        ]
    if flag_of_rope is not None:
        (*feet, rope) = content["contacts"]
        content["contacts"] = [*feet, {**rope, "flag": flag_of_rope}]
    return parse_config(content, "")


def detected(
    folder: Path, recording: Recording, flag: str | None, flag_of_rope: str | None = None, **columns: np.ndarray
) -> JointLog:
    """Log of a recording with other columns, after the detection with the URDF whose masses are 10 to 30 % off."""
    config = settings(flag, flag_of_rope)
    write_csv(folder / "log.csv", Recording({**recording.columns, **columns}))
    (folder / "prior.urdf").write_text(urdf_text(prior_robot(TRUTH, 0)))
    model = build_model(read_robot(folder / "prior.urdf"), config, JOINTS)
    log = with_sensors(read_log(folder / "log.csv"), needed_channels(config))
    log = with_unknown_torque(log, None)
    return with_detected_contacts(log, model, config)


def test_steps_are_detected(tmp_path: Path, walk: Recording) -> None:
    """Within 30 ms of where the force on the foot is above 8 N, a twentieth of the weight."""
    log = detected(tmp_path, walk, "auto")
    for foot in FEET:
        channel = log.channels[f"contact_{foot} (detected)"]
        force = np.interp(channel.t, walk.columns["t"], walk.columns[f"force_{foot}_z"])
        is_clear = (force < 1) | (force > 20)
        is_right = (channel.x > 0.5) == (force > 8)
        assert is_right[is_clear].mean() > 0.93
    (notice,) = [one for one in log.notices if one.code == "contacts_detected"]
    assert all(foot in notice.message for foot in FEET)


def test_legs_in_the_air_have_no_contact(tmp_path: Path, hang: Recording) -> None:
    log = detected(tmp_path, hang, "auto")
    assert all(log.channels[f"contact_{foot} (detected)"].x.mean() < 0.15 for foot in FEET)


def test_support_is_closed_while_no_other_contact_is(tmp_path: Path, walk: Recording) -> None:
    """Over the second half, in which the flags of all feet are off, and not in their short gaps before."""
    t = walk.columns["t"]
    flags = {}
    for foot in FEET:
        flag = np.ones(len(t))
        flag[(t > 0.5) & (t < 0.6)] = 0.0
        flag[t > 2.0] = 0.0
        flags[f"contact_{foot}"] = flag
    log = detected(tmp_path, walk, None, "auto", **flags)
    support = log.channels["contact_rope (detected)"]
    np.testing.assert_array_equal(support.x > 0.5, support.t > 2.0)
    both = (support.t > 1.9) & (support.t < 2.1)  # closed on both sides of the change
    feet = log.channels["contact_FL_foot"].is_set(support.t, widen=0.12)
    assert np.all(support.is_set(support.t, widen=0.12)[both] & feet[both])
    (notice,) = [one for one in log.notices if one.code == "support_detected"]
    assert "contact rope counts as closed while no other contact is: 50 % of the time" in notice.message


@pytest.mark.parametrize("flag", ["auto", None])
def test_support_knows_the_feet_by_their_flags_or_their_legs(
    tmp_path: Path, walk: Recording, hang: Recording, flag: str | None
) -> None:
    name = "contact_rope (detected)"
    assert detected(tmp_path, walk, flag, "auto").channels[name].x.mean() == 0.0
    assert detected(tmp_path, hang, flag, "auto").channels[name].x.mean() > 0.95


def test_flags_that_do_not_fit_the_load_are_named(tmp_path: Path, walk: Recording, hang: Recording) -> None:
    foot = "contact_FL_foot"
    never = detected(tmp_path, walk, None, **{foot: 0 * walk.columns[foot]})
    assert [(one.code, one.subject) for one in never.notices] == [("contact_without_flag", "FL_foot")]
    always = detected(tmp_path, hang, None, **{foot: 0 * hang.columns[foot] + 1})
    assert [(one.code, one.subject) for one in always.notices] == [("contact_always_closed", "FL_foot")]
    assert not detected(tmp_path, walk, None).notices
    assert not detected(tmp_path, hang, None).notices


def test_posture_in_which_the_torque_hardly_tells_the_force_says_nothing_against_a_flag(tmp_path: Path) -> None:
    """The calf of RL folds to -3 rad, where the URDF's error in torque would be a force of half the weight."""
    folded = record_quadruped("hang", 3.5, seed=1)
    assert folded.columns["q_RL_calf_joint"].min() < -2.9
    assert not detected(tmp_path, folded, None).notices


def test_leg_without_torque_tells_nothing_of_its_foot(tmp_path: Path, walk: Recording) -> None:
    """Its torque counts as 0, by which the foot would never carry a load."""
    no_torque = {f"tau_FL_{part}_joint": np.zeros(len(walk.columns["t"])) for part in ("hip", "thigh", "calf")}
    always_set = np.ones(len(walk.columns["t"]))
    log = detected(tmp_path, walk, None, **no_torque, contact_FL_foot=always_set)
    assert [one.code for one in log.notices] == ["torque_unknown"]
    needed = (
        "has no torque of FL_hip_joint, FL_thigh_joint, FL_calf_joint, which the flag auto of contact FL_foot needs"
    )
    with pytest.raises(LogError, match=needed):
        detected(tmp_path, walk, "auto", **no_torque)


@pytest.mark.parametrize(
    ("scale", "code"), [(1.0, None), (-1.0, "torque_sign"), (1 / 6.33, "torque_scale"), (6.33, "torque_scale")]
)
@pytest.mark.parametrize("flag", [None, "auto"])
def test_torque_by_which_the_feet_do_not_carry_the_robot_is_named(
    tmp_path: Path, walk: Recording, flag: str | None, scale: float, code: str | None
) -> None:
    torques = {f"tau_{joint}": scale * walk.columns[f"tau_{joint}"] for joint in JOINTS}
    log = detected(tmp_path, walk, flag, **torques)
    codes = [notice.code for notice in log.notices if notice.code.startswith("torque_s")]
    assert codes == ([code] if code else [])


def test_hanging_robot_has_no_fault_of_its_torque(tmp_path: Path, hang: Recording) -> None:
    log = detected(tmp_path, hang, "auto")
    assert not [notice for notice in log.notices if notice.code.startswith("torque_s")]
