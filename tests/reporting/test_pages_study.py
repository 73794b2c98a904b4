"""study.html: its findings follow from the figures, its charts and tables hold them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from pages import BODY, SCRIPT, SLIDE, DrawnFigure, Page, complete, evaluation_of, notice_of, study_of
from records import partial

from idtool.reporting.pages.study import LearningSummary, learning, study_page
from idtool.reporting.results.study import LearningCurves, StudyReport

JOINTS = (SCRIPT, SLIDE, "knee")
BODIES = (BODY, "thigh", "shank", "r1", "r2", "r3")


LEARNING, ADVANTAGE = "Fig. 5: held-out error", "Reduction of the held-out error relative to the set “none”"
VIOLATION, ONLINE = "Worst violation of realizability", "Remark 5: parameter error of the online estimate"


def batched(traces: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Traces three at a time: of a band the lower and upper edge and the curve."""
    return [traces[i : i + 3] for i in range(0, len(traces), 3)]


def levels(figure: DrawnFigure) -> list[float]:
    """Where lines are drawn across."""
    return [shape["y0"] for shape in figure.layout["shapes"]]


@pytest.fixture
def report() -> dict[str, Any]:
    """The content of study.json, to be changed at will."""
    return study_of(JOINTS, BODIES)


def page_of(report: dict[str, Any], angle: bool = True, command: str = "idtool study x") -> Page:
    t = np.linspace(0, 10, 400)
    measured = np.stack([np.sin(t), np.cos(t), np.sin(2 * t)])
    curves = {"measured": measured, "identified": 0.9 * measured} | ({"q": 0.5 * measured} if angle else {})
    return Page(study_page(evaluation_of(curves), partial(StudyReport, report), command))


def of_draws(draws: dict[str, np.ndarray]) -> dict[str, Any]:
    """``learning`` of study.json for errors from the same draws, shape (draws, counts); NaN: not solved."""
    first = next(iter(draws.values()))
    counts = [1, 2, 5, 10, 20, 50, 100, 200][: first.shape[1]]
    curves, advantage = {}, {}
    for name, y in draws.items():
        ratios = [np.log(r[~np.isnan(r)]) for r in (first / y).T]
        advantage[name] = {
            "advantage": [float(r.mean()) if len(r) > 1 else None for r in ratios],
            "advantage_error": [float(r.std(ddof=1) / len(r) ** 0.5) if len(r) > 1 else None for r in ratios],
        }
        solved = [column[~np.isnan(column)] for column in y.T]
        quartiles = [np.quantile(c, [0.25, 0.5, 0.75]).tolist() if len(c) else [None] * 3 for c in solved]
        curves[name] = dict(zip(("lower", "median", "upper"), zip(*quartiles, strict=True), strict=True))
    violation = {name: [0.0] * len(counts) for name in draws}
    return {"counts": counts, "draws": len(y), "curves": curves, "advantage": advantage, "violation": violation}


def said_of(data: dict[str, Any]) -> LearningSummary:
    """What is said of ``learning`` of study.json."""
    return learning(partial(LearningCurves, data))


def found(errors: dict[str, list[float]]) -> LearningSummary:
    """What is said where two draws of each count have these errors."""
    return said_of(of_draws({name: np.array([y, y]) for name, y in errors.items()}))


def drawn(rng: np.random.Generator, gains: dict[str, list[float]], draws: int = 40) -> dict[str, Any]:
    """Log-normal draws, nested: what they share spreads by 1, what each set has of its own by 0.2 at all counts."""
    width = len(next(iter(gains.values())))
    shared, own = rng.normal(size=(draws, width)), rng.normal(scale=0.2, size=(len(gains), draws, 1))
    return of_draws({name: np.exp(shared + own[i] - gain) for i, (name, gain) in enumerate(gains.items())})


def test_the_page_is_complete_in_itself(report: dict[str, Any]) -> None:
    page = page_of(report)
    complete(page)
    assert page.levels == ["good", "good", "note", "good"]


def test_names_stay_text(report: dict[str, Any]) -> None:
    report["notices"] = [notice_of(SCRIPT), notice_of("a\udcff", SCRIPT)]
    report["sets"]["full"]["lmi"] = SCRIPT
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
    page = Page(study_page(evaluation_of(curves, logs=6), partial(StudyReport, report), "idtool study x"))
    complete(page)
    (online,) = page.figures_of(ONLINE)
    start = int(online.titles[-1].removeprefix("t − ").removesuffix(" [s]")) if "−" in online.titles[-1] else 0
    assert len(online.x) <= 1000
    assert online.x[-1] == times - 1 - start
    assert online.y("full")[-1] == pytest.approx(report["adaptation"]["error"]["full"][-1], rel=1e-3)


