"""What each number rests on, base parameters, the logs side by side, and bias: shown as report.json has them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from pages import BODY, SCRIPT, SLIDE, Page, basis_of, trust_of
from records import partial

from idtool.common.number_text import range_text
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import render
from idtool.reporting.pages.uncertainty import (
    BASE_PARAMETERS,
    BIAS,
    REPEATABILITY,
    SOURCES,
    uncertainty_view,
    with_uncertainty,
)
from idtool.reporting.results.fit import FitReport
from idtool.reporting.sections.fit import FrictionSection

JOINTS = FrictionSection()
SECTIONS = (("Found", "trust_findings.html"), JOINTS, SOURCES, BASE_PARAMETERS, REPEATABILITY, BIAS)


@pytest.fixture
def report() -> dict[str, Any]:
    """What report.json holds of trust, to be changed at will."""
    return trust_of(["thigh", "shank"], ["hip", "knee"])


def logs_of(values: Sequence[Sequence[float | None]], errors: Sequence[Sequence[float | None]]) -> dict[str, Any]:
    """The entry ``repeatability`` of report.json: a row of values and standard errors a parameter, a column a log."""
    logs = len(values[0])
    return {
        "logs": [f"log {k}" for k in range(logs)],
        "agree": True,
        "odd_one_out": None,
        "cross_rms": (1.0 + np.arange(logs * logs).reshape(logs, logs) / 100).tolist(),
        "parameters": [
            {"name": f"p{i}", "unit": "kg·m", "value": list(value), "standard_error": list(error), "ratio": 1.0}
            | {"agrees": True}
            for i, (value, error) in enumerate(zip(values, errors, strict=True))
        ],
    }


def page_of(report: dict[str, Any]) -> Page:
    """A page of these sections alone."""
    record = partial(FitReport, report)
    return Page(
        render(
            "t",
            with_uncertainty(SECTIONS, record),
            ["trust.js"],
            {},
            report=record,
            groups=rows_by_unit(report["units"]),
            where="On the held-out data",
            **uncertainty_view(record),
        )
    )


def bars(page: Page) -> list[tuple[str | None, str | None]]:
    """Class and style of each bar, of all bodies."""
    found, body = [], None
    for tag, attrs in page.tags:
        body = attrs.get("class") if tag == "tbody" else body
        if tag == "td" and body == "grounds":
            found.append((attrs.get("class"), attrs.get("style")))
    return found


def dots(page: Page) -> list[str]:
    """Where the bars of the logs are, in order."""
    return [attrs.get("style") or "none" for tag, attrs in page.tags if tag == "i"]


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [(0.11383, 0.12016, "0.1138 to 0.1202"), (-0.02, 10.4, "0 to 10"), (-0.34, 0.34, "±0.34"),
     (0.081, None, "0.081 or more"), (None, -2.5, "-2.5 or less"), (None, None, "any"),
     (-8.3e-6, 1.7e-5, "-8.3e-06 to 1.7e-05"), (2.0, 2.0, "2.0 to 2.0"),
     (-1e-12, 0.5, "0.00 to 0.50"), (1e7, 3e7, "1.0e+07 to 3.0e+07")],
)  # fmt: skip
def test_intervals_have_the_digits_of_their_width(low: float | None, high: float | None, text: str) -> None:
    assert range_text(low, high) == text


def test_a_bar_shows_the_shares(report: dict[str, Any]) -> None:
    page = page_of(report)
    of_one = [("d", "--d:90;--c:4"), *[(None, "--d:60;--c:10")] * 3, *[(None, None)] * 6]
    assert bars(page) == 2 * of_one
    assert "of its 24 parameters" in page.plain
    assert "20 inertial parameters, 2 are mainly determined by the data, 6 by the data in combination" in page.plain
    assert "0 by the constraints, and 12 by the prior" in page.plain


def test_words_values_and_ranges_stand_below(report: dict[str, Any]) -> None:
    rests = report["bodies"]["shank"]["rests_on"]
    rests[0]["range"] = [1e-9, None]
    rests[5] = basis_of(text="shank I_xy: prior only; moves with thigh mass", range=[-0.25, 0.5])
    report["bodies"]["shank"]["interval"][9] = [-0.1, 0.2]
    report["bodies"]["thigh"]["rests_on"][0] = basis_of(text="thigh mass: prior only")
    report["bodies"]["thigh"]["interval"][0] = None
    rows = page_of(report).rows
    assert rows[rows.index(["thigh"]) + 1] == ["mass", "0.600", "–", "0.0 to 1.0", "prior only"]
    assert rows[rows.index(["shank"]) :][1:8] == [
        ["mass", "0.600", "0.55 to 0.65", "0.0 or more", "determined by the data"],
        ["m·c_x", "0.00", "–", "0.0 to 1.0", "by the data only in a combination: x + y"],
        ["m·c_y", "0.00", "–", "0.0 to 1.0", "by the data only in a combination: x + y"],
        ["m·c_z", "-0.0960", "–", "0.0 to 1.0", "by the data only in a combination: x + y"],
        ["I_xy", "0.00", "–", "-0.25 to 0.50", "prior only; moves with thigh mass"],
        ["I_zz", "0.000400", "-0.10 to 0.20", "0.0 to 1.0", "prior only"],
        [
            "Prior only, with 1 % range: I_xx 0.0194 (0.0 to 1.0); I_yy 0.0194 (0.0 to 1.0); I_xz 0.00 (0.0 to 1.0); "
            "I_yz 0.00 (0.0 to 1.0)"
        ],
    ]


def test_base_parameters_that_are_held_come_first(report: dict[str, Any]) -> None:
    base = report["base_parameters"]
    base["parameters"][1] |= {"standard_error": None, "interval": None, "pull": None}
    base["parameters"][2]["pull"], base["parameters"][3]["pull"] = 4.0, 7.25
    base |= {"held_away": 2, "determined": 3}
    page = page_of(report)
    start = page.rows.index(["base parameter", "unit", "value", "± se", "95 % interval", "pull", "estimate"])
    assert page.rows[start + 1 :][:4] == [
        ["knee coulomb", "N·m", "1.23", "0.10", "1.00 to 1.40", "7.2", "changed by prior or constraints"],
        ["knee viscous", "N·m", "1.23", "0.10", "1.00 to 1.40", "4.0", "changed by prior or constraints"],
        ["hip coulomb", "N·m", "1.23", "–", "–", "–", "not determined"],
        ["hip viscous", "N·m", "1.23", "0.10", "1.00 to 1.40", "0.0", "from the data"],
    ]
    assert "2 changed by prior or constraints, 1 not determined, 1 from the data" in page.plain
    assert "These logs determine 3 of the 4. For 2 of them, the prior or the constraints shift" in page.plain
    assert "32 blocks of 0.250 s" in page.plain
    assert "they are 1.07 times as large." in page.plain
    assert ["hip", "512", "0.0123", "0.0456", "12 %"] in page.rows


def test_errors_without_blocks_are_called_so(report: dict[str, Any]) -> None:
    report["uncertainty"] |= {"blocks": 0, "bootstrap_ratio": None}
    assert "too short to be divided into blocks of time" in page_of(report).plain
    report["uncertainty"] |= {"blocks": 20, "correlated_beyond_blocks": True}
    assert "the standard errors may be too small" in page_of(report).plain


def test_many_base_parameters_are_cut_short(report: dict[str, Any]) -> None:
    parameters = report["base_parameters"]["parameters"]
    report["base_parameters"]["parameters"] = [{**parameters[0], "name": f"p{i}"} for i in range(200)]
    report["base_parameters"]["parameters"][199]["pull"] = 9.0
    page = page_of(report)
    shown = [row[0] for row in page.rows if re.fullmatch(r"p\d+", row[0])]
    assert shown == ["p199", *(f"p{i}" for i in range(59))]
    assert "140 more are listed in report.json." in page.plain


def test_logs_are_drawn_around_their_weighted_mean(report: dict[str, Any]) -> None:
    # By hand: means 1 and (0 + 4 · 4) / 5 = 3.2; standard errors 1 and sqrt((4 + 1) / 2) = 1.5811.
    report["repeatability"] = logs_of([[0, 2, None], [0, 4, None]], [[1, 1, None], [2, 1, None]])
    page = page_of(report)
    far = max(abs(0 - 3.2) / 2.5**0.5 + 2 * 2 / 2.5**0.5, 3)
    widest = np.ceil(far)
    places = [(-1, 2), (1, 2), None, (-3.2 / 2.5**0.5, 4 / 2.5**0.5), (0.8 / 2.5**0.5, 2 / 2.5**0.5), None]
    wanted = [
        f"--x:{round(50 + 50 * p[0] / widest, 1)};--w:{round(50 * p[1] / widest, 1)}" if p else "none" for p in places
    ]
    assert dots(page) == wanted
    assert ["p1", "kg·m", "0.0", "2.0", "4.0", "1.0", "–", "–", "1.00", ""] in page.rows
    assert "Yes: no base parameter differs" in page.plain


def test_what_does_not_repeat_comes_first(report: dict[str, Any]) -> None:
    logs = logs_of([[0.0, 1.0]] * 4, [[1.0, 1.0]] * 3 + [[1.0, None]])
    logs["parameters"][0]["ratio"], logs["parameters"][2]["ratio"] = 3.0, 2.0
    logs["parameters"][2]["agrees"] = False
    logs |= {"agree": False, "odd_one_out": "log 1", "cross_rms": [[1.0, 1.9], [1.6, 1.2]]}
    page = page_of(report | {"repeatability": logs})
    assert [(row[0], *row[-2:]) for row in page.rows if re.match(r"p\d", row[0]) and len(row) > 2] == [
        ("p2", "2.00", "yes"), ("p0", "3.00", ""), ("p1", "1.00", "")
    ]  # fmt: skip
    assert "1 more is determined by fewer than two logs" in page.plain
    assert "The log that differs from the others is log 1" in page.plain
    assert page.rows[-2:] == [["log 0", "1.00", "1.90"], ["log 1", "1.60", "1.20"]]
    errors = [attrs.get("class") for tag, attrs in page.tags if tag == "td"][-4:]
    assert errors == [None, "bad", "bad", None]
    assert "note" in page.levels


def test_values_far_away_stay_on_the_axis(report: dict[str, Any]) -> None:
    report["repeatability"] = logs_of([[0.0, 1e6]], [[1.0, 1.0]])
    assert dots(page_of(report)) == ["--x:0;--w:10.0", "--x:100;--w:10.0"]
    report["repeatability"] = logs_of([[2.0, 2.0]], [[0.0, 0.0]])
    assert dots(page_of(report)) == ["--x:50.0;--w:0.0"] * 2


def test_of_many_logs_the_odd_one_is_shown(report: dict[str, Any]) -> None:
    logs = logs_of([[0.0] * 40] * 100, [[1.0] * 40] * 100) | {"odd_one_out": "log 33"}
    page = page_of(report | {"repeatability": logs})
    assert [row[0] for row in page.rows if row[0].startswith("log ")] == [*(f"log {k}" for k in range(7)), "log 33"]
    assert len(dots(page)) == 8 * 20
    assert "80 more, with less scatter" in page.plain
    assert "32 more logs are listed in report.json." in page.plain


def test_reflected_inertia_has_the_unit_of_its_joint(report: dict[str, Any]) -> None:
    seen = {"reflected_inertia": 0.0857, "standard_error": 0.0026, "interval": [0.0805, 0.0909]}
    unseen = {"reflected_inertia": 0.054, "standard_error": None, "interval": None}
    report["rotors"] = {"r1": {"hip": seen, "knee": unseen}, "r2": {"knee": seen}}
    report["units"]["knee"] = "N"
    page = page_of(report)
    assert ["hip", "r1", "0.0857", "0.0026", "0.081 to 0.091", "kg·m²"] in page.rows
    assert ["knee", "r1", "0.0540", "–", "–", "kg"] in page.rows
    assert "The data determine 2 of 3 reflected rotor inertias" in page.plain
    report["rotors"] = {}
    assert "eflected inertia" not in page_of(report).plain


def test_friction_that_is_not_determined_is_named(report: dict[str, Any]) -> None:
    assert "The data determine all 4 friction coefficients." in page_of(report).plain
    report["friction"]["knee"]["standard_error"]["coulomb"] = None
    assert "do not determine these friction coefficients: knee Coulomb." in page_of(report).plain


def test_both_estimates_stand_side_by_side(report: dict[str, Any]) -> None:
    common = {"unit": "N·m", "standard_error": 0.1}
    parameters = [
        {"name": "a", "ls": 1.0, "iv": 1.1, "differs": False, **common},
        {"name": "b", "ls": 2.0, "iv": 2.2, "differs": True, **common},
        {"name": "c", "ls": 1.0, "iv": 0.7, "differs": False, **common},
    ]
    bias = {"method": "iv", "instruments": "closed_loop", "iterations": 2, "parameters": parameters}
    page = page_of(report | {"bias": bias})
    assert [row for row in page.rows if row[0] in ("a", "b", "c")] == [
        ["b", "N·m", "2.00", "2.20", "0.20", "0.10", "yes"],
        ["c", "N·m", "1.00", "0.700", "-0.30", "0.10", "no"],
        ["a", "N·m", "1.00", "1.10", "0.10", "0.10", "no"],
    ]
    assert "1 of 3 base parameters differs significantly between the two" in page.plain
    for parameter in parameters:
        parameter["differs"] = False
    agreed = "No base parameter differs significantly between the two estimates; the largest difference is 3.0 standard"
    assert agreed in page_of(report | {"bias": bias}).plain
    assert "simulated under the logged command" in page.plain
    assert "The fit itself uses instrumental variables; the instruments were computed 2 times." in page.plain


def test_what_was_not_asked_has_no_section(report: dict[str, Any]) -> None:
    assert with_uncertainty(SECTIONS, partial(FitReport, report)) == [*SECTIONS[:2], SOURCES, BASE_PARAMETERS]
    report |= {"base_parameters": None, "bias": None}
    for body in report["bodies"].values():
        body["rests_on"] = None
    assert with_uncertainty(SECTIONS, partial(FitReport, report)) == [*SECTIONS[:2]]
    assert page_of(report).levels == []


def test_a_strangers_names_stay_text() -> None:
    report = trust_of([BODY, "a: mass"], [SCRIPT, SLIDE])
    report["bodies"][BODY]["rests_on"][1]["text"] = f"{BODY} m·c_x: mostly prior; moves with {SCRIPT} mass"
    report["repeatability"] = logs_of([[0.0, 1.0]], [[1.0, 1.0]]) | {"logs": [SCRIPT, BODY], "odd_one_out": SCRIPT}
    report["repeatability"]["parameters"][0] |= {"name": BODY, "unit": SCRIPT, "agrees": False}
    report["rotors"] = {BODY: {SCRIPT: {"reflected_inertia": 1.0, "standard_error": None, "interval": None}}}
    parameter = {"name": SCRIPT, "unit": BODY, "ls": 1.0, "iv": 1.0, "standard_error": 0.0, "differs": True}
    report["bias"] = {"method": "ls", "instruments": BODY, "iterations": 1, "parameters": [parameter]}
    page = page_of(report)
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert page.text.count(BODY) > 5
    assert f"mostly prior; moves with {SCRIPT} mass" in {row[-1] for row in page.rows}
    assert ["mass", "0.600", "0.55 to 0.65", "0.0 to 1.0", "determined by the data"] in page.rows
    assert not any(row[-1].startswith("a: mass mass") for row in page.rows)


def test_sections_of_large_robots_stay_small() -> None:
    joints = [f"left_shoulder_joint_{i}" for i in range(120)]
    report = trust_of([f"left_shoulder_link_{i}" for i in range(240)], joints)
    report["repeatability"] = logs_of([[0.123456789] * 30] * 600, [[0.0123456789] * 30] * 600)
    empty = len(render("t", (), ["trust.js"], {}).encode())
    page = page_of(report)
    assert "160 more bodies are listed in report.json." in page.plain
    assert len(page.html.encode()) - empty < 150_000
