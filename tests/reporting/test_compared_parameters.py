"""Two results side by side: what their data say, whether it differs by more than chance, and what cannot be told."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
import yaml
from commands import LEG, TRAIN, VALIDATE
from pages import BODY, SCRIPT, Page

import idtool
from idtool.estimation.uncertainty.welch import welch_p_values
from idtool.reporting.compare_report import compare_report
from idtool.reporting.compared_settings import changed_settings
from idtool.reporting.pages.compare import comparison_page
from idtool.reporting.results.comparison import ComparedParameter, ComparisonReport
from idtool.reporting.results.fit import FitReport
from idtool.reporting.stored_fit import StoredFit
from idtool.robot.config import parse_config

Report = dict[str, Any]
HASH = "1" * 64


def part(log: idtool.Log, name: str, samples: slice) -> idtool.Log:
    """Some samples of a log."""
    assert log.q is not None
    assert log.v is not None
    assert log.tau is not None
    return idtool.Log.from_arrays(
        name, log.t[samples], log.joints, q=log.q[samples], v=log.v[samples], tau=log.tau[samples]
    )


@pytest.fixture(scope="module")
def fitted() -> idtool.FitResult:
    """The leg, fitted to three seconds."""
    log = part(idtool.Log(TRAIN), "first", slice(0, 3000))
    return idtool.fit(LEG, log, holdout=0.2, simulation=False)


@pytest.fixture(scope="module")
def other() -> idtool.FitResult:
    """The same leg, fitted to three seconds of another log."""
    log = part(idtool.Log(VALIDATE), "second", slice(0, 3000))
    return idtool.fit(LEG, log, holdout=0.2, simulation=False)


@pytest.fixture
def report(fitted: idtool.FitResult) -> Report:
    """The content of its report.json, to be changed at will."""
    return fitted.to_json()


def stored(content: Report, config: Mapping[str, Any] | None = None) -> StoredFit:
    settings = None if config is None else parse_config(config, "model.yaml")
    return StoredFit("report.json", FitReport.model_validate(content), settings)


def compared(a: Report, b: Report) -> ComparisonReport:
    return compare_report(stored(a), stored(b))


def parameter(result: ComparisonReport, kind: str, of: str, what: str) -> ComparedParameter:
    (found,) = [p for p in result.parameters if (p.kind, p.what) == (kind, what) and of in (p.of, p.owners[0])]
    return found


def moved(report: Report, index: int, errors: float) -> Report:
    """A report in which a base parameter and its interval have moved by some standard errors."""
    changed = copy.deepcopy(report)
    base = changed["base_parameters"]["parameters"][index]
    change = errors * base["standard_error"]
    base["value"] += change
    base["interval"] = [end + change for end in base["interval"]]
    return changed


def test_the_estimates_are_those_of_the_data_alone(fitted: idtool.FitResult) -> None:
    """A report has them only within its intervals."""
    result = idtool.compare(fitted, fitted)
    analysis = fitted._fit.uncertainty_analysis
    assert analysis.identifiability is not None
    B = analysis.identifiability.base.B
    expected = B @ analysis.cluster_robust.theta
    base = [p for p in result.parameters if p.kind == "base"]
    assert len(base) == len(B)
    for p, estimate, value in zip(base, expected, B @ analysis.theta, strict=True):
        assert p.a is not None
        assert p.a.estimate == pytest.approx(estimate, rel=1e-9, abs=1e-12)
        assert p.a.value == pytest.approx(value)


def test_the_test_is_welchs(fitted: idtool.FitResult, other: idtool.FitResult) -> None:
    """With the degrees of freedom of each standard error, which a report has in the widths of its intervals."""
    result = idtool.compare(fitted, other)
    analyses = [fit._fit.uncertainty_analysis for fit in (fitted, other)]
    assert analyses[0].identifiability is not None
    B = analyses[0].identifiability.base.B
    freedom = np.column_stack([analysis.uncertainty.degrees_of_freedom(B) for analysis in analyses])
    for p, (of_a, of_b) in zip([p for p in result.parameters if p.kind == "base"], freedom, strict=True):
        assert p.a is not None
        assert p.b is not None
        assert p.a.standard_error is not None
        assert p.b.standard_error is not None
        sizes = of_a + 1, of_b + 1
        deviations = [value.standard_error * np.sqrt(n) for value, n in zip((p.a, p.b), sizes, strict=True)]
        arguments = p.a.estimate, deviations[0], sizes[0], p.b.estimate, deviations[1], sizes[1]
        expected = scipy.stats.ttest_ind_from_stats(*arguments, equal_var=False).pvalue
        assert p.p_value == pytest.approx(expected, rel=1e-5)


def test_two_logs_of_a_robot_agree(fitted: idtool.FitResult, other: idtool.FitResult) -> None:
    result = idtool.compare(fitted, other)
    assert result.answer == "agree"
    assert result.differing == 0
    assert result.compared > 30
    assert result.summary.startswith(f"The same, as far as the data tell: none of {result.compared} parameters")
    assert result.detectable is not None
    assert 0.01 < result.detectable < 1
    assert not result.same_logs
    assert repr(result).startswith(f"ComparisonResult: {result.summary}")


def test_a_result_is_equal_to_itself(report: Report) -> None:
    result = compared(report, report)
    assert result.summary == "The same estimates: all 38 parameters that the data of both determine are equal."
    assert result.settings == ()


def test_parameters_of_the_same_name_are_compared_each(report: Report) -> None:
    """As the coefficients of two end stops of a joint."""
    parameters = report["base_parameters"]["parameters"]
    own = next(i for i, p in enumerate(parameters) if p["name"] == "hip coulomb")
    other = next(i for i, p in enumerate(parameters) if p["name"] == "knee coulomb")
    parameters[other]["terms"][0] = copy.deepcopy(parameters[own]["terms"][0])
    assert compared(report, report).compared == len(parameters)
    assert [compared(report, moved(report, i, 12)).differing for i in (own, other)] == [1, 1]


def test_two_effects_of_a_kind_on_a_joint_are_the_same_two_in_any_order(report: Report) -> None:
    def stop(position: float, stiffness: float) -> Report:
        return {
            "effect": "end_stop",
            "joint": "knee",
            "link": None,
            "parameters": {"stiffness": stiffness, "position": position},
            "standard_error": {"stiffness": 1.0, "position": None},
            "units": {"stiffness": "N·m/rad", "position": "rad"},
        }

    other = copy.deepcopy(report)
    report["effects"] = [stop(-1.2, 300.0), stop(0.8, 90.0)]
    other["effects"] = [stop(0.8, 92.0), stop(-1.2, 301.0)]
    differences = [p.difference for p in compared(report, other).parameters if p.what.startswith("stiffness")]
    assert differences == pytest.approx([1.0, 2.0])


def test_a_delay_in_one_result_alone_says_nothing_of_the_models(report: Report) -> None:
    """A log with torque, and one with commands, of the same robot."""
    controlled = copy.deepcopy(report)
    delay = {"delay": 0.003, "given": None, "fitted": 0.003, "standard_error": 1e-4, "correlation": None, "text": None}
    controlled["controller"] = {**delay, "known_friction_standard_error": None, "contradicted": None}
    result = compared(report, controlled)
    assert "combinations_differ" not in [notice.code for notice in result.notices]
    assert result.not_compared == 0


def test_what_differs_is_named(report: Report) -> None:
    names = [p["name"] for p in report["base_parameters"]["parameters"]]
    index = names.index("hip coulomb")
    result = compared(report, moved(report, index, 12))
    assert result.answer == "differ"
    assert result.differing == 1
    assert [p.of for p in result.parameters if p.differs and p.kind == "base"] == ["hip coulomb"]
    assert "1 of 38 parameters that the data of both determine differs by more than chance" in result.summary
    assert "most clearly hip coulomb" in result.summary
    assert "N·m in B" in result.summary


def test_what_all_differences_involve_is_named(report: Report) -> None:
    changed = report
    for index, p in enumerate(report["base_parameters"]["parameters"]):
        if any(term["of"] == "shank_link" for term in p["terms"]):
            changed = moved(changed, index, 15)
    result = compared(report, changed)
    assert result.differing > 5
    assert "all of which involve shank_link; most clearly" in result.summary


def test_a_difference_within_the_errors_is_chance(report: Report) -> None:
    assert compared(report, moved(report, 3, 1.5)).answer == "agree"


def test_of_the_same_robot_few_pairs_are_said_to_differ(report: Report, rng: np.random.Generator) -> None:
    """At most the rate of false discoveries, but for the noise of 100 pairs."""
    base = report["base_parameters"]["parameters"]
    differ = 0
    for _ in range(100):
        pair = [copy.deepcopy(base), copy.deepcopy(base)]
        for own in pair:
            for p in own:
                change = p["standard_error"] * rng.normal()
                half_width = 1.96 * p["standard_error"]
                p["value"] += change
                p["interval"] = [p["value"] - half_width, p["value"] + half_width]
        results = [{**report, "base_parameters": {**report["base_parameters"], "parameters": own}} for own in pair]
        differ += compared(*results).answer == "differ"
    assert differ <= 12


def test_a_value_that_rests_on_the_prior_never_differs(report: Report) -> None:
    """Another prior alone changes it."""
    changed = copy.deepcopy(report)
    assert report["bodies"]["thigh_link"]["rests_on"][0]["on"] == "prior"
    changed["bodies"]["thigh_link"]["pi"][0] *= 2
    changed["bodies"]["thigh_link"]["mass"] *= 2
    result = compared(report, changed)
    mass = parameter(result, "body", "thigh_link", "m")
    assert mass.differs is None
    assert mass.p_value is None
    assert mass.reason == "rests on the prior in A and B"
    assert result.answer == "agree"


def test_a_value_that_rests_on_the_prior_in_one_result_never_differs(report: Report) -> None:
    sources = report["bodies"]["shank_link"]["rests_on"]
    index = next(i for i, source in enumerate(sources) if source["on"] == "data")
    changed = copy.deepcopy(report)
    body = changed["bodies"]["shank_link"]
    body["rests_on"][index]["on"] = "constraints"
    change = 100 * body["standard_error"][index]
    body["pi"][index] += change
    body["interval"][index] = [end + change for end in body["interval"][index]]
    result = compared(report, changed)
    reasons = [p.reason for p in result.parameters if p.kind == "body" and p.owners == ("shank_link",)]
    assert reasons[index] == "rests on the constraints in B"


def test_logs_that_scatter_enlarge_the_standard_errors(report: Report) -> None:
    base = report["base_parameters"]["parameters"]
    scattered = copy.deepcopy(report)
    parameters = [
        {"name": p["name"], "unit": p["unit"], "value": [0, 0], "standard_error": [1, 1], "ratio": 4.0, "agrees": False}
        for p in base
    ]
    scattered["repeatability"] = {
        "logs": ["a", "b"],
        "agree": False,
        "odd_one_out": None,
        "cross_rms": [[1, 1], [1, 1]],
        "parameters": parameters,
    }
    before = compared(report, moved(report, 0, 6))
    after = compared(scattered, moved(report, 0, 6))
    assert before.answer == "differ"
    assert after.answer == "agree"
    first = next(p for p in after.parameters if p.kind == "base")
    assert first.a is not None
    assert first.a.standard_error == pytest.approx(4 * base[0]["standard_error"])


def test_other_combinations_are_not_compared(report: Report) -> None:
    """A longer thigh changes what a base parameter is, though it has the same name."""
    changed = moved(report, 4, 50)
    changed["base_parameters"]["parameters"][4]["terms"][1]["share"] *= 1.1
    result = compared(report, changed)
    base = [p for p in result.parameters if p.kind == "base"]
    assert base[4].differs is None
    assert "another combination" in base[4].reason
    assert result.answer == "agree"
    assert "combinations_differ" in [notice.code for notice in result.notices]


def test_other_terms_are_said(report: Report) -> None:
    changed = copy.deepcopy(report)
    del changed["base_parameters"]["parameters"][5]
    result = compared(report, changed)
    (notice,) = [notice for notice in result.notices if notice.code == "combinations_differ"]
    assert "1 parameter without counterpart" in notice.message


def test_without_base_parameters_single_ones_are_compared(report: Report) -> None:
    quick = copy.deepcopy(report)
    quick["base_parameters"] = None
    for body in quick["bodies"].values():
        body["rests_on"] = None
    result = compared(report, quick)
    assert result.answer == "agree"
    assert {p.kind for p in result.parameters if p.differs is not None} == {"body", "friction", "rotor"}
    assert "compared_quick" in [notice.code for notice in result.notices]


def test_robots_with_different_joints_are_compared_in_what_they_share(report: Report) -> None:
    changed = copy.deepcopy(report)
    changed["joints"] = [*report["joints"], "ankle"]
    for by_joint in (changed["units"], changed["rms"]["train"], changed["rms"]["validation"]):
        by_joint["ankle"] = "N·m" if by_joint is changed["units"] else 0.1
    result = compared(report, changed)
    assert result.joints_only_in_b == ("ankle",)
    assert result.summary.startswith("Not the same joints: only B has ankle. ")
    assert result.compared == 38


def test_numbers_beyond_all_bounds_are_not_compared(report: Report) -> None:
    """A stranger's file may have any: their squares would overflow."""
    changed = copy.deepcopy(report)
    changed["base_parameters"]["parameters"][0]["interval"][1] = 1e300
    changed["base_parameters"]["parameters"][1]["standard_error"] = 1e-310
    changed["friction"]["hip"]["standard_error"]["viscous"] = 1e300
    result = compared(report, changed)
    undecided = [p.reason for p in result.parameters if p.kind == "base"][:2]
    assert undecided == ["given, or not determined by the data in B"] * 2
    assert result.compared == 36