def test_the_tightest_is_best_with_few_samples(report: dict[str, Any]) -> None:
    said = said_of(report["learning"])
    assert said.order == ("ellipsoid", "full", "semi", "none")
    assert said.together == 100
    assert said.counts == (1, 2, 5, 10, 20, 30, 50)
    best = said.compared[0]
    ratio = np.prod([(1 + 1 / n) / (1 + 9 / n) for n in said.counts]) ** (1 / 7)
    assert best.name == "ellipsoid"
    assert [best.gain, best.error] == pytest.approx([1 - ratio, 0.02 * ratio])
    assert best.most == pytest.approx((1, 0.8, 0.02 * 0.2))
    text = page_of(report).plain
    assert (
        "Constraint sets fitted to fewer than 100 samples, in order of their held-out error: "
        "ellipsoid, full, semi, none. On average, the held-out" in text
    )
    assert (
        "error is lower than that of the set “none” fitted to the same samples: with ellipsoid by 51.05 ± 0.98 % ("
        in text
    )
    assert "(largest difference, with 1 sample: 80.00 ± 0.40 %), with full by" in text
    assert "clearly" not in text
    assert "With 100 samples or more, the errors of all sets are within 5 %" in text


GAINS = {"none": [0.0] * 8, "semi": [0.0] * 8, "full": [0.3] * 4 + [0.0] * 4, "ellipsoid": [0.4] * 4 + [0.0] * 4}


def test_known_advantages_are_found(rng: np.random.Generator) -> None:
    said = [said_of(drawn(rng, {k: [*gain[:4], *gain[:4]] for k, gain in GAINS.items()})) for _ in range(200)]
    for name in ("full", "ellipsoid"):
        compared = [next(c for c in one.compared if c.name == name) for one in said]
        gains = np.array([c.gain for c in compared])
        true = 1 - np.exp(-GAINS[name][0])
        assert gains.mean() == pytest.approx(true, abs=4 * gains.std() / len(said) ** 0.5)
        assert np.mean([c.error for c in compared]) == pytest.approx(gains.std(), rel=0.2)
        assert all(c.clear for c in compared)


def test_sets_alike_are_seldom_called_clearly_different(rng: np.random.Generator) -> None:
    # A twentieth is what twice the standard error would give; √4 counts fewer standard errors, a seventh.
    gains = {name: [0.0] * 8 for name in ("none", "a", "b", "c", "d")} | {"full": GAINS["full"]}
    said = [said_of(drawn(rng, gains)) for _ in range(200)]
    clear = [c.clear for one in said for c in one.compared if c.name != "full"]
    assert len(clear) == 800
    assert np.mean(clear) < 0.015


def test_each_set_is_said_to_be_better_worse_or_neither(report: dict[str, Any], rng: np.random.Generator) -> None:
    report["learning"] = drawn(rng, {**GAINS, "points": [-0.5] * 4 + [0.0] * 4})
    page = page_of(report)
    share, most = r"\d+\.\d ± \d\.\d %", r"\(largest difference, with \d+ samples?: [^)]+\)"
    assert re.search(
        f": with ellipsoid by {share} {most}, with full by {share} {most}. "
        f"The error of points is clearly larger than that of the set “none”, by {share}. "
        rf"These sets are not clearly better than the set “none”: semi \(-?{share}\). Many",
        page.plain,
    )
    assert page.levels[0] == "note"


def test_a_difference_that_the_solver_leaves_is_none() -> None:
    said = found({"none": [9.0, 1.0], "semi": [9.0 * (1 - 1e-6), 1.0], "full": [3.0, 1.0]})
    assert [(c.name, c.clear) for c in said.compared] == [("full", True), ("semi", False)]


def test_curves_that_stay_apart_are_said_to(report: dict[str, Any]) -> None:
    draws = {"none": [9.0, 5.0, 3.0, 1.2], "full": [2.0, 1.5, 1.2, 1.1]}
    report["learning"] = of_draws({name: np.array([y, y]) for name, y in draws.items()})
    said = said_of(report["learning"])
    assert said.together is None
    assert said.counts == (1, 2)
    assert (
        "Constraint sets fitted to 2 or fewer samples, in order of their held-out error: full, none."
        in page_of(report).plain
    )


