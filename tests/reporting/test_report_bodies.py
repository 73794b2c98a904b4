"""What report.json says of bodies: witnesses, splits, violations, copies, what was known; and that it comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import JOINTS, LEG, TRAIN, VALIDATE, config_with, fitted, idtool, numbers, strict_json, validated
from figures import assert_same_figures
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from synthetic import point_parameters

from idtool.dynamics.regrouping import RegroupedModel
from idtool.estimation.dataset.reduced_part import ReducedPart
from idtool.estimation.dataset.reduction import Factor
from idtool.robot.config import read_config
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import LENGTH_POWERS, from_mass_com_inertia, mass_com_inertia, symmetric_matrix
from idtool.robot.shapes import known_shapes

Array = NDArray[np.float64]

LEG_YAML = LEG.with_suffix(".yaml")
DATA = yaml.safe_load(LEG_YAML.read_text())
BODIES = ("abad_link", "thigh_link", "shank_link", "abad_rotor", "hip_rotor", "knee_rotor")
ADDED = {"copy_of", "shapes", "split", "witness", "violations", "deviation_ellipsoid"}

MASS = {"thigh_link": 0.634, "shank_link": {"value": 0.6, "standard_error": 0.05}}
SHAPES: dict[str, list[dict[str, Any]]] = {
    "shank_link": [{"kind": "capsule", "center": [0, 0, -0.1725], "radius": 0.045, "length": 0.5}],
    "thigh_link": [{"kind": "hull"}],
}
WEAK = {"kind": "euclidean", "weight": 1e-6}
KNOWN: dict[str, Any] = {
    "mirror": [{"body": "knee_rotor", "of": "hip_rotor", "plane": "xz"}],
    "known": {"mass": MASS, "total_mass": {"value": 4.5, "standard_error": 0.2}},
    "known_com": {"abad_link": [0.005, 0.04, 0.002]},
    "bounding_shapes": SHAPES,
    "regularization": {"kind": "entropic", "weight": 1e-5},
}


def report_of(folder: Path, **changes: Any) -> dict[str, Any]:
    """The report of a fit of the leg with another configuration, which writes to `out`."""
    config = config_with(folder / "given.yaml", LEG_YAML, **changes)
    fitted(folder / "out", LEG, TRAIN, "--validate", VALIDATE, "--config", config)
    return dict(strict_json((folder / "out" / "report.json").read_text()))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The leg as it comes."""
    return report_of(tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("known")


@pytest.fixture(scope="module")
def known(folder: Path) -> dict[str, Any]:
    """The leg with all that may be known of it."""
    return report_of(folder, **KNOWN)


def solids(body: dict[str, Any]) -> list[Any]:
    """A body's bounds, from the report."""
    ellipsoids = [Ellipsoid(*(tuple(e[key]) for key in ("center", "semi_axes", "rpy"))) for e in body["ellipsoids"]]
    return [*ellipsoids, *(known_shapes()[shape["kind"]].from_dict(shape) for shape in body["shapes"])]


def shows(body: dict[str, Any]) -> None:
    """The witness has the body's parameters and lies in its bounds."""
    masses, points = (np.array(body["witness"][key]) for key in ("masses", "points"))
    assert points.shape == (len(masses), 3)
    assert (masses > 0).all()
    pi = np.array(body["pi"])
    unit = pi[0] * 0.2**LENGTH_POWERS
    np.testing.assert_allclose(point_parameters(masses, points) / unit, pi / unit, rtol=0, atol=1e-9)
    inside = [solid.contains(points, tolerance=1e-6) for solid in solids(body)]
    assert np.any(inside, axis=0).all()


def test_every_body_has_all_keys(plain: dict[str, Any], known: dict[str, Any]) -> None:
    for report in (plain, known):
        assert tuple(report["bodies"]) == BODIES
        assert len({frozenset(body) for body in report["bodies"].values()}) == 1
        for body in report["bodies"].values():
            assert set(body) >= ADDED
            assert (body["realizable"], body["violations"]) == (True, [])
        assert all(np.isfinite(x) for x in numbers(report))


def test_four_points_of_mass_show_each_body(plain: dict[str, Any]) -> None:
    for body in plain["bodies"].values():
        assert len(body["witness"]["masses"]) <= 4
        assert (body["split"], body["shapes"], body["copy_of"]) == (None, [], None)
        shows(body)


def test_the_deviation_ellipsoid_is_that_of_the_parameters(plain: dict[str, Any]) -> None:
    """Sigma_C / m = R diag(semi-axes²) Rᵀ about the centre of mass."""
    for body in plain["bodies"].values():
        mass, com, inertia = mass_com_inertia(body["pi"])
        R = Rotation.from_euler("xyz", body["deviation_ellipsoid"]["rpy"]).as_matrix()
        squares = np.square(body["deviation_ellipsoid"]["semi_axes"])
        sigma = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        np.testing.assert_allclose(R @ np.diag(squares) @ R.T * mass, sigma, atol=1e-6 * np.abs(sigma).max())
        np.testing.assert_allclose(body["deviation_ellipsoid"]["center"], com, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(
            from_mass_com_inertia(body["mass"], body["com"], symmetric_matrix(body["inertia_com"])),
            body["pi"],
            atol=1e-12,
        )


def test_shapes_and_splits_are_told(known: dict[str, Any]) -> None:
    """The capsule is a cylinder and two balls, the thigh an ellipsoid and a hull."""
    shank, thigh = known["bodies"]["shank_link"], known["bodies"]["thigh_link"]
    assert [shape["kind"] for shape in shank["shapes"]] == ["capsule"]
    assert {key: shank["shapes"][0][key] for key in ("center", "radius", "length")} == {
        key: SHAPES["shank_link"][0][key] for key in ("center", "radius", "length")
    }
    assert [shape["kind"] for shape in thigh["shapes"]] == ["hull"]
    assert len(thigh["ellipsoids"]) == len(shank["ellipsoids"]) == 1
    for body, pieces in ((shank, 1 + 3), (thigh, 1 + 1)):
        assert body["constraints"] == "shape"
        assert len(body["split"]) == pieces
        parts = np.array([part["pi"] for part in body["split"]])
        np.testing.assert_allclose(parts.sum(axis=0), body["pi"], rtol=1e-9, atol=1e-12)
        assert [part["mass"] for part in body["split"]] == parts[:, 0].tolist()
    # Cylinders and hulls have conditions, and no points that show a body.
    assert shank["witness"] is thigh["witness"] is None


def test_a_copy_is_the_image_of_its_original(known: dict[str, Any]) -> None:
    copy, original = known["bodies"]["knee_rotor"], known["bodies"]["hip_rotor"]
    assert copy["copy_of"] == "hip_rotor"
    assert original["copy_of"] is None
    signs = np.array([1, 1, -1, 1, 1, -1, 1, 1, -1, 1])  # y turned round: h_y, I_xy and I_yz
    np.testing.assert_allclose(copy["pi"], original["pi"] * signs, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(
        copy["ellipsoids"][0]["center"], np.array(original["ellipsoids"][0]["center"]) * [1, -1, 1], atol=1e-12
    )
    shows(copy)
    shows(original)


def test_what_was_known_is_set_against_what_was_found(known: dict[str, Any], plain: dict[str, Any]) -> None:
    found = {fact["what"]: fact for fact in known["known"]}
    bodies = known["bodies"]
    thigh, shank, total = (found[f"known.{key}"] for key in ("mass: thigh_link", "mass: shank_link", "total_mass"))
    assert (thigh["value"], thigh["standard_error"]) == (0.634, None)
    assert (shank["value"], shank["standard_error"]) == (0.6, 0.05)
    assert thigh["identified"] == bodies["thigh_link"]["mass"] == pytest.approx(0.634, rel=1e-12)
    assert shank["identified"] == bodies["shank_link"]["mass"]
    assert total["identified"] == pytest.approx(sum(body["mass"] for body in bodies.values()), rel=1e-12)
    centres = [fact for what, fact in found.items() if what.startswith("known_com")]
    assert bodies["abad_link"]["com"] == pytest.approx(KNOWN["known_com"]["abad_link"], abs=1e-9)
    assert all(abs(fact["identified"] - fact["value"]) < 1e-9 for fact in centres)
    assert plain["known"] == []


def test_the_prior_that_was_used_is_told(known: dict[str, Any], plain: dict[str, Any]) -> None:
    told = {"kind": "entropic", "weight": 1e-5, "mass_precision": 1.0, "units": "relative", "automatic": None}
    assert known["regularization"] == told
    chosen = plain["regularization"]
    assert (chosen["kind"], chosen["mass_precision"], chosen["units"]) == ("entropic", 5.0, "relative")
    assert chosen["weight"] == chosen["automatic"]["chosen"]["weight"]
    assert abs(known["solver"]["duality_gap"]) < 1e-6


def test_every_fact_is_told_under_its_own_name(known: dict[str, Any]) -> None:
    labels = [fact["what"] for fact in known["known"]]
    assert len(labels) == 3 + 3
    assert {label for label in labels if not label.startswith("known_com")} == {
        *("known.mass: thigh_link", "known.mass: shank_link", "known.total_mass")
    }
    assert sum(label.startswith("known_com: abad_link") for label in labels) == 3


def test_without_constraints_the_violations_say_why(tmp_path: Path) -> None:
    """Few data and no prior to speak of: bodies come out that cannot be."""
    report = report_of(tmp_path, constraints="none", regularization=WEAK)
    wrong = {name: body for name, body in report["bodies"].items() if not body["realizable"]}
    assert len(wrong) >= 2
    for name, body in report["bodies"].items():
        assert body["constraints"] == "none"
        assert body["realizable"] is (name not in wrong)
        assert bool(body["violations"]) is (name in wrong)
        assert (body["witness"] is None) is (name in wrong)
        if name not in wrong:
            shows(body)
        moments = np.linalg.eigvalsh(symmetric_matrix(body["inertia_com"]))
        for said in body["violations"]:
            assert "\n" not in said
            if said.startswith("I1 + I2 < I3"):
                assert moments[0] + moments[1] < moments[2]
            elif said.startswith("mass is not positive"):
                assert body["mass"] <= 0
            elif said.startswith("principal moment"):
                assert moments[0] < 0
            else:
                assert said.startswith("some mass lies beyond its ")
                assert body["ellipsoid_margin"] < 0
    unreal = [warning for warning in report["warnings"] if warning.startswith("the parameters of")]
    assert len(unreal) == 1


def test_a_body_within_full_consistency_may_be_outside_its_ellipsoid(tmp_path: Path) -> None:
    """That is said, by the bounds that the configuration has, whatever set was asked for."""
    narrow = [{"center": [0, 0, -0.171], "semi_axes": [0.01, 0.01, 0.02]}]
    ellipsoids = {**DATA["bounding_ellipsoids"], "thigh_link": narrow}
    report = report_of(tmp_path, constraints="full", bounding_ellipsoids=ellipsoids, regularization=WEAK)
    thigh = report["bodies"]["thigh_link"]
    assert (thigh["constraints"], thigh["realizable"], thigh["witness"]) == ("full", False, None)
    (said,) = thigh["violations"]
    assert said.startswith("some mass lies beyond its ")
    assert thigh["min_eig_pseudo_inertia"] > 0
    assert thigh["ellipsoid_margin"] < 0


def test_what_was_written_is_the_identified_model(folder: Path, known: dict[str, Any], tmp_path: Path) -> None:
    """Mirror, known masses and shapes in model.yaml stand in no validation's way."""
    out = folder / "out"
    config = read_config(out / "model.yaml")
    given = read_config(folder / "given.yaml")
    for key in ("mirror", "known", "known_com", "bounding_shapes", "bounding_ellipsoids", "regularization"):
        assert getattr(config, key) == getattr(given, key)
    report = validated(tmp_path / "beside", out / "identified.urdf", VALIDATE)
    for name in (*JOINTS, "overall"):
        assert report["rms"]["model"][name] == pytest.approx(known["rms"]["validation"][name], rel=1e-9)
    other = validated(tmp_path / "given", out / "identified.urdf", VALIDATE, "--config", out / "model.yaml")
    assert other["rms"] == report["rms"]


def test_the_identified_model_can_be_fitted_again(folder: Path, known: dict[str, Any], tmp_path: Path) -> None:
    """With itself for a prior, which is then nearer."""
    out = folder / "out"
    again = fitted(tmp_path, out / "identified.urdf", TRAIN, "--validate", VALIDATE)
    assert again["rms"]["validation"]["overall"] == pytest.approx(known["rms"]["validation"]["overall"], rel=0.01)
    assert again["bodies"]["thigh_link"]["mass"] == pytest.approx(0.634, rel=1e-9)
    for name, body in again["bodies"].items():
        np.testing.assert_allclose(body["prior"], known["bodies"][name]["pi"], rtol=1e-9, atol=1e-12)
    assert idtool("ellipsoids", out / "identified.urdf", "--check", "--quiet").code == 0


def test_a_shape_of_the_identified_urdf_is_checked(folder: Path, known: dict[str, Any]) -> None:
    """The configuration beside it is model.yaml, with its hull and capsule; its links are within them."""
    done = idtool("ellipsoids", folder / "out" / "identified.urdf", "--check", "--json", "--quiet")
    assert done.code == 0
    for name, link in done.json["links"].items():
        assert link["mass"] == pytest.approx(known["bodies"][name]["mass"], rel=1e-11)  # as many digits are written


def test_a_fit_is_that_of_any_factor_of_the_data(
    monkeypatch: pytest.MonkeyPatch, known: dict[str, Any], tmp_path: Path
) -> None:
    """Columns of copies cancel, and the data say nothing of some masses: rounding must not decide on either."""
    rng = np.random.default_rng(0)
    restore_columns = ReducedPart.restore_columns

    def turned(factor: Factor) -> Factor:
        Q = np.linalg.qr(rng.normal(size=(len(factor.R), len(factor.R))))[0]
        return replace(factor, R=Q @ factor.R)

    def restore_and_turn(part: ReducedPart, regrouped: RegroupedModel) -> None:
        restore_columns(part, regrouped)
        part.blocks = {number: tuple(map(turned, block)) for number, block in part.blocks.items()}

    monkeypatch.setattr(ReducedPart, "restore_columns", restore_and_turn)
    report = report_of(tmp_path, **KNOWN)
    for key in ("rms", "noise", "friction", "friction_intervals"):
        assert_same_figures(report[key], known[key], key, rel=1e-6)
    for name, body in report["bodies"].items():
        for key in ("mass", "interval", "identifiable", "standard_error"):
            assert_same_figures(body[key], known["bodies"][name][key], f"{name}.{key}", rel=1e-6)
