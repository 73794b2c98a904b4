"""What a fit says where its data or its configuration cannot be right, and that it says nothing where they are."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, TRAIN
from leg_truth import TRUTH
from robots import chain, link

import idtool
from idtool.estimation.identification import bounds_notices, choose_sets
from idtool.robot.model import RobotModel

RIGHT = idtool.Log(TRAIN)
HEAVY, WORSE, UNIT = "the total mass of the bodies is", "worse than the URDF does", "times the measured torque"


def said(config: Callable[[dict[str, Any]], None] = lambda data: None, quick: bool = True, **signals: Any) -> str:
    """The warnings of a fit of the leg with another configuration or other signals, a line each."""
    data = idtool.Model(LEG).config
    config(data)
    given = {"q": RIGHT.q, "v": RIGHT.v, "tau": RIGHT.tau, **signals}
    log = idtool.Log.from_arrays("log", RIGHT.t, RIGHT.joints, **given)
    return "\n".join(idtool.fit(idtool.Model(LEG, data), log, simulation=False, quick=quick).warnings)


def test_of_data_as_they_should_be_nothing_is_said() -> None:
    """But that a scale would tell what the torque does not."""
    (only,) = said(quick=False).splitlines()
    assert only.startswith("the logs do not determine the mass of abad_link")
    assert only.endswith("weigh the moving parts and set known.total_mass")


def test_a_robot_that_was_weighed_is_not_to_be_weighed() -> None:
    true_mass = sum(body.mass for body in TRUTH.bodies.values())
    assert said(lambda data: data.update(known={"total_mass": true_mass}), quick=False) == ""


@pytest.mark.parametrize(
    ("signals", "naming"),
    [
        ({"tau": RIGHT.tau * [1, -1, 1]}, "hip: tau has the opposite sign"),
        ({"tau": RIGHT.tau[:, [0, 2, 1]]}, "its torque is recorded under"),
        ({"tau": 1000 * RIGHT.tau}, "mN·m"),
        ({"q": np.degrees(RIGHT.q), "v": np.degrees(RIGHT.v)}, "abad: q is in degrees"),
    ],
    ids=["sign", "order", "unit", "degrees"],
)
def test_data_that_cannot_be_right_are_named_with_the_remedy(signals: dict[str, Any], naming: str) -> None:
    found = said(quick=False, **signals)
    assert naming in found
    assert "`log.scale`" in found or "correct the order of tau" in found


@pytest.mark.slow
def test_a_known_mass_in_grams_is_refused_by_its_name() -> None:
    """A leg of 368 kg would have to be a point at its joint."""
    with pytest.raises(idtool.IdtoolError, match=r"known\.mass: shank_link") as refused:
        said(lambda data: data.update(known={"mass": {"shank_link": 368}}))
    assert "check" in str(refused.value)
    assert "unit" in str(refused.value)


def test_a_rotor_in_another_unit_shows_in_the_priors_error() -> None:
    def grams(data: dict[str, Any]) -> None:
        inertial = data["rotors"]["hip_rotor"]["inertial"]
        inertial["inertia"] = [1e6 * x for x in inertial["inertia"]]

    assert UNIT in said(grams)


def test_links_that_stand_in_for_rotors_are_too_heavy() -> None:
    def bare(data: dict[str, Any]) -> None:
        del data["rotors"], data["bounding_ellipsoids"]

    found = said(bare)
    assert HEAVY in found
    assert WORSE not in found


def test_a_torque_of_zeros_beside_a_command_is_the_controllers() -> None:
    """Drivers without a torque sensor publish zeros."""
    gains = {"kp": dict.fromkeys(RIGHT.joints, 40.0), "kd": dict.fromkeys(RIGHT.joints, 1.0)}
    model = idtool.Model(LEG, {**idtool.Model(LEG).config, "controller": gains})
    motion: dict[str, Any] = {"q": RIGHT.q, "v": RIGHT.v, "qcmd": RIGHT.q + RIGHT.tau / 40 + RIGHT.v / 40}
    fits = [
        idtool.fit(model, idtool.Log.from_arrays("log", RIGHT.t, RIGHT.joints, **motion, **tau), quick=True)
        for tau in ({}, {"tau": 0 * RIGHT.tau})
    ]
    assert fits[0].rms.train == fits[1].rms.train
    assert fits[0].rms.train["overall"] < 0.2
    assert any("never changes" in warning for warning in fits[1].warnings)


@pytest.mark.parametrize("has_geometry", [True, False])
def test_ellipsoids_are_recommended_where_there_is_geometry(tmp_path: Path, has_geometry: bool) -> None:
    text = LEG.read_text()
    urdf = tmp_path / "leg.urdf"
    urdf.write_text(text if has_geometry else re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL))
    result = idtool.fit(idtool.Model(urdf, {}), TRAIN, quick=True)
    (notice,) = [notice for notice in result.notices if notice.code == "bodies_without_bounds"]
    assert ("idtool ellipsoids" in notice.advice) == has_geometry


def test_of_many_bodies_without_bounds_some_are_named(build: Callable[..., RobotModel]) -> None:
    model = build(chain(*map(link, range(1, 9))), [f"j{i}" for i in range(1, 9)])
    (notice,) = bounds_notices(model, choose_sets(model.bodies, None), None)
    assert notice.message.endswith("is required of them: l1, l2, l3, l4, l5, l6 and 2 more")