def test_curves_that_part_again_are_not_together() -> None:
    assert found({"none": [9.0, 1.0, 3.0, 1.0, 1.04], "full": [1.0] * 5}).together == 10


def test_errors_whose_medians_only_agree_are_apart() -> None:
    errors = np.array([[2.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    assert said_of(of_draws({"none": errors, "full": np.ones((3, 2))})).together == 2


def test_curves_that_never_part_have_no_best(report: dict[str, Any]) -> None:
    said = found({"none": [1.0, 1.01], "full": [1.02, 1.0]})
    assert (said.compared, said.together) == ((), 1)
    report["learning"] = of_draws({name: np.ones((3, 4)) for name in GAINS})
    assert page_of(report).levels == ["good", "note", "good"]


def test_equal_sets_keep_their_order() -> None:
    said = found({"none": [9.0, 1.0], "shape": [2.0, 1.0], "semi": [9.0, 1.0], "ellipsoid": [2.0, 1.0]})
    assert said.order == ("shape", "ellipsoid", "none", "semi")
    assert [c.clear for c in said.compared] == [True, True, False]


def test_a_set_without_pairs_is_not_compared(report: dict[str, Any]) -> None:
    draws = {name: np.array([[y, 1.0, 1.0]] * 3) for name, y in (("none", 9), ("full", 3), ("semi", 8))}
    draws["full"][:2, 0] = np.nan
    report["learning"] = of_draws(draws)
    said = said_of(report["learning"])
    assert (said.order, said.together) == (("semi", "none"), 2)
    assert "semi, none. " in page_of(report).plain
    assert "too few draws could be solved for one of the sample counts: full." in page_of(report).plain
    draws["none"][:2, 0] = np.nan
    report["learning"] = of_draws(draws)
    page = page_of(report)
    assert (
        "in order of their held-out error: not known. These sets are not compared, because too few draws" in page.plain
    )
    assert "for one of the sample counts: none, full, semi." in page.plain
    assert page.levels[0] == "note"


def test_all_the_data_are_one_draw(report: dict[str, Any]) -> None:
    last = np.array([[9.0, 1.0]] + [[9.0, np.nan]] * 2)
    apart, together = ({"none": last, "full": last / ratio} for ratio in ([3.0, 1.2], [3.0, 1.02]))
    assert said_of(of_draws(apart)).together is None
    assert said_of(of_draws(together)).together == 2
    report["learning"] = of_draws(together)
    (gains,) = page_of(report).figures_of(ADVANTAGE)
    assert gains.data[0]["y"] == [pytest.approx(100 * 2 / 3, rel=1e-3), None]  # the band's lower edge


def test_sets_whose_bodies_cannot_exist_are_named(report: dict[str, Any]) -> None:
    text = page_of(report).plain
    assert "not realizable: none 2 of 6, semi 1 of 6." in text
    assert (
        "In the fits to 30 samples, the median over the draws of the worst body's violation of realizability is: "
        "none 0.027, semi 0.010" in text
    )
    for name in ("none", "semi"):
        report["sets"][name]["violations"] = 0
        report["learning"]["violation"][name] = [0.0] * 10
    page = page_of(report)
    assert page.levels == ["good"] * 4
    assert "the bodies of all sets are realizable" in page.plain


def test_the_first_to_converge_online_is_named(report: dict[str, Any]) -> None:
    text = page_of(report).plain
    assert "The parameter error falls below 10 % earliest with ellipsoid, after 1.15 s; with full after 4.61 s." in text
    assert "It does not fall below 10 % before the end of the data with none." in text
    report["adaptation"]["time_to_10_percent"]["full"] = 1.151
    assert "falls below 10 % earliest with full and ellipsoid, after 1.15 s." in page_of(report).plain
    report["adaptation"]["time_to_10_percent"] = dict.fromkeys(("none", "full", "ellipsoid"))
    assert (
        "The parameter error does not fall below 10 % before the end of the data with any set" in page_of(report).plain
    )


def test_what_was_not_solved_breaks_a_line(report: dict[str, Any]) -> None:
    report["learning"]["violation"]["none"] = [None] * 10
    report["learning"]["curves"]["none"]["median"][0] = None
    page = page_of(report)
    assert page.table("semi", ["samples"])["1"]["none"] == "–"
    assert page.figures_of(VIOLATION)[0].y("none") == [None] * 10
    assert page.figures_of(LEARNING)[0].y("none")[:2] == [None, 5.5]
    assert "worst body's violation of realizability is: semi 0.010" in page.plain


def test_charts_hold_the_reports_figures(report: dict[str, Any]) -> None:
    page = page_of(report)
    (errors,), (gains,) = page.figures_of(LEARNING), page.figures_of(ADVANTAGE)
    (broken,), (online,) = page.figures_of(VIOLATION), page.figures_of(ONLINE)
    assert errors.x == report["learning"]["counts"]
    assert errors.titles == ["RMS torque error [N·m]", "training samples"]
    assert errors.layout["xaxis"]["type"] == errors.layout["yaxis"]["type"] == "log"
    assert errors.names == ["none", "semi", "full", "ellipsoid"]
    for lower, upper, median in batched(errors.data):
        curve = report["learning"]["curves"][median["name"]]
        for drawn, wanted in ((median, "median"), (lower, "lower"), (upper, "upper")):
            np.testing.assert_allclose(drawn["y"], curve[wanted], rtol=1e-3)
    assert gains.names == ["semi", "full", "ellipsoid"]
    assert levels(gains) == [0]
    for lower, upper, mean in batched(gains.data):
        advantage = np.array(report["learning"]["advantage"][mean["name"]]["advantage"])
        for drawn, errors_away in ((mean, 0), (lower, -2), (upper, 2)):
            wanted = 100 * (1 - np.exp(-advantage - errors_away * 0.02))
            np.testing.assert_allclose(drawn["y"], wanted, rtol=1e-3, atol=1e-9)
    assert broken.names == ["none", "semi", "full", "ellipsoid"]
    for line in broken.data:
        np.testing.assert_allclose(line["y"], report["learning"]["violation"][line["name"]], rtol=1e-3)
    assert online.names == ["none", "full", "ellipsoid"]
    assert levels(online) == [0.1]
    for line in online.data:
        wanted = np.interp(online.x, report["adaptation"]["t"], report["adaptation"]["error"][line["name"]])  # type: ignore[arg-type]
        np.testing.assert_allclose(line["y"], wanted, rtol=1e-3)


def test_a_set_has_one_colour_in_all_charts(report: dict[str, Any]) -> None:
    colors: dict[str, set[str]] = {}
    figures = [figure for figure in page_of(report).figures if not figure.label.startswith("Measured")]
    assert len(figures) == 4
    for figure in figures:
        for trace in figure.data:
            if "name" in trace:
                line = trace["line"]
                colors.setdefault(trace["name"], set()).add(line["color"] + line.get("dash", "solid"))
    assert all(len(used) == 1 for used in colors.values())
    assert len(set.union(*colors.values())) == len(colors)


@pytest.mark.parametrize("angle", [True, False])
def test_the_angle_is_drawn_where_it_was_kept(report: dict[str, Any], angle: bool) -> None:
    page = page_of(report, angle)
    figures = page.figures_of("Measured and predicted torque and residual of")
    assert [joint in figure.label for joint, figure in zip(JOINTS, figures, strict=True)] == [True] * 3
    for figure in figures:
        assert ("position" in figure.names) == angle
        assert figure.label.endswith("over time, and its position") == angle


def test_tables_hold_the_reports_figures(report: dict[str, Any]) -> None:
    page = page_of(report)
    sets = page.table("not realizable", ["set"])
    assert list(sets) == ["none", "semi", "full", "ellipsoid"]
    assert sets["none"]["not realizable"] == "2 of 6"
    assert sets["none"]["worst margin"] == "-0.30"
    assert sets["semi"]["solved in [ms]"] == "24.0"
    assert sets["ellipsoid"]["inequalities"] == "4×4, 1 linear"
    assert sets["full"]["held out"] == "1.02"
    assert "Constraint sets: RMS torque error, N·m, below 40 Hz" in page.plain
    assert page.table("ellipsoid", ["joint"])[SLIDE]["ellipsoid"] == "1.13"
    assert page.table("ellipsoid [kg]", ["body"])[BODY] == {
        "body": BODY, "none [kg]": "-0.500", "semi [kg]": "0.500", "full [kg]": "0.500", "ellipsoid [kg]": "0.500"
    }  # fmt: skip
    assert page.table("semi", ["samples"])["10"]["semi"] == "1.60"
    estimators = page.table("status", ["estimator"])
    assert estimators["entropic"]["duality gap"] == "1e-09"
    assert estimators["manifold"]["duality gap"] == "–"
    assert "Online: time to 10 % parameter error" in page.plain
    assert page.table("time [s]", ["set"]) == {
        name: {"set": name, "time [s]": t}
        for name, t in (("none", "not reached"), ("full", "4.61"), ("ellipsoid", "1.15"))
    }
