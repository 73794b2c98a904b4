"""Fits to messages of makers' robots: the results are those of the same numbers in other logs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import JOINTS, LEG
from ground.logs import config_text
from ground.robot import prior_robot, urdf_text
from maker_messages import GO_JOINTS, GO_LEGS, low_state_topic, write_topics
from paths import SAMPLES
from quadruped_recordings import TRUTH, record_quadruped

import idtool
from idtool.common.exceptions import LogError
from idtool.common.safe_yaml import parse_yaml

Array = np.ndarray
FLAGS = {f"contact.{leg}_foot": f"foot_force[{i}] > 20" for i, leg in enumerate(GO_LEGS)}


def write_low_states(path: Path, columns: Mapping[str, Array], joints: tuple[str, ...]) -> Path:
    """Write columns of a table as `unitree_go/LowState` with their times as log times."""
    times = np.rint(columns["t"] * 1e9).astype(int).tolist()
    return write_topics(path, [low_state_topic(columns, joints)], times)


def in_order(columns: Mapping[str, Array], joints: tuple[str, ...]) -> dict[str, Array]:
    """Columns as float32, those of the joints first and in their order, in which solvers add them up."""
    of_joints = [f"{signal}_{joint}" for joint in joints for signal in ("q", "v", "tau")]
    names = dict.fromkeys(["t", *of_joints, *columns])
    return {name: columns[name] if name == "t" else columns[name].astype(np.float32).astype(float) for name in names}


def write_table(path: Path, columns: Mapping[str, Array]) -> Path:
    """Write columns with all their digits."""
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=",".join(columns), comments="")
    return path


def check_same(result: Any, expected: Any) -> None:
    """Times are rounded in another way, which the solver's tolerance amplifies."""
    for name, body in expected.bodies.items():
        assert result.bodies[name].mass == pytest.approx(body.mass, rel=1e-7)
        np.testing.assert_allclose(result.bodies[name].com, body.com, rtol=0, atol=1e-9)
        np.testing.assert_allclose(result.bodies[name].inertia, body.inertia, rtol=0, atol=1e-9)


def test_leg_with_listed_joints(tmp_path: Path) -> None:
    """The model has other names than the maker's, so that the joints must be listed."""
    log = idtool.Log(SAMPLES / "leg_train.mcap")
    rows = slice(0, 4000)
    columns = {"t": log.t[rows] - log.t[0]}
    for signal in ("q", "v", "tau"):
        for j, joint in enumerate(log.joints):
            columns[f"{signal}_{joint}"] = getattr(log, signal)[rows, j]
    columns = in_order(columns, log.joints)
    table = write_table(tmp_path / "leg.csv", columns)
    path = write_low_states(tmp_path / "leg.mcap", columns, log.joints)

    config = parse_yaml(LEG.with_suffix(".yaml"), LEG.with_suffix(".yaml").read_bytes())
    expected = idtool.fit(idtool.Model(LEG, config=config), table, quick=True)
    with_list = {**config, "log": {"field_joints": list(log.joints)}}
    result = idtool.fit(idtool.Model(LEG, config=with_list), path, quick=True)
    assert result.joints == expected.joints == JOINTS
    check_same(result, expected)

    with pytest.raises(LogError, match=r"set log.preset, or list them in log.field_joints in the order of the message"):
        idtool.fit(idtool.Model(LEG, config=config), path)


@pytest.mark.slow
def test_quadruped_with_its_imu_and_feet(tmp_path: Path) -> None:
    """A robot with the maker's names needs neither a preset nor a list; thresholds of its feet make flags."""
    columns = in_order(record_quadruped("stand", 2.0).columns, GO_JOINTS)
    table = write_table(tmp_path / "stand.csv", columns)
    path = write_low_states(tmp_path / "stand.mcap", columns, GO_JOINTS)
    urdf = tmp_path / "go.urdf"
    urdf.write_text(urdf_text(prior_robot(TRUTH, 0)))
    config = dict(parse_yaml(Path("quadruped.yaml"), config_text(TRUTH).encode()))
    expected = idtool.fit(idtool.Model(urdf, config=config), table, quick=True)

    fields = {**FLAGS, "contact.rope": "bit_flag"}
    model = idtool.Model(urdf, config={**config, "log": {"preset": "unitree_go", "fields": fields}})
    log, same = model.read_log(path).record, idtool.Log(table).record
    assert log.joints == same.joints == GO_JOINTS
    for signal, values in same.signals.items():
        np.testing.assert_array_equal(log.signals[signal], values)
    for name in set(columns) & set(same.channels) - {f"force_{leg}_foot_{axis}" for leg in GO_LEGS for axis in "xyz"}:
        np.testing.assert_array_equal(log.channels[name].x, same.channels[name].x)
        np.testing.assert_allclose(log.channels[name].t, same.channels[name].t, rtol=0, atol=1e-12)
    result = idtool.fit(model, path, quick=True)
    check_same(result, expected)
    assert result.whole_robot is not None
    assert expected.whole_robot is not None
    assert result.whole_robot.mass == pytest.approx(expected.whole_robot.mass, rel=1e-7)

    feet = config["contacts"][: len(GO_LEGS)]
    always_closed = [{key: value for key, value in foot.items() if key != "flag"} for foot in feet]
    recognized = idtool.fit(idtool.Model(urdf, config={**config, "contacts": always_closed}), path, quick=True)
    assert "preset_assumed" in [notice.code for notice in recognized.notices]
    assert recognized.whole_robot is not None
    assert recognized.whole_robot.mass == pytest.approx(TRUTH.mass, rel=0.2)
