"""study.html: its findings follow from the figures, its charts and tables hold them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pages import BODY, SCRIPT, SLIDE, Page, complete, evaluation_of, study_of

from idtool.pages import study_page
from idtool.pages.study import Learning, _noise, learning

JOINTS = (SCRIPT, SLIDE, "knee")
BODIES = (BODY, "thigh", "shank", "r1", "r2", "r3")


@pytest.fixture
def report() -> dict[str, Any]:
    """The content of study.json, to be changed at will."""
    return study_of(JOINTS, BODIES)


def page_of(report: dict[str, Any], angle: bool = True, command: str = "idtool study x") -> Page:
    t = np.linspace(0, 10, 400)
    measured = np.stack([np.sin(t), np.cos(t), np.sin(2 * t)])
    curves = {"measured": measured, "identified": 0.9 * measured} | ({"q": 0.5 * measured} if angle else {})
    return Page(study_page(evaluation_of(curves), report, command))


def found(medians: dict[str, list[float | None]], counts: list[int]) -> Learning:
    curves = {name: dict.fromkeys(("median", "lower", "upper"), y) for name, y in medians.items()}
    return learning({"counts": counts, "draws": 30, "curves": curves})


def test_the_page_is_complete_in_itself(report: dict[str, Any]) -> None:
    page = page_of(report)
    complete(page)
    assert page.levels == ["good", "good", "note", "good"]


def test_names_stay_text(report: dict[str, Any]) -> None:
    report["warnings"] = [SCRIPT, "a\udcff"]
    report["estimators"]["manifold"]["note"] = report["sets"]["full"]["lmi"] = SCRIPT
    report["estimators"]["manifold"]["status"] = BODY
    page = page_of(report, command=f"idtool {SCRIPT}")
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert "<" not in page.scripts[1]
    assert page.text.count(SCRIPT) > 5
    assert {SCRIPT, SLIDE, BODY} < {row[0] for row in page.rows}


def test_a_report_on_many_samples_stays_small(report: dict[str, Any], rng: np.random.Generator) -> None:
    times = 200_000
    report["adaptation"]["t"] = list(range(times))
    report["adaptation"]["error"] = {name: rng.uniform(0.1, 1, size=times).tolist() for name in ("none", "full")}
    curves = {name: rng.normal(size=(12, 4000)) for name in ("measured", "identified", "q")}
    report["units"] = {f"j{j}": "N·m" for j in range(12)}
    rms = {**dict.fromkeys(report["units"], 1.0), "overall": 1.0}
    for entry in (*report["sets"].values(), *report["estimators"].values()):
        entry["rms"] = {"train": rms, "validation": rms}
    page = Page(study_page(evaluation_of(curves, logs=6), report, "idtool study x"))
    complete(page)
    online = page.data["charts"]["online"]
    assert len(online["x"]["values"]) <= 1000
    assert online["x"]["values"][-1] == times - 1
    (error,) = [line["y"] for line in online["panels"][0]["lines"] if line["name"] == "full"]
    assert error[-1] == pytest.approx(report["adaptation"]["error"]["full"][-1], rel=1e-3)


def test_the_tightest_is_best_with_few_samples(report: dict[str, Any]) -> None:
    said = learning(report["learning"])
    assert said.best == ("ellipsoid",)
    assert said.order == ("ellipsoid", "full", "semi", "none")
    assert said.together == 100
    assert said.counts == (1, 2, 5, 10, 20, 30, 50)
    assert said.wins == 7
    assert said.example == (1, 2.0, 10.0)
    ratios = [(1 + 1 / n) / (1 + 9 / n) for n in said.counts]
    assert said.gain == pytest.approx(1 - np.prod(ratios) ** (1 / 7))
    page = page_of(report)
    text = page.plain
    assert "fewer than 100 samples, ellipsoid predicts best in the mean over these counts: the median held-out" in text
    assert "below that with none, the worst; most so with 1 sample, 2.00 against 10.0 N·m." in text
    assert "It has the least error at 7 of these 7 counts. Best first: ellipsoid, full, semi, none." in text
    assert "From 100 samples on, all sets predict alike" in text


def test_a_set_that_is_best_only_in_the_mean_is_no_clear_winner(report: dict[str, Any]) -> None:
    curves = report["learning"]["curves"]
    curves["ellipsoid"]["median"][:4] = [10.5, 7.5, 3.0, 2.0]
    curves["ellipsoid"]["median"][4:7] = [0.1] * 3
    for curve in curves.values():
        curve["lower"] = curve["upper"] = curve["median"]
    said = learning(report["learning"])
    assert (said.best, said.wins, said.clear) == (("ellipsoid",), 3, True)
    assert page_of(report).levels[0] == "note"


def drawn(rng: np.random.Generator, draws: int, gain: float) -> dict[str, Any]:
    """Four sets' errors at four counts from log-normal draws, each set's smaller by a share than the one's before."""
    curves = {}
    for i, name in enumerate(("none", "semi", "full", "ellipsoid")):
        y = np.exp(rng.normal(-gain * i, 0.3, size=(draws, 8)))
        lower, median, upper = np.quantile(y, [0.25, 0.5, 0.75], axis=0).tolist()
        curves[name] = {"lower": lower, "median": median, "upper": upper}
    return {"counts": [1, 2, 5, 10, 20, 50, 100, 200], "draws": draws, "curves": curves}


