"""What is written: no more digits than are known, and as many as keep the model what it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import LEG, TRAIN, config_with, fitted
from hypothesis import given
from hypothesis import strategies as st

from idtool.dynamics.effects.rigid_body import typical_length
from idtool.robot.config import read_config
from idtool.robot.inertia import (
    LENGTH_POWERS,
    WRITTEN_DIGITS,
    from_mass_com_inertia,
    mass_com_inertia,
    pseudo_inertia,
    round_to_digits,
    rounded_inertial,
)
from idtool.robot.model import build_model
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import read_robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fit's files."""
    return tmp_path_factory.mktemp("fit")


@pytest.fixture(scope="module")
def report(folder: Path) -> dict[str, Any]:
    """With hardly a prior: bodies end on the boundary of their sets."""
    regularization = {"kind": "euclidean", "weight": 1e-6}
    config = config_with(folder / "leg.yaml", LEG.with_suffix(".yaml"), regularization=regularization)
    return fitted(folder, LEG, TRAIN, "--config", config, "--quick")


def significant(number: str) -> int:
    """How many digits a number is written with."""
    return len(re.sub(r"e.*", "", number).lstrip("-0.").replace(".", "").rstrip("0"))


def test_a_urdf_holds_no_digits_that_are_not_known(report: dict[str, Any], folder: Path) -> None:
    text = (folder / "identified.urdf").read_text()
    inertials = "".join(re.findall(r"<inertial>.*?</inertial>", text, re.DOTALL))
    dynamics = "".join(re.findall(r"<dynamics[^>]*>", text))
    numbers = re.findall(r"-?\d+\.\d+(?:e-?\d+)?", inertials + dynamics)
    assert len(numbers) > 30
    assert max(map(significant, numbers)) <= WRITTEN_DIGITS
    assert '-0.0"' not in inertials


def test_a_model_file_holds_no_digits_that_are_not_known(report: dict[str, Any], folder: Path) -> None:
    model = yaml.safe_load((folder / "model.yaml").read_text())
    values, errors = [], []
    for terms in model["friction"].values():
        for term in (term for term in terms.values() if term):
            values.append(term["value"])
            errors.append(term["standard_error"])
    for rotor in model["rotors"].values():
        values += [rotor["inertial"]["mass"], *rotor["inertial"]["com"], *rotor["inertial"]["inertia"]]
    assert max(significant(repr(value)) for value in values) <= WRITTEN_DIGITS
    assert max(significant(repr(error)) for error in errors) <= 4


def test_what_is_given_is_written_as_it_was(report: dict[str, Any], folder: Path) -> None:
    """A configuration's own numbers are not rounded, nor is what a URDF holds beside inertials and friction."""
    given = yaml.safe_load(LEG.with_suffix(".yaml").read_text())
    model = yaml.safe_load((folder / "model.yaml").read_text())
    for name, rotor in given["rotors"].items():
        assert model["rotors"][name]["origin"] == rotor["origin"]
    replaced = r"\s*<inertial>.*?</inertial>|<dynamics[^>]*>"
    kept = [re.sub(replaced, "", text, flags=re.DOTALL) for text in (LEG.read_text(), identified(folder))]
    assert kept[0] == kept[1]


def identified(folder: Path) -> str:
    return (folder / "identified.urdf").read_text()


def test_the_files_are_the_identified_model(report: dict[str, Any], folder: Path) -> None:
    """To 1e-9 of each body, and every body still in its set, on whose boundary some of them are."""
    config = read_config(folder / "model.yaml")
    model = build_model(read_robot(folder / "identified.urdf"), config, report["joints"])
    least = np.inf
    for body in model.bodies:
        pi = np.array(report["bodies"][body.name]["pi"])
        unit = pi[0] * typical_length(body) ** LENGTH_POWERS
        np.testing.assert_allclose(body.pi / unit, pi / unit, rtol=0, atol=1e-9)
        for piece in choose_set(body).pieces(body):
            least = min([least, *(i.margin(body.pi, float(pi[0]), typical_length(body)) for i in piece.inequalities)])
    assert 0 < least < 1e-7


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=6), st.integers(2, WRITTEN_DIGITS))
def test_rounding_is_to_a_share_of_the_largest(values: list[float], digits: int) -> None:
    largest = np.abs(values).max()
    off = np.abs(round_to_digits(values, digits) - values).max()
    assert off <= 0.5000001 * 10.0 ** (1 - digits) * largest
    np.testing.assert_array_equal(
        round_to_digits(round_to_digits(values, digits), digits), round_to_digits(values, digits)
    )


def test_rounding_leaves_what_has_no_size() -> None:
    np.testing.assert_array_equal(round_to_digits([0.0, 0.0]), [0, 0])
    np.testing.assert_array_equal(round_to_digits([np.inf, 1.2345678901234]), [np.inf, 1.2345678901234])


def test_a_centre_next_to_the_origin_is_the_origin() -> None:
    mass, com, inertia = rounded_inertial(from_mass_com_inertia(1.5, [1e-17, 0.0, -2e-16], 0.01 * np.eye(3)))
    assert (mass, *com) == (1.5, 0, 0, 0)
    assert np.linalg.eigvalsh(inertia).min() > 0
    needle = from_mass_com_inertia(0.1, [0.3, 0.0, 0.0], np.diag([2e-10, 0.01, 0.01 + 1e-10]))
    again = from_mass_com_inertia(*rounded_inertial(needle))
    assert np.linalg.eigvalsh(pseudo_inertia(needle))[0] > 0
    np.testing.assert_allclose(mass_com_inertia(again)[2], mass_com_inertia(needle)[2], rtol=0, atol=1e-13)
