"""adapt.html: the parameters over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from pages import BODY, SCRIPT, SLIDE, Page, body_of, complete, notice_of
from records import partial

from idtool.reporting.pages.adapt import adapt_page
from idtool.reporting.plots.sampling import round_significant, subsample_indices
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.adapt import settling_time

JOINTS = (SCRIPT, SLIDE)
BODIES = (BODY, "thigh", "shank")


def adapt_of(joints: Sequence[str], bodies: Sequence[str]) -> dict[str, Any]:
    """The content of adapt.json: masses settle exponentially, friction steps to its value after 2 s."""
    t = np.linspace(0, 20, 5001)
    inertial = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
    units = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)
    coefficients = [
        {"effect": "rigid_body", "owner": body, "name": name, "unit": unit}
        for body in bodies
        for name, unit in zip(inertial, units, strict=True)
    ] + [
        {"effect": f"{name}_friction", "owner": joint, "name": name, "unit": unit}
        for joint in joints
        for name, unit in (("viscous", "N·m·s/rad"), ("coulomb", "N·m"))
    ]
    theta = np.zeros((len(t), len(coefficients)))
    for i in range(len(bodies)):
        mass = 0.5 * (i + 1) * (1 - np.exp(-t / (i + 1)))
        theta[:, 10 * i] = mass
        theta[:, 10 * i + 3] = -0.1 * (i + 1) * mass
    theta[:, 10 * len(bodies) :] = 0.3 * (t > 2)[:, None]
    found = body_of()
    return {
        "idtool": "0.0",
        "versions": {"python": "3.14"},
        "inputs": [{"kind": "log", "path": SCRIPT, "sha256": None}],
        "schema": 1,
        "joints": list(joints),
        "units": dict.fromkeys(joints, "N·m"),
        "bodies": list(bodies),
        "coefficients": coefficients,
        "constraints": dict.fromkeys(bodies, "ellipsoid"),
        "forgetting": 2.0,
        "t": t.tolist(),
        "theta": theta.tolist(),
        "prediction_rms": {**{joint: 0.7 * (1 + 0.1 * i) for i, joint in enumerate(joints)}, "overall": 0.7},
        "final": {
            "bodies": {
                body: {
                    "mass": float(theta[-1, 10 * i]),
                    "com": [0.0, 0.0, -0.1 * (i + 1)],
                    "inertia_com": [4e-3, 0, 4e-3, 0, 0, 4e-4],
                    "pi": found["pi"],
                    "realizable": True,
                }
                for i, body in enumerate(bodies)
            },
            "friction": {joint: {"viscous": 0.3, "coulomb": 0.3, "offset": None} for joint in joints},
        },
        "band_hz": 40.0,
        "samples": 20000,
        "update_hz": 166.7,
        "seconds": 3.1,
        "warnings": [],
        "urdf": "/robots/leg.urdf",
        "logs": ["/logs/leg.mcap"],
    }


@pytest.fixture
def report() -> dict[str, Any]:
    """The content of adapt.json, to be changed at will."""
    return adapt_of(JOINTS, BODIES)


def page_of(report: dict[str, Any]) -> Page:
    return Page(adapt_page(partial(AdaptationReport, report), f"idtool adapt {SCRIPT}"))


def test_the_page_is_complete_in_itself_and_safe(report: dict[str, Any]) -> None:
    report["notices"] = [notice_of(SCRIPT), notice_of("a\udcff", SCRIPT)]
    page = page_of(report)
    complete(page)
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert "<" not in page.scripts[1]
    assert {SCRIPT, SLIDE, BODY} < {row[0] for row in page.rows}


@pytest.mark.slow
def test_a_long_log_of_a_large_robot_stays_small(rng: np.random.Generator) -> None:
    report = adapt_of([f"j{i}" for i in range(12)], [f"body {i}" for i in range(30)])
    report["theta"] = rng.normal(size=(len(report["t"]), len(report["coefficients"]))).tolist()
    page = page_of(report)
    complete(page)
    assert page.figures[0].x[-1] == 20.0


def test_curves_are_the_reports(report: dict[str, Any]) -> None:
    masses, centers, *joint = page_of(report).figures
    theta = np.array(report["theta"])
    at = np.searchsorted(report["t"], np.array(masses.x, dtype=float) - 1e-6)
    assert masses.names == list(BODIES)
    for i, body in enumerate(BODIES):
        np.testing.assert_allclose(np.array(masses.y(body), dtype=float), theta[at, 10 * i], rtol=1e-3)
    assert centers.titles == ["x [m]", "y [m]", "z [m]", "t [s]"]
    for i, trace in enumerate(trace for trace in centers.data if trace.get("yaxis") == "y3"):
        assert trace["name"] == BODIES[i]
        drawn = np.array(trace["y"], dtype=float)
        assert np.isnan(drawn[0])  # where there is no mass yet
        np.testing.assert_allclose(drawn[1:], -0.1 * (i + 1), rtol=1e-3)
    assert [figure.titles[0] for figure in joint] == ["viscous [N·m·s/rad]", "coulomb [N·m]"]
    assert all(figure.names == list(JOINTS) for figure in joint)
    steps = joint[1].y(SCRIPT)
    assert (steps[0], steps[-1]) == (0.0, 0.3)


def test_late_stamps_keep_their_digits(report: dict[str, Any]) -> None:
    report["t"] = [1.6e9 + 0.3 + t for t in report["t"]]
    masses = page_of(report).figures[0]
    assert masses.titles[-1] == "t − 1600000000 [s]"
    assert masses.x[-1] == pytest.approx(20.3, abs=1e-5)


def test_when_a_mass_has_settled_is_said(report: dict[str, Any]) -> None:
    t = np.array(report["t"])
    rows = page_of(report).table("mass [kg]")
    for i, body in enumerate(BODIES):
        last = 1 - np.exp(-20 / (i + 1))
        wanted = -(i + 1) * np.log(1 - 0.95 * last)  # 1 − exp(−t/T) = 0.95 of the last
        assert float(rows[body]["within 5 % of the final value after [s]"]) == pytest.approx(wanted, abs=0.02)
    assert "the mass of every body remains within 5 %" in page_of(report).plain
    for row, time in zip(report["theta"], t, strict=True):
        row[10] = time
    text = page_of(report).plain
    assert f"the mass of every body remains within 5 % of its last value. {BODY}" not in text
    assert settling_time(t, t) == pytest.approx(19.0, abs=0.01)


def test_how_often_the_parameters_were_updated_is_said(report: dict[str, Any]) -> None:
    text = page_of(report).plain
    assert "at the downsampled rate, not at every logged sample: 20000 times, at 166.7 Hz." in text


def test_a_mass_that_wanders_to_the_end_is_named(report: dict[str, Any]) -> None:
    for i, row in enumerate(report["theta"]):
        row[10] = 1.0 + 0.2 * (i % 2)
    page = page_of(report)
    assert "The mass of thigh has not converged." in page.plain
    assert page.levels == ["note", "good", "note"]


def test_settling() -> None:
    t = np.arange(5.0)
    assert settling_time(t, np.array([1.0, 2.0, 2.0, 2.0, 2.0])) == 1.0
    assert settling_time(t, np.full(5, 2.0)) == 0.0
    assert settling_time(t, np.array([2.0, 2.0, 2.0, 1.0, 2.0])) is None
    assert settling_time(t, np.array([np.nan, 2.0, 2.0, 2.0, 2.0])) == 1.0
    assert settling_time(t[:0], t[:0]) is None


def test_a_body_that_cannot_exist_is_named(report: dict[str, Any]) -> None:
    report["final"]["bodies"]["shank"]["realizable"] = False
    page = page_of(report)
    assert "1 of 3 bodies of the last estimate is not realizable: shank." in page.plain
    assert page.levels[1] == "bad"
    assert page.table("mass [kg]")["shank"]["realizable"] == "NO"


def test_tables_hold_the_reports_figures(report: dict[str, Any]) -> None:
    page = page_of(report)
    assert "RMS error of the torque predicted one sample ahead, N·m, below 40 Hz" in page.plain
    assert page.table("rms")[SLIDE]["rms"] == "0.770"
    assert page.table("rms")["overall"]["rms"] == "0.700"
    assert "Friction at the end, viscous N·m·s/rad, others N·m" in page.plain
    assert page.table("offset")[SCRIPT] == {"joint": SCRIPT, "viscous": "0.300", "Coulomb": "0.300", "offset": "–"}


def test_what_a_page_holds_of_many_values() -> None:
    assert subsample_indices(10, 4).tolist() == [0, 3, 6, 9]
    assert subsample_indices(3, 100).tolist() == [0, 1, 2]
    assert subsample_indices(0, 5).tolist() == []
    assert len(subsample_indices(1001, 10)) <= 10
    assert round_significant([1.23456, 1e-9 / 3, None, float("inf"), float("nan")]) == [
        1.235,
        3.333e-10,
        None,
        None,
        None,
    ]