@pytest.mark.parametrize(("draws", "gain", "least", "most"), [(30, 0, 0, 0.05), (5, 0.3, 0, 0), (30, 0.2, 1, 1)])
def test_how_often_a_set_is_called_clearly_better(
    rng: np.random.Generator, draws: int, gain: float, least: float, most: float
) -> None:
    found = [learning(drawn(rng, draws, gain)).clear for _ in range(300)]
    assert least <= np.mean(found) <= most


def test_a_gain_within_the_noise_of_the_draws_is_called_so(report: dict[str, Any], rng: np.random.Generator) -> None:
    report["learning"] |= drawn(rng, 5, 0.3)
    report["learning"]["violation"] = {"none": [0.0] * 8}
    page = page_of(report)
    assert "no set predicts clearly better than the others" in page.plain
    assert "5 random draws leave more than that uncertain" in page.plain
    assert page.levels[0] == "note"


def test_the_noise_of_a_mean_of_medians(rng: np.random.Generator) -> None:
    y = np.exp(rng.normal(scale=0.3, size=(400, 50, 5)))  # repetitions, draws, counts
    lower, upper = np.quantile(y, [0.25, 0.75], axis=1)
    spread = np.log(np.median(y, axis=1)).mean(axis=1).std()
    np.testing.assert_allclose(_noise(lower, upper, 50).mean(), spread, rtol=0.1)


def test_curves_that_stay_apart_are_said_to() -> None:
    said = found({"none": [9.0, 5.0, 3.0, 1.2], "full": [2.0, 1.5, 1.2, 1.1]}, [1, 10, 100, 1000])
    assert said.together is None
    assert said.best == ("full",)
    assert said.counts == (1, 10)


def test_curves_that_part_again_are_not_together() -> None:
    y = {"none": [9.0, 1.0, 3.0, 1.0, 1.04], "full": [1.0] * 5}
    assert found(y, [1, 2, 5, 10, 20]).together == 10


def test_curves_that_never_part_have_no_best(report: dict[str, Any]) -> None:
    said = found({"none": [1.0, 1.01], "full": [1.02, 1.0]}, [1, 10])
    assert said.best == ()
    assert said.together == 1
    report["learning"]["curves"]["none"] = report["learning"]["curves"]["semi"] = report["learning"]["curves"]["full"]
    report["learning"]["curves"]["ellipsoid"] = report["learning"]["curves"]["full"]
    assert page_of(report).levels == ["good", "note", "good"]


def test_sets_within_a_hundredth_share_the_first_place() -> None:
    said = found({"none": [9.0, 1.0], "shape": [2.0, 1.0], "ellipsoid": [2.01, 1.0]}, [1, 10])
    assert said.best == ("shape", "ellipsoid")


def test_a_set_without_an_error_is_last() -> None:
    said = found({"none": [None, 1.0, 1.0], "full": [3.0, 1.0, 1.0], "semi": [8.0, 1.0, 1.0]}, [1, 2, 3])
    assert said.order == ("full", "semi", "none")
    assert (said.worst, said.gain) == ("semi", pytest.approx(1 - 3 / 8))
    nothing = found({"none": [None, 1.0, 1.0], "full": [None, 2.0, 1.0]}, [1, 2, 3])
    assert (nothing.best, nothing.clear, nothing.together) == ((), False, 3)
    assert said.together == 2
    assert "–" in page_cell(None)


def page_cell(value: float | None) -> str:
    """What the table of medians shows of a value."""
    report = study_of(JOINTS, BODIES)
    report["learning"]["curves"]["none"]["median"][0] = value
    return page_of(report).table("semi", ["samples"])["1"]["none"]


def test_sets_whose_bodies_cannot_exist_are_named(report: dict[str, Any]) -> None:
    text = page_of(report).plain
    assert "no distribution of mass can have: none 2 of 6, semi 1 of 6." in text
    assert (
        "Fitted to 30 samples, the worst body is beyond what can exist by, in the median: none 0.027, semi 0.010"
        in text
    )
    for name in ("none", "semi"):
        report["sets"][name]["violations"] = 0
        report["learning"]["violation"][name] = [0.0] * 10
    page = page_of(report)
    assert page.levels == ["good"] * 4
    assert "every body of every set could exist" in page.plain


