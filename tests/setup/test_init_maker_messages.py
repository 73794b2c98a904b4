"""A first configuration from messages of a maker's robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from ground.quadruped import true_quadruped
from ground.robot import urdf_text
from maker_messages import GO_JOINTS, low_state_topic, write_topics

from idtool.robot.urdf.reading import read_robot
from idtool.setup import make_initial_config


def test_preset_and_the_faster_of_two_topics_are_proposed(tmp_path: Path) -> None:
    """Unitree's robots publish the same messages twice, once at a low rate."""
    t = np.arange(0, 2, 2e-3)
    columns = {"t": t}
    for j, joint in enumerate(GO_JOINTS):
        columns[f"q_{joint}"] = np.sin((j + 2) * t)
        columns[f"v_{joint}"] = (j + 2) * np.cos((j + 2) * t)
        columns[f"tau_{joint}"] = np.cos(3 * t)
    fast = low_state_topic(columns, GO_JOINTS)
    slow = replace(fast, name="/lf/lowstate", every=20)
    path = tmp_path / "run.mcap"
    write_topics(path, [slow, fast], np.rint(t * 1e9).astype(int).tolist())
    urdf = tmp_path / "go.urdf"
    urdf.write_text(urdf_text(true_quadruped(0)))
    given = {"friction": {"viscous": True}, "effects": []}
    config = make_initial_config(read_robot(urdf), [path], given, None, lambda stage, share: None)
    assert config.data["log"] == {"topic": "/lowstate", "preset": "unitree_go"}
    assert set(config.data["joints"]) == set(GO_JOINTS)
