"""diagnosis.html: well-formed, complete in itself, safe from the names in it, and true to the results."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commands import JOINTS
from diagnoses import (
    BEHIND,
    PROFILE,
    STRIBECK,
    candidate,
    diagnosis_of,
    faulty,
    fits,
    level,
    residual,
    step_of,
    unknown_of,
)
from pages import SCRIPT, Page, complete, evaluation_of, notice_of
from records import partial
from rollouts import experiment_of, rollouts_of

from idtool.common.notice import Notice
from idtool.common.number_text import number
from idtool.diagnosis.records import Diagnosis, ErrorSummary, ResidualLocation
from idtool.estimation.fit import Fit
from idtool.reporting.diagnosis_report import diagnosis_report
from idtool.reporting.pages.diagnosis import diagnosis_page, parameter_texts
from idtool.reporting.results.base import NoticeReport
from idtool.reporting.results.diagnosis import DiagnosisReport, StepReport

GAP = "Errors of "
NOTICE = Notice("any", "warning", None, "something")


@pytest.fixture(scope="module")
def leg(tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, Fit]:
    return fits(tmp_path_factory.mktemp("leg"))


@pytest.fixture
def found(leg: tuple[Fit, Fit]) -> Diagnosis:
    """Stribeck friction on the hip, then a delay."""
    second = step_of(
        chosen=candidate("time_delay", None, score=0.3),
        parameters={"delay": 0.0051},
        standard_error={"delay": 0.0002},
        location=ResidualLocation((), (), ""),
        before=step_of().after,
        after=level(0.2, 0.55, 0.35, simulated=0.011),
        sentence="The torque is 5.1 ms late",
        pair=False,
        alternatives=(),
        rejected=(),
    )
    return diagnosis_of(*leg, step_of(), second)


def page_of(diagnosis: Diagnosis, command: str = "idtool diagnose leg.urdf", **changes: Any) -> Page:
    return Page(
        diagnosis_page(
            diagnosis, partial(DiagnosisReport, {**diagnosis_report(diagnosis, "refit").to_json(), **changes}), command
        )
    )


def test_the_page_is_complete_in_itself(found: Diagnosis) -> None:
    complete(page_of(found))
    complete(page_of(faulty(found)))


def test_names_and_texts_stay_text(found: Diagnosis) -> None:
    step = step_of(
        chosen=candidate(SCRIPT, SCRIPT),
        entry=STRIBECK,
        parameters={SCRIPT: SCRIPT},
        location=ResidualLocation((SCRIPT,), (), SCRIPT),
        distinguishing_experiment=SCRIPT,
        sentence=SCRIPT,
        alternatives=(candidate(SCRIPT, SCRIPT, reason=SCRIPT),),
        rejected=(candidate(BEHIND, BEHIND, reason=BEHIND),),
    )
    page = page_of(
        faulty(replace(found, steps=(step,))),
        f"idtool diagnose {SCRIPT} \udcff",
        notices=[NoticeReport(**notice_of("a\udcff"))],
    )
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert "<" not in page.scripts[1]
    for text in (f"idtool diagnose {SCRIPT} ?", "a?", BEHIND, f"{SCRIPT}: {SCRIPT}"):
        assert text in page.text


def test_the_findings_say_how_far_to_trust_them(found: Diagnosis) -> None:
    page = page_of(found)
    assert page.levels[:3] == ["note", "good", "good"]  # a pair, the delay, the rollouts
    lacks = "The original model lacks Stribeck friction on hip (or load-dependent friction on hip) and a time delay"
    assert lacks in page.plain
    assert "The data cannot distinguish it from load-dependent friction on hip." in page.plain
    assert "The residual that it explains on data not used for fitting is 21 times its standard error." in page.plain
    rollouts = "simulation is 0.0110 rad RMS for the final model and 0.0300 rad for the original model."
    assert f"position error of the {rollouts}" in page.plain
    page = page_of(faulty(found))
    assert page.levels[:3] == ["note", "good", "bad"]  # the unknown last
    assert page.plain.count(f"Data. hip: {BEHIND}") == 1
    assert "Removed effect" in page.plain


def test_a_doubt_stands_at_its_step(found: Diagnosis) -> None:
    first, second = found.steps
    page = page_of(replace(found, steps=(first, replace(second, doubt="too heavy to be true"))))
    assert page.levels[:2] == ["note", "note"]
    assert "Doubtful. Too heavy to be true." in page.plain


def test_rollouts_that_got_worse_are_called_so(found: Diagnosis) -> None:
    worse = level(0.2, 0.55, 0.35, simulated=0.04)
    first, second = found.steps
    assert "motion gets worse" not in page_of(found).plain
    page = page_of(replace(found, steps=(first, replace(second, after=worse)), after=worse))
    assert page.levels[:2] == ["note", "note"]
    assert page.plain.count("Do not simulate the model") == 1
    change = "all joints 0.0120 → 0.0400 rad"
    motion = f"the simulated motion gets worse at this step: {change}"
    sentence = f"the torque of all joints together is predicted better, but {motion}."
    assert page.plain.count(sentence) == 2  # among the findings, and at the step
    assert "2. Time delay on all joints: the simulated motion gets worse" in page.plain
    assert "1. Stribeck friction on hip: the simulated" not in page.plain
    assert bad_cells(page) == 1 + len(JOINTS) + 1  # of the step, and of all joints
    assert bad_cells(page_of(found)) == 0


def bad_cells(page: Page) -> int:
    return sum(tag == "td" and attrs.get("class") == "bad" for tag, attrs in page.tags)


def test_the_gap_is_drawn_step_by_step(found: Diagnosis) -> None:
    gap = page_of(found).figures_of(GAP)
    names = ["original model", "1: Stribeck friction on hip", "2: time delay on all joints"]
    assert [figure.label for figure in gap] == [
        f"{GAP}{name} by step, against the noise floor" for name in ("all joints", *JOINTS)
    ]
    hip = gap[2]
    assert [hip.data[0]["text"], hip.data[2]["text"]] == [names, names]
    assert hip.titles == ["torque [N·m]", "position [rad]", "step"]
    assert hip.layout["xaxis"]["ticktext"] == ["original", "1", "2"]
    assert hip.y("torque") == pytest.approx([1.43, 0.66, 0.605])
    assert hip.y("noise floor") == [0.5, 0.5]
    assert hip.y("simulation") == [0.03, 0.012, 0.011]
    left = faulty(found)
    assert page_of(left).figures_of(GAP) == gap  # what is unknown moves nothing
    ended = replace(found, after=level(0.2, 0.52, 0.35, simulated=0.011))
    hip = page_of(ended).figures_of(GAP)[2]
    assert hip.data[0]["text"][-1] == "final model"
    assert hip.layout["xaxis"]["ticktext"] == ["original", "1", "2", "final"]
    assert hip.y("torque")[-1] == pytest.approx(0.572)


def test_tables_hold_the_reports_figures(found: Diagnosis) -> None:
    page = page_of(found)
    hip = next(row for row in page.rows if row[0] == "hip" and len(row) == 8)
    assert hip == ["hip", "1.43", "0.605", "0.500", "89 %", "0.550", "0.0300", "0.0110"]
    step = next(row for row in page.rows if row[:3] == ["1", "Stribeck friction", "hip"])
    assert step[3] == "stribeck 1.91\u00a0±\u00a00.20\u00a0N·m, velocity 0.150\u00a0rad/s"
    assert step[4] == "0.873 → 0.475"
    assert "N·m, <br>velocity" in page.html  # one below the other
    assert step[5:] == ["0.0300 → 0.0120", "64.0 ± 3.0 %", "21", "load-dependent friction on hip"]
    words = {row[0]: row[1] for row in page.rows if len(row) == 2}
    assert words["location of the residual"] == "all joints"  # the last of equal heads: of the delay
    assert "64.0 ± 3.0 % of the mean square residual" in page.plain
    assert "1.2 to 2.5 s, 4.00 to 4.50 s" in page.plain
    assert ["backlash", "hip", "10.0 ± 3.0 %", "2", "within two standard errors of zero"] in page.rows


def test_residuals_are_drawn_before_and_after(found: Diagnosis) -> None:
    titles = ["position [rad]", "velocity [rad/s]", "torque [N·m]", "time [s]", "frequency [Hz]", "periods per turn"]
    page = page_of(found)
    for joint in JOINTS:
        views = page.figures_of(f"Residual of {joint} against")
        assert [view.titles[-1] for view in views] == titles
        assert [view.label for view in views] == [
            f"Residual of {joint} against {title}, before and after" for title in titles
        ]
    position = page.figures_of("Residual of hip against")[0]
    mean_before, _, _, rms_after = position.data
    assert position.names == ["mean before", "RMS before", "mean after", "RMS after"]
    np.testing.assert_allclose(mean_before["y"], mean_before["x"], rtol=1e-3)
    np.testing.assert_allclose(rms_after["y"], 0.2 * np.abs(rms_after["x"]), rtol=2e-3)


def test_no_line_of_a_spectrum_is_lost_in_drawing(found: Diagnosis) -> None:
    maps = {joint: residual(1.0, lines=50_000) for joint in JOINTS}
    spectra = page_of(replace(found, maps_before=maps)).figures_of(f"Residual of {JOINTS[0]} against")[4:]
    assert len(spectra) == 2
    for spectrum in spectra:
        height = spectrum.y("before")
        assert len(height) <= 200
        assert max(height) == 1.0  # type: ignore[type-var]
        at = spectrum.data[0]["x"][height.index(1.0)]
        assert at == pytest.approx(maps["hip"].frequency[50_000 // 3], rel=1e-3)


def test_the_torque_of_both_models_is_drawn(found: Diagnosis) -> None:
    torques = page_of(found).figures_of("Measured and predicted torque")
    curves = {}
    for name, fitted in (("predicted", found.last), ("prior", found.first)):
        drawn = curves[name] = np.array([figure.y(name) for figure in torques], dtype=float)
        wanted = fitted.validation.traces[0].curves["identified"]
        pairs = (np.sort(x.reshape(3, -1, 2)) for x in (drawn, wanted))
        np.testing.assert_allclose(*pairs, atol=1e-3)
    assert np.nanmax(np.abs(curves["prior"] - curves["predicted"])) > 0.01


def test_the_rollouts_of_both_models_are_drawn(found: Diagnosis) -> None:
    page = page_of(found)
    assert found.first.simulation is not None
    drawn = np.array([figure.y("prior") for figure in page.figures_of("Measured and simulated position")], dtype=float)
    wanted = found.first.simulation.traces[0].curves["identified"]
    np.testing.assert_allclose(*(np.sort(x.reshape(3, -1, 2)) for x in (drawn, wanted)), atol=1e-3)
    assert "Prior: the original model, fitted without these effects." in page.text
    hip = page.table("hold")["hip"]
    for column, fitted in (("model", found.last), ("prior", found.first)):
        assert fitted.simulation is not None
        assert hip[column] == number(fitted.simulation.errors["identified"].rmse(JOINTS, "position")["hip"])
    assert hip["model"] != hip["prior"]


def test_a_page_without_rollouts_or_held_out_data(found: Diagnosis) -> None:
    def poor(of: ErrorSummary) -> ErrorSummary:
        return ErrorSummary(of.train, None, None)

    steps = tuple(replace(step, before=poor(step.before), after=poor(step.after)) for step in found.steps)
    last, first = (replace(fit, simulation=None) for fit in (found.last, found.first))
    page = page_of(
        replace(found, steps=steps, last=last, first=first, before=poor(found.before), after=poor(found.after))
    )
    complete(page)
    assert "Simulation" not in page.text
    assert "No data were held out" in page.plain
    assert "Rollouts" not in page.text
    gap = page.figures_of(GAP)
    assert all(figure.names == ["torque", "noise floor"] for figure in gap)
    assert gap[2].y("torque") == pytest.approx([1.3, 0.6, 0.55])


def test_a_model_of_which_one_runs_away_still_has_its_page(found: Diagnosis) -> None:
    assert found.first.simulation is not None
    assert found.last.simulation is not None
    for fit, shown in ((found.first, True), (found.last, False)):
        assert fit.simulation is not None
        failed = replace(fit, simulation=replace(fit.simulation, failed={"identified": "no"}, errors={}))
        changed = replace(found, first=failed) if fit is found.first else replace(found, last=failed)
        page = page_of(changed)
        complete(page)
        assert ("<h2>Simulation</h2>" in page.html) == shown


def test_clean_data(leg: tuple[Fit, Fit]) -> None:
    page = page_of(diagnosis_of(leg[0], leg[0]))
    complete(page)
    assert "Model and data agree" in page.plain
    assert page.plain.count("nothing was added") == 1
    assert "The steps" not in page.text
    assert page.figures_of(GAP) == []
    assert len(page_of(diagnosis_of(*leg, step_of())).figures_of(GAP)) == 4


def test_the_worst_joint_is_the_one_that_is_open(found: Diagnosis) -> None:
    html = page_of(found).html
    where = html.index("Residual by state, time and frequency")
    assert html.index("<details open>", where) < html.index("<summary>hip</summary>", where)
    assert html.index("<details open>", where) > html.index("<summary>abad</summary>", where)


@pytest.mark.parametrize(
    ("values", "errors", "text"),
    [
        ({"com": [0.01, 0.2]}, {"com": [0.001, None]}, "com [0.0100 ± 0.0010, 0.200] m"),
        ({"windows": [[1.0, 2.0], [3.0, 4.0]]}, {}, "windows [[1.00, 2.00], [3.00, 4.00]] m"),
        ({"source": "knee"}, {"source": None}, "source knee"),
        ({"gain": None}, {}, "gain –"),
        ({"inertia": [7.17e-4, 0.0, 4.3e-19]}, {}, "inertia [0.000717, 0, 0] m"),
    ],
)
def test_parameters_in_words(values: dict[str, Any], errors: dict[str, Any], text: str) -> None:
    units = {name: "m" if isinstance(value, list) else None for name, value in values.items()}
    assert parameter_texts(partial(StepReport, {"parameters": values, "standard_error": errors, "units": units})) == [
        text
    ]


def test_what_to_do_next_stands_beside_the_verdict(found: Diagnosis) -> None:
    page = page_of(faulty(found))
    verdict, next_steps, steps = (page.plain.index(text) for text in ("Effects.", "What to do", "The steps"))
    assert verdict < next_steps < page.plain.index("The residual that it explains") < steps
    assert page.plain.count("What to do next") == 1


def test_commands_are_code_and_the_maps_are_linked(found: Diagnosis) -> None:
    step = step_of(distinguishing_experiment="or design the motion: `idtool excite a.urdf`", pair=True)
    advice = replace(NOTICE, message="not in `SI`", advice="set its `log.scale` to 1 < 2")
    html = page_of(replace(found, steps=(step, unknown_of(found.after)), notices=(advice,))).html
    assert html.count("<code>idtool excite a.urdf</code>") == 2  # what to do next, and at the step
    assert "not in <code>SI</code>" in html
    assert "set its <code>log.scale</code> to 1 &lt; 2" in html
    assert "`" not in html[: html.index("<script")]
    assert '<a href="#residuals">the residual maps below</a>' in html
    assert html.count('id="residuals"') == 1
    assert "diagnosis.html" not in html[: html.index("Origin of this report")]


def test_the_legend_has_a_noise_floor_only_if_it_is_known(found: Diagnosis) -> None:
    assert '<span class="c0 dot">noise floor</span>' in page_of(found).html
    assert '<span class="c0 dot">noise floor</span>' not in page_of(replace(found, is_floor_known=False)).html


def test_the_maps_say_which_samples_they_leave_out(found: Diagnosis) -> None:
    assert "where the direction of friction is not known, at rest and near reversals" in page_of(found).plain


def test_a_title_and_its_sentence_name_the_joint_once(found: Diagnosis) -> None:
    page = page_of(replace(found, steps=(step_of(), unknown_of(found.after))))
    assert "Stribeck friction on hip. Friction rises below 0.15 rad/s." in page.plain
    assert "Unknown effect on knee. Something structured is left." in page.plain


def test_a_step_is_one_picture(found: Diagnosis) -> None:
    first, _ = found.steps
    page = page_of(replace(found, steps=(first, unknown_of(first.after))))
    (picture,) = page.figures_of("Residual torque of ")
    axis = "velocity [rad/s]"
    assert picture.label == f"Residual torque of hip against {axis}, before and after adding Stribeck friction on hip"
    assert picture.titles == ["residual [N·m]", axis]
    assert picture.names == ["before", "after", "Stribeck friction alone"]
    assert picture.y("before") == [0.1, -0.9, 0.9, -0.1]
    assert picture.y("after") == [0.0, 0.01, -0.01, 0.0]
    assert picture.y("Stribeck friction alone") == [0.0, -1.2, 1.2, 0.0]
    below, above = picture.data[:2]
    assert below["y"] == pytest.approx([0.0, -1.2, 0.6, -0.2])
    assert above["y"] == pytest.approx([0.2, -0.6, 1.2, 0.0])


@pytest.mark.parametrize(
    ("changes", "titles", "names"),
    [
        (
            {"cause": "distance_since_reversal", "in_direction_of_motion": True},
            ["residual along the motion [N·m]", "distance since the last reversal [rad]"],
            ["before", "after", "Stribeck friction alone"],
        ),
        (
            {"cause": "torque", "cause_joint": "knee", "effect_torque": None},
            ["residual [N·m]", "torque of knee [N·m]"],
            ["before", "after"],
        ),
        (
            {"cause": "position", "period": 0.2},
            ["residual [N·m]", "position within one period [rad]"],
            ["before", "after", "Stribeck friction alone"],
        ),
    ],
)
def test_the_picture_says_what_the_torque_is_drawn_against(
    found: Diagnosis, changes: dict[str, Any], titles: list[str], names: list[str]
) -> None:
    (picture,) = page_of(
        replace(found, steps=(replace(found.steps[0], profile=replace(PROFILE, **changes)),))
    ).figures_of("Residual torque of ")
    assert (picture.titles, picture.names) == (titles, names)
    assert (picture.layout["xaxis"].get("type") == "log") == (changes["cause"] == "distance_since_reversal")


def test_rejected_candidates_are_folded_and_grouped(found: Diagnosis) -> None:
    weak = [candidate("backlash", joint, score, "too weak") for joint, score in (("abad", 0.1), ("knee", 0.2))]
    step = step_of(rejected=(*weak, candidate("end_stop", reason="too weak")), alternatives=(candidate("viscous"),))
    page = page_of(replace(found, steps=(step,)))
    assert "4 rejected candidates" in page.plain
    fold = page.html.index("<summary>4 rejected")
    assert page.html.rindex("<details", 0, fold) == page.html.rindex("<details>", 0, fold)  # closed
    first = page.rows.index(["effect", "on", "residual explained", "parameters", "reason for rejection"]) + 1
    assert [row[:3] for row in page.rows[first : first + 3]] == [
        ["viscous", "hip", "40.0 ± 3.0 %"],
        ["end stop", "hip", "40.0 ± 3.0 %"],
        ["backlash", "knee, abad", "20.0 ± 3.0 %"],
    ]
    assert page.rows[first][-1].startswith("the chosen effect explains more")


def test_a_long_log_of_a_large_robot_stays_small(found: Diagnosis, rng: np.random.Generator) -> None:
    """Twelve joints, eight steps and some hundred candidates each."""
    joints = [f"joint number {j}" for j in range(12)]
    units = dict.fromkeys(joints, "N·m")
    report = diagnosis_report(found, "refit").to_json()
    for key in ("noise_floor", "gap_closed", "friction", "friction_intervals"):
        report[key] = dict.fromkeys([*joints, "overall"], next(iter(report[key].values())))
    rms = dict.fromkeys([*joints, "overall"], 0.5)
    report["before"] = report["after"] = dict.fromkeys(("train", "validation", "simulation"), rms)
    other = diagnosis_report(
        replace(found, steps=(step_of(rejected=tuple(candidate("backlash", reason=f"{i:080}") for i in range(200))),)),
        "refit",
    )
    step = {**other.steps[0].model_dump(mode="json"), "validation_rms_before": rms, "validation_rms_after": rms}
    step["evidence"] = {**step["evidence"], "simulation_before": rms, "simulation_after": rms}
    step["profile"] = {**step["profile"], "joint": joints[0], "cause_joint": joints[0]}
    body = next(iter(report["bodies"].values()))
    report |= {"joints": joints, "units": units, "steps": [step] * 8, "bodies": {f"body {i}": body for i in range(30)}}
    curves = {name: rng.normal(size=(12, 4000)) for name in ("measured", "identified")}
    fit = SimpleNamespace(
        evaluation=evaluation_of(curves, logs=6), simulation=rollouts_of(curves), experiment=experiment_of(units)
    )
    many = residual(1 / 3, points=500, lines=50_000)
    maps = dict.fromkeys(joints, replace(many, mean={name: rng.normal(size=500) for name in many.mean}))
    large: Any = replace(found, first=fit, last=fit, maps_before=maps, maps_after=maps)  # type: ignore[arg-type]
    page = Page(diagnosis_page(large, partial(DiagnosisReport, report), "idtool diagnose"))
    complete(page)
    for joint in joints:
        assert len(page.figures_of(f"Residual of {joint} against")) == 6
    assert "171 more are listed in diagnosis.json" in page.text  # of 201


def test_what_is_left_is_said_even_where_nothing_was_found(leg: tuple[Fit, Fit]) -> None:
    before = level(0.2, 0.6, 1.4)
    page = page_of(diagnosis_of(*leg, unknown_of(before), verdict="unexplained"))
    complete(page)
    assert page.levels[:1] == ["bad"]
    assert "no known effect explains the difference on knee: the held-out" in page.plain
    assert "near the upper end of its travel" in page.plain
