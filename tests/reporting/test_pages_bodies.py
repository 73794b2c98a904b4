"""Bodies in 3D: what is drawn of report.json, and what stands beside it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pytest
from pages import BODY, SCRIPT, Page, body_of
from records import partial

import idtool
from idtool.reporting.pages.base import render
from idtool.reporting.pages.bodies import report_views
from idtool.reporting.results.fit import BodyReport
from idtool.robot.inertia import from_mass_com_inertia
from idtool.robot.shapes import known_shapes

SHAPES: dict[str, dict[str, Any]] = {
    "box": {"kind": "box", "center": [0, 0, 0], "size": [0.1, 0.2, 0.3], "rpy": [0, 0, 0]},
    "cylinder": {"kind": "cylinder", "center": [0, 0, 0], "radius": 0.1, "length": 0.2, "rpy": [0, 0, 0]},
    "capsule": {"kind": "capsule", "center": [0, 0, 0], "radius": 0.1, "length": 0.2, "rpy": [0, 0, 0]},
    "hull": {"kind": "hull", "vertices": [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]},
}


def page_of(bodies: dict[str, dict[str, Any]]) -> Page:
    """A page of this section alone."""
    scripts = ["solids.js", "bodies.js"]
    records = {name: partial(BodyReport, body) for name, body in bodies.items()}
    return Page(render("t", [("Bodies", "bodies_3d.html")], scripts, report_views(records), report={"bodies": records}))


def view_of(**extra: Any) -> dict[str, Any]:
    """What is drawn of one body."""
    (view,) = report_views({"b": partial(BodyReport, body_of(**extra))})["bodies"]
    return dict(view)


def test_a_body_is_drawn_as_the_report_has_it() -> None:
    body = body_of(shapes=list(SHAPES.values()))
    view = view_of(shapes=list(SHAPES.values()))
    assert view["bounds"] == [{"kind": "ellipsoid", **body["ellipsoids"][0]}, *SHAPES.values()]
    assert view["found"] == body["deviation_ellipsoid"]
    assert view["masses"]["masses"] == body["witness"]["masses"]
    np.testing.assert_allclose(view["masses"]["points"], body["witness"]["points"], atol=1e-6)


def test_the_priors_spread_has_its_own_second_moments() -> None:
    inertia = np.diag([5e-3, 4e-3, 3e-3])
    spread = view_of(prior=from_mass_com_inertia(0.5, [0.1, 0, -0.2], inertia).tolist())["prior"]
    # Second moments (Iyy + Izz − Ixx) / 2 and cyclic, per mass.
    wanted = np.sqrt(np.array([1e-3, 2e-3, 3e-3]) / 0.5)
    np.testing.assert_allclose(sorted(spread["semi_axes"]), wanted, atol=1e-6)
    assert spread["center"] == [0.1, 0.0, -0.2]


@pytest.mark.parametrize(
    "prior", [np.zeros(10), from_mass_com_inertia(0.5, [0, 0, 0], np.diag([1e-3, 1e-3, 3e-3]))], ids=["empty", "plate"]
)
def test_a_prior_that_no_body_can_have_is_not_drawn(prior: np.ndarray) -> None:
    assert view_of(prior=prior.tolist())["prior"] is None


def test_an_infeasible_body_is_explained() -> None:
    broken = body_of(realizable=False, violations=[f"I1 + I2 < I3 {SCRIPT}"], witness=None, deviation_ellipsoid=None)
    page = page_of({"fine": body_of(), BODY: broken})
    assert f"These parameters are not physically realizable: I1 + I2 < I3 {SCRIPT}" in page.plain
    assert f"{BODY} 0.600 kg, not realizable" in page.plain
    shown = [attrs for tag, attrs in page.tags if tag == "details"]
    assert ["open" in attrs for attrs in shown] == [False, True]
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert page.data["bodies"][1] == {
        "name": BODY, "bounds": view_of()["bounds"], "found": None, "prior": view_of()["prior"], "masses": None
    }  # fmt: skip


def test_the_first_body_is_shown_where_all_can_exist() -> None:
    page = page_of({"a": body_of(), "b": body_of()})
    assert ["open" in attrs for tag, attrs in page.tags if tag == "details"] == [True, False]
    labels = [attrs["aria-label"] or "" for _, attrs in page.tags if "data-body" in attrs]
    assert [label.partition(" in its frame")[0] for label in labels] == ["Body a", "Body b"]
    assert len({attrs["name"] for tag, attrs in page.tags if tag == "details"}) == 1


def test_point_masses_stand_beside_the_figure() -> None:
    body = body_of()
    rows = [row for row in page_of({"b": body}).rows if len(row) == 4]
    assert rows[0] == ["point mass [kg]", "x [m]", "y [m]", "z [m]"]
    assert len(rows) == 5
    assert rows[4] == ["0.300", *(f"{x:.4f}" for x in body["witness"]["points"][3])]


def test_many_point_masses_are_cut_short() -> None:
    masses = np.linspace(0.1, 1, 1000)
    body = body_of(witness={"masses": masses.tolist(), "points": np.zeros((1000, 3)).tolist()})
    page = page_of({"b": body})
    assert "988 more are listed in report.json." in page.text
    (view,) = page.data["bodies"]
    np.testing.assert_allclose(view["masses"]["masses"], masses[-300:], rtol=1e-4)


def test_the_split_of_a_union_stands_beside_the_figure() -> None:
    second = {"center": [0, 0, 0.3], "semi_axes": [0.1, 0.1, 0.1], "rpy": [0, 0, 0]}
    parts = [{"mass": 0.2, "pi": [0.2, 0, 0, -0.02] + [0.0] * 6}, {"mass": 0.0, "pi": [0.0] * 10}]
    parts += [{"mass": 0.4, "pi": [0.4, 0.04, 0, 0] + [0.0] * 6}]
    body = body_of(ellipsoids=[*body_of()["ellipsoids"], second], shapes=[SHAPES["box"]], split=parts, copy_of=SCRIPT)
    page = page_of({"b": body})
    assert [row for row in page.rows if len(row) == 3][1:] == [
        ["1: ellipsoid", "0.200", "0.0000, 0.0000, -0.1000"],
        ["2: ellipsoid", "0.00", "–"],
        ["3: box", "0.400", "0.1000, 0.0000, 0.0000"],
    ]
    assert f"A copy of {SCRIPT}." in page.text


def test_robots_of_many_bodies_stay_small() -> None:
    hull = {"kind": "hull", "vertices": np.random.default_rng(1).normal(size=(100, 3)).tolist()}
    bodies = {f"body {i}": body_of(shapes=[hull]) for i in range(400)}
    views = report_views({name: partial(BodyReport, body) for name, body in bodies.items()})
    assert len(json.dumps(views)) < 8e5
    assert 100 < len(views["bodies"]) < 400
    assert views["hidden"] == 400 - len(views["bodies"])


def test_every_shape_is_drawn_from_fields_that_it_has() -> None:
    script = (Path(idtool.__file__).parent / "reporting" / "templates" / "solids.js").read_text()
    drawn = dict(re.findall(r"^    (\w+): \(\{ ([\w, ]+) \}\) =>", script, flags=re.MULTILINE))
    assert set(drawn) | {"hull"} == {*known_shapes(), "ellipsoid"}
    assert 'shape.kind === "hull"' in script
    for kind, data in SHAPES.items():
        given = known_shapes()[kind].from_dict(data).to_dict()
        assert set(given) == set(data)
        assert set(drawn.get(kind, "vertices").split(", ")) <= set(given)


def test_scripts_hold_nothing_that_templates_would_fill_in() -> None:
    environment = jinja2.Environment(loader=jinja2.PackageLoader("idtool.reporting"), autoescape=True)
    for name in environment.list_templates(extensions=["js"]):
        source = (Path(idtool.__file__).parent / "reporting" / "templates" / name).read_text()
        assert environment.get_template(name).render().strip() == source.strip()