def test_nothing_in_common_is_not_an_answer(report: Report) -> None:
    changed = copy.deepcopy(report)
    for key in ("bodies", "friction", "friction_intervals", "rotors"):
        changed[key] = {}
    changed["base_parameters"] = None
    result = compared(report, changed)
    assert result.answer == "unknown"
    assert "cannot be told" in result.summary


def test_a_log_in_both_is_said(report: Report) -> None:
    report["inputs"].append({"kind": "log", "path": "run1.mcap", "sha256": HASH})
    changed = moved(report, 0, 20)
    result = compared(report, changed)
    assert result.same_logs
    assert result.logs_in_both == ("run1.mcap",)
    assert result.summary.startswith("Not the same model, though a log is part of both: ")
    assert "not_independent" in [notice.code for notice in result.notices]


def test_doubts_about_a_result_are_passed_on(report: Report) -> None:
    notice = {"code": "logs_disagree", "severity": "warning", "subject": None, "message": "logs differ", "advice": ""}
    doubtful = {**report, "notices": [notice], "verdict": "do_not_use"}
    notices = {(notice.code, notice.subject) for notice in compared(report, doubtful).notices}
    assert {("compared_doubtful", "B"), ("compared_unusable", "B")} <= notices


def test_settings_that_differ_are_listed_and_identified_values_are_not(report: Report) -> None:
    friction = "friction: {hip: {viscous: {value: 0.1, standard_error: 0.01}, coulomb: %s}}\nvelocity: %s\n"
    a = stored(report, yaml.safe_load(friction % ("{value: 1.0}", "auto")))
    changed = {**report, "idtool": "9.9", "band_hz": 30.0}
    b = stored(changed, yaml.safe_load(friction % ("false", "measured")))
    settings = {setting.name: (setting.a, setting.b) for setting in changed_settings(a, b)}
    assert settings == {
        "idtool": (report["idtool"], "9.9"),
        "filter.cutoff_hz, as used": ("40.00 Hz", "30.00 Hz"),
        "friction.hip.coulomb": ("true", "false"),
        "velocity": ("auto", "measured"),
    }