def test_the_first_to_converge_online_is_named(report: dict[str, Any]) -> None:
    text = page_of(report).plain
    assert "The parameter error fell below 10 % first with ellipsoid, after 1.15 s; with full after 4.61 s." in text
    assert "Not in the time that the data last: none." in text
    report["adaptation"]["time_to_10_percent"]["full"] = 1.151
    assert "first with full and ellipsoid, after 1.15 s." in page_of(report).plain
    report["adaptation"]["time_to_10_percent"] = dict.fromkeys(("none", "full", "ellipsoid"))
    assert "No set's parameter error fell below 10 %" in page_of(report).plain


def test_a_study_without_the_online_part(report: dict[str, Any]) -> None:
    report["adaptation"] = None
    page = page_of(report)
    assert "Not run." in page.text
    assert set(page.data["charts"]) == {"learning", "violation"}
    assert page.levels == ["good", "good", "note"]


def test_what_was_not_solved_breaks_a_line(report: dict[str, Any]) -> None:
    report["learning"]["violation"]["none"] = [None] * 10
    report["learning"]["curves"]["none"]["median"][0] = None
    page = page_of(report)
    assert page.data["charts"]["violation"]["panels"][0]["lines"][0]["y"] == [None] * 10
    assert page.data["charts"]["learning"]["panels"][0]["lines"][0]["y"][:2] == [None, 5.5]
    assert "in the median: semi 0.010" in page.plain


def test_charts_hold_the_reports_figures(report: dict[str, Any]) -> None:
    charts = page_of(report).data["charts"]
    learned = charts["learning"]
    assert learned["x"] == {"values": report["learning"]["counts"], "title": "samples to fit", "log": True}
    (errors,) = learned["panels"]
    assert errors["log"]
    assert "N·m" in errors["title"]
    for line in errors["lines"]:
        curve = report["learning"]["curves"][line["name"]]
        for drawn, wanted in (("y", "median"), ("lower", "lower"), ("upper", "upper")):
            np.testing.assert_allclose(line[drawn], curve[wanted], rtol=1e-3)
    (broken,) = charts["violation"]["panels"]
    for line in broken["lines"]:
        np.testing.assert_allclose(line["y"], report["learning"]["violation"][line["name"]], rtol=1e-3)
    (online,) = charts["online"]["panels"]
    assert online["level"] == 0.1
    for line in online["lines"]:
        wanted = np.interp(
            charts["online"]["x"]["values"], report["adaptation"]["t"], report["adaptation"]["error"][line["name"]]
        )
        np.testing.assert_allclose(line["y"], wanted, rtol=1e-3)


def test_a_set_has_one_colour_in_all_charts(report: dict[str, Any]) -> None:
    colors: dict[str, set[str]] = {}
    for chart in page_of(report).data["charts"].values():
        for line in chart["panels"][0]["lines"]:
            colors.setdefault(line["name"], set()).add(line["color"] + line["dash"])
    assert all(len(used) == 1 for used in colors.values())
    assert len(set.union(*colors.values())) == len(colors)


@pytest.mark.parametrize("angle", [True, False])
def test_the_angle_is_drawn_where_it_was_kept(report: dict[str, Any], angle: bool) -> None:
    page = page_of(report, angle)
    (log,) = page.data["logs"]
    assert [joint["name"] for joint in log["joints"]] == list(JOINTS)
    assert [name for name in log["joints"][0] if name == "position"] == ["position"] * angle
    labels = [attrs["aria-label"] or "" for _, attrs in page.tags if "data-joint" in attrs]
    assert [label.endswith("over time, and its position") for label in labels] == [angle] * 3


def test_tables_hold_the_reports_figures(report: dict[str, Any]) -> None:
    page = page_of(report)
    sets = page.table("not realizable", ["set"])
    assert list(sets) == ["none", "semi", "full", "ellipsoid"]
    assert sets["none"]["not realizable"] == "2 of 6"
    assert sets["none"]["worst margin"] == "-0.30"
    assert sets["semi"]["solved in [ms]"] == "24.0"
    assert sets["ellipsoid"]["form"] == "4×4, 1 linear"
    assert sets["full"]["held out [N·m]"] == "1.02"
    assert page.table("ellipsoid", ["joint [N·m]"])[SLIDE]["ellipsoid"] == "1.13"
    assert page.table("ellipsoid", ["body [kg]"])[BODY] == {
        "body [kg]": BODY, "none": "-0.5000", "semi": "0.5000", "full": "0.5000", "ellipsoid": "0.5000"
    }  # fmt: skip
    assert page.table("semi", ["samples"])["10"]["semi"] == "1.60"
    estimators = page.table("status", ["estimator"])
    assert estimators["entropic"]["duality gap"] == "1.0e-09"
    assert estimators["manifold"]["duality gap"] == "–"
    assert "It stopped 12 % above the convex optimum." in page.plain
    assert page.table("error below 10 % for good after [s]", ["set"]) == {
        name: {"set": name, "error below 10 % for good after [s]": t}
        for name, t in (("none", "–"), ("full", "4.61"), ("ellipsoid", "1.15"))
    }
