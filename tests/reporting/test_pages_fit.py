"""report.html: well-formed, complete in itself, safe from the names in it, and true to the results."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from pages import BODY, SCRIPT, SLIDE, Page, complete, notice_of, with_shapes
from records import partial
from robots import inertial, link

from idtool.common.number_text import number, with_error
from idtool.data.logs import make_log, write_log
from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.fit import Fit, fit
from idtool.reporting.fit_report import fit_report
from idtool.reporting.pages.fit import fit_page
from idtool.reporting.results.fit import FitReport
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

TORQUE, POSITION = "Measured and predicted torque", "Measured and simulated position"


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """A revolute and a prismatic joint and a log with a gap, names and paths as a stranger may choose them."""
    folder = tmp_path_factory.mktemp("logs") / SCRIPT.partition("/")[0]
    folder.mkdir()
    rng = np.random.default_rng(3)
    joints = link(1).replace('"j1"', quoteattr(SCRIPT)) + link(2, kind="prismatic").replace('"j2"', quoteattr(SLIDE))
    names = f"<link name='l0'/><link name='l1'>{inertial(rng)}</link><link name='l2'>{inertial(rng)}</link>"
    urdf = f"<robot name='r'>{names}{joints}</robot>".replace('"l1"', quoteattr(BODY)).replace("'l1'", quoteattr(BODY))
    (folder / "robot.urdf").write_text(urdf)
    t = np.arange(6000) / 1000
    q = np.stack([np.sin(5 * t) + 0.3 * np.sin(17 * t), 0.2 * np.sin(7 * t + 1)], axis=1)
    v = np.gradient(q, t, axis=0)
    signals = {"q": q, "v": v, "tau": 2 * np.sin(q) + 0.5 * np.sign(v) + rng.normal(scale=0.05, size=q.shape)}
    keep = (t < 5.0) | (t > 5.3)
    path = folder / SCRIPT.partition("/")[2]
    log = make_log(path, t[keep], (SCRIPT, SLIDE), {name: x[keep] for name, x in signals.items()})
    write_log(path.with_suffix(".csv"), log)
    experiment = prepare(
        read_robot(folder / "robot.urdf"),
        parse_config({"friction": {SLIDE: {"coulomb": False}}}, "c.yaml"),
        [path.with_suffix(".csv")],
    )
    return fit(experiment, lambda stage, share: None, simulate=True, analyze_uncertainty=True)


@pytest.fixture
def report(fitted: Fit) -> dict[str, Any]:
    """The content of report.json, to be changed at will."""
    return with_shapes(fit_report(fitted).to_json())


def test_the_fit_page_is_complete_in_itself(fitted: Fit, report: dict[str, Any]) -> None:
    complete(Page(fit_page(fitted, partial(FitReport, report), "idtool fit")))


def test_the_plots_offer_no_upload(fitted: Fit, report: dict[str, Any]) -> None:
    drawing = Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).scripts[-1]
    assert "showSendToCloud: false" in drawing
    assert 'plotlyServerURL: ""' in drawing


def test_names_and_paths_stay_text(fitted: Fit, report: dict[str, Any]) -> None:
    report["notices"] = [notice_of(SCRIPT), notice_of("a\udcff", SCRIPT)]
    report["bodies"]["l2"]["lumped"] = [SCRIPT]
    page = Page(fit_page(fitted, partial(FitReport, report), f"idtool fit {SCRIPT} --out \udcff"))
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert "<" not in page.scripts[1]
    assert {SCRIPT, SLIDE, BODY} < {row[0].strip() for row in page.rows}
    assert {
        f"Measured and {what} of {name} over time"
        for name in (SCRIPT, SLIDE)
        for what in ("predicted torque and residual", "simulated position")
    } == {figure.label for figure in page.figures_of("Measured and")}
    bodies = [attrs["aria-label"] or "" for _, attrs in page.tags if "data-body" in attrs]
    assert [label.partition(" in its frame")[0] for label in bodies] == [f"Body {BODY}", "Body l2"]
    for text in (f"idtool fit {SCRIPT} --out ?", "a?", f"with {SCRIPT}", f"{SCRIPT}.csv"):
        assert text in page.text
    page.html.encode()


def test_the_fit_page_draws_the_held_out_data(fitted: Fit, report: dict[str, Any]) -> None:
    torques = Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).figures_of(TORQUE)
    (trace,) = fitted.validation.traces
    drawn = np.array([figure.y("predicted") for figure in torques], dtype=float)
    pairs = (np.sort(x.reshape(2, -1, 2)) for x in (drawn, trace.curves["identified"]))
    np.testing.assert_allclose(*pairs, atol=1e-3)
    for torque in torques:
        np.testing.assert_allclose(np.array(torque.x, dtype=float), trace.t, atol=1e-5)
    assert np.isnan(drawn).any()  # the gap
    report["rms"]["validation"] = report["rms"]["prior_validation"] = None
    nothing = {name: replace(errors, samples=0) for name, errors in fitted.validation.errors.items()}
    all_fitted = replace(fitted, validation=replace(fitted.validation, errors=nothing))
    page = Page(fit_page(all_fitted, partial(FitReport, report), "idtool fit"))
    assert page.figures_of(TORQUE)[0].data[0]["x"][0] < 0.5
    assert "no data were held out" in page.text


def test_tables_hold_the_reports_figures(fitted: Fit, report: dict[str, Any]) -> None:
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    errors = page.table("held out")
    for name in (SCRIPT, SLIDE, "overall"):
        assert errors[name]["held out, as logged"] == number(report["rms_raw"]["validation"][name])
        assert errors[name]["train"] == number(report["rms"]["train"][name])
    friction = page.table("viscous")
    assert friction[SLIDE]["units"] == "N·s/m, N"
    assert friction[SLIDE]["viscous"] == with_error(*pair(report, SLIDE, "viscous"))[0]
    assert friction[SLIDE]["Coulomb"] == "–"
    assert friction[SCRIPT]["units"] == "N·m·s/rad, N·m"
    assert friction[SCRIPT]["viscous"] == with_error(*pair(report, SCRIPT, "viscous"))[0]
    bodies = page.table("prior [kg]")
    assert list(bodies) == list(report["bodies"])
    last = report["bodies"]["l2"]
    assert bodies["l2"]["mass [kg]"] == with_error(last["mass"], last["standard_error"][0])[0]
    assert bodies["l2"]["realizable"] == "yes"


def pair(report: dict[str, Any], joint: str, term: str) -> tuple[float, float]:
    found = report["friction"][joint]
    return found[term], found["standard_error"][term]


def test_units_are_those_of_the_joints(fitted: Fit, report: dict[str, Any]) -> None:
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    assert [figure.titles[0] for figure in page.figures_of(TORQUE)] == ["torque [N·m]", "torque [N]"]
    for head, units in (("held out", ("N·m", "N")), ("model", ("rad", "m"))):
        names = (SCRIPT, SLIDE, "overall")
        wanted = dict(zip(names, (*units, f"mixed {units[0]} and {units[1]}"), strict=True))
        assert {name: page.table(head)[name]["unit"] for name in names} == wanted
    assert [figure.titles[0] for figure in page.figures_of(POSITION)] == ["angle [rad]", "position [m]"]


def test_a_model_no_better_than_the_prior_is_called_so(fitted: Fit, report: dict[str, Any]) -> None:
    report["rms"]["validation"]["overall"] = 2 * report["rms"]["prior_validation"]["overall"]
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    assert "no better. Do not use" in " ".join(page.text.split())
    assert page.levels[0] == "bad"


def test_a_joint_no_better_than_the_prior_is_named(fitted: Fit, report: dict[str, Any]) -> None:
    for part, values in (("validation", (3.0, 0.1, 2.0)), ("prior_validation", (2.0, 9.0, 6.0)), ("train", (0.5,) * 3)):
        report["rms"][part] = dict(zip((SCRIPT, SLIDE, "overall"), values, strict=True))
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    text = " ".join(page.text.split())
    assert f"The model is no better than the prior for {SCRIPT}." in text
    assert "3.0 times as large" in text
    assert "longer or more varied logs" in text
    assert page.levels[0] == "note"


def test_an_unrealizable_body_is_named(fitted: Fit, report: dict[str, Any]) -> None:
    report["bodies"][BODY]["realizable"] = False
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    assert f"1 of 2 bodies is not realizable: {BODY}." in page.text
    assert "bad" in page.levels
    assert page.table("prior [kg]")[BODY]["realizable"] == "NO"


def test_what_the_data_determine_is_counted(fitted: Fit, report: dict[str, Any]) -> None:
    """The combinations that the torque depends on, or without them the parameters."""
    base = report["base_parameters"]
    count = "all" if base["determined"] == base["structural"] else f"{base['determined']} of the"
    text = Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).plain
    combinations = f"the combinations of the {base['of']} parameters on which the torque depends"
    assert f"The logs determine {count} {base['structural']} base parameters, {combinations}." in text
    without = replace(fitted, uncertainty_analysis=replace(fitted.uncertainty_analysis, identifiability=None))
    known = fitted.uncertainty.identifiable
    text = Page(fit_page(without, fit_report(without), "idtool fit")).text
    assert f"determine {known.sum()} of {len(known)} parameters" in text


def test_a_warning_comes_with_what_to_do(fitted: Fit, report: dict[str, Any]) -> None:
    report["notices"] = [
        notice_of("joints assumed to stand still: tail at 0", "set their positions under locked_joints")
    ]
    text = Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).text
    assert "joints assumed to stand still: tail at 0" in text
    assert "set their positions under locked_joints" in text


def test_what_is_known_otherwise_is_beside_what_was_identified(fitted: Fit, report: dict[str, Any]) -> None:
    soft = {"what": SCRIPT, "value": 0.634, "standard_error": 0.005, "identified": 0.6312}
    report["known"] = [soft, {"what": "total mass", "value": 2.31, "standard_error": None, "identified": 2.31}]
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    assert [SCRIPT, "0.6340", "0.0050", "0.6312"] in page.rows
    assert ["total mass", "2.310", "exact", "2.310"] in page.rows
    report["known"] = []
    assert "Known values" not in Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).text


def test_the_regularization_is_named(fitted: Fit, report: dict[str, Any]) -> None:
    report["regularization"] = {"kind": "entropic", "weight": 1e-6, "units": "relative", "automatic": None}
    assert (
        "entropic, weight 1.0e-06, relative units"
        in Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).text
    )


def test_the_page_tells_what_its_numbers_rest_on(fitted: Fit, report: dict[str, Any]) -> None:
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit"))
    base = report["base_parameters"]
    assert f"determine {base['determined']} of the {base['structural']}." in page.plain
    words = ("mass", "m·c_x", "I_yy")
    rows = [row for row in page.rows if len(row) == 5 and row[0] in words]
    texts = [basis["text"] for body in report["bodies"].values() for basis in body["rests_on"]]
    assert len(rows) >= 2
    assert all(any(text.endswith(f" {row[0]}: {row[4]}") for text in texts) for row in rows)
    assert any(row[0].startswith("Prior only, with 1 % range: m·c_x ") for row in page.rows)


def test_a_quick_fit_has_no_such_sections(fitted: Fit, report: dict[str, Any]) -> None:
    asked = "Base parameters", "Source of each parameter"
    assert all(heading in Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).text for heading in asked)
    report["base_parameters"] = None
    for body in report["bodies"].values():
        body["rests_on"] = None
    page = Page(fit_page(fitted, partial(FitReport, report), "idtool fit --quick"))
    complete(page)
    assert not any(heading in page.text for heading in asked)


def test_a_mass_that_is_determined_has_its_interval(fitted: Fit, report: dict[str, Any]) -> None:
    report["bodies"]["l2"]["standard_error"][0], report["bodies"]["l2"]["interval"][0] = 0.021, [0.456, 0.544]
    bodies = Page(fit_page(fitted, partial(FitReport, report), "idtool fit")).table("prior [kg]")
    assert (bodies["l2"]["± se"], bodies["l2"]["95 % interval"]) == ("0.021", "0.456 to 0.544")