def test_a_part_that_one_configuration_lacks_is_one_setting(report: Report) -> None:
    rotor = {"joint": "hip", "gear_ratio": 10.0}
    both = stored(report, {"rotors": {"r1": rotor}}), stored(report, {"rotors": {"r1": rotor, "r2": rotor}})
    (setting,) = changed_settings(*both)
    assert (setting.name, setting.a) == ("rotors.r2", None)
    assert setting.b is not None
    assert '"gear_ratio": 10.0' in setting.b


def test_the_page_shows_the_answer_and_escapes_names(report: Report) -> None:
    hostile = moved(report, 0, 20)
    hostile["urdf"] = SCRIPT
    hostile["bodies"] = {BODY if name == "thigh_link" else name: body for name, body in report["bodies"].items()}
    result = compared(report, hostile)
    html = comparison_page(result, "idtool compare a b")
    assert SCRIPT not in html
    assert BODY not in html
    page = Page(html)
    assert "The results differ" in page.text
    assert " ".join(result.summary.split()) in " ".join(page.text.replace("\u00a0", " ").split())


def test_estimates_without_error_are_not_tested() -> None:
    value = np.array([[1.0, 2.0], [1.0, 2.0]])
    error = np.array([[0.1, 0.0], [0.1, np.inf]])
    assert np.isnan(welch_p_values(value, error, np.full((2, 2), 10.0))).all()


def test_the_files_are_those_of_the_record(fitted: idtool.FitResult, tmp_path: Path) -> None:
    result = idtool.compare(fitted, fitted)
    written = result.save(tmp_path)
    assert {path.name for path in written} == {"comparison.json", "comparison.html"}
    assert "idtool.compare(FitResult, FitResult)" in (tmp_path / "comparison.html").read_text()
