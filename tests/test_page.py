"""The pages: well-formed, complete in themselves, safe from the names in them, and true to the results."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import jinja2
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import inertial, link

import idtool
from idtool.config import parse_config
from idtool.experiment import prepare
from idtool.fit import Fit, fit
from idtool.logs import make_log, write_log
from idtool.pages import by_unit, fit_page, merged, metres, number, percent, rounded, validation_page, with_error
from idtool.report import fit_report, validation_report
from idtool.robot import read_robot
from idtool.validate import Errors, Evaluation, Trace

Array = NDArray[np.float64]

SCRIPT = "<script>alert(1)</script>"
SLIDE = "slide'\"&<!--{{ 7 * 7 }}"
BODY = "<img src=x onerror=alert(2)>"
VOID = {"meta", "br", "input"}


@dataclass
class Page(HTMLParser):
    """A page taken apart; every tag must be closed by its own."""

    html: str
    open: list[str] = field(default_factory=list)
    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    scripts: list[str] = field(default_factory=list)
    styles: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    text: str = ""

    def __post_init__(self) -> None:
        super().__init__()
        assert self.html.startswith("<!DOCTYPE html>")
        self.feed(self.html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({name for name, _ in attrs}) == len(attrs)
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("th", "td"):
            self.rows[-1].append("")
        elif tag == "script":
            self.scripts.append("")
        elif tag == "style":
            self.styles.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside in ("script", "style"):
            texts = self.scripts if inside == "script" else self.styles
            texts[-1] += data
            return
        self.text += data
        if {"th", "td"} & set(self.open):
            self.rows[-1][-1] += data

    @property
    def curves(self) -> dict[str, Any]:
        """What the plots are drawn from."""
        (found,) = [i for i, (tag, attrs) in enumerate(t for t in self.tags if t[0] == "script") if "id" in attrs]
        loaded: dict[str, Any] = json.loads(self.scripts[found])
        return loaded

    def table(self, head: str) -> dict[str, dict[str, str]]:
        """Rows by name of the tables whose heading has a cell; cells by heading."""
        found: dict[str, dict[str, str]] = {}
        heads: list[str] = []
        for row in self.rows:
            if row[0] in ("joint", "body"):
                heads = row
            elif head in heads and len(row) == len(heads):
                found[row[0]] = dict(zip(heads, row, strict=True))
        return found


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
    return fit(experiment, lambda stage, share: None)


@pytest.fixture
def report(fitted: Fit) -> dict[str, Any]:
    """The content of report.json, to be changed at will."""
    return copy.deepcopy(fit_report(fitted))


def evaluation_of(curves: dict[str, Array], logs: int = 1, start: float = 0.0) -> Evaluation:
    """Made-up errors, and traces of the given curves."""
    curves = {**curves, "residual": curves["measured"] - list(curves.values())[1]}
    nv, points = curves["measured"].shape
    t = start + np.repeat(np.arange(points // 2) + 0.5, 2) * 0.01
    errors = {
        name: Errors(10, np.full(nv, 0.6 + i), np.full(nv, 3.6 + i))
        for i, name in enumerate(curves)
        if i and name != "residual"
    }
    spread = {f"j{j}": 2.0 for j in range(nv)}
    return Evaluation(errors, spread, tuple(Trace(f"log {i}", t, curves) for i in range(logs)))


def validated(evaluation: Evaluation, **extra: Any) -> Page:
    """The page of a validation, its bounds met by the first joint and not by the whole."""
    units = dict.fromkeys(evaluation.spread, "N·m")
    contents = validation_report(evaluation, units, 40.0, {next(iter(units)): 0.5, "overall": 0.3})
    return Page(validation_page(evaluation, contents | extra, "idtool validate x"))


@pytest.fixture
def noisy(rng: np.random.Generator) -> dict[str, Array]:
    """Curves of a model and a prior for three joints, with a gap."""
    measured, model, prior = rng.normal(scale=[[30.0], [1.0], [1e-4]], size=(3, 3, 400))
    measured[:, 100:140] = model[:, 100:140] = prior[:, 100:140] = np.nan
    return {"measured": measured, "model": model, "prior": prior}


def test_the_fit_page_is_complete_in_itself(fitted: Fit, report: dict[str, Any]) -> None:
    complete(Page(fit_page(fitted, report, "idtool fit")))


def test_the_validation_page_is_complete_in_itself(noisy: dict[str, Array]) -> None:
    complete(validated(evaluation_of(noisy)))


def complete(page: Page) -> None:
    for tag, attrs in page.tags:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base", "form")
        assert not {"src", "href", "srcset", "data", "action"} & set(attrs)
        assert not any(name.startswith("on") for name in attrs)
    (style,) = page.styles
    assert "url(" not in style
    assert "@import" not in style
    (policy,) = [attrs["content"] for _, attrs in page.tags if attrs.get("http-equiv") == "Content-Security-Policy"]
    assert policy
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy
    assert "Plotly" in page.scripts[0]


def test_the_plots_offer_no_upload(fitted: Fit, report: dict[str, Any]) -> None:
    drawing = Page(fit_page(fitted, report, "idtool fit")).scripts[-1]
    assert "showSendToCloud: false" in drawing
    assert 'plotlyServerURL: ""' in drawing


def test_names_and_paths_stay_text(fitted: Fit, report: dict[str, Any]) -> None:
    report["warnings"] += [SCRIPT, "a\udcff"]
    report["bodies"]["l2"]["lumped"] = [SCRIPT]
    page = Page(fit_page(fitted, report, f"idtool fit {SCRIPT} --out \udcff"))
    assert [tag for tag, _ in page.tags if tag in ("script", "img")] == ["script"] * 3
    assert "<" not in page.scripts[1]
    assert {SCRIPT, SLIDE, BODY} < {row[0].strip() for row in page.rows}
    assert {f"Measured and predicted torque and residual of {name} over time" for name in (SCRIPT, SLIDE)} == {
        attrs["aria-label"] for _, attrs in page.tags if "aria-label" in attrs
    }
    for text in (f"idtool fit {SCRIPT} --out ?", "a?", f"with {SCRIPT}", f"{SCRIPT}.csv"):
        assert text in page.text
    assert [joint["name"] for joint in page.curves["logs"][0]["joints"]] == [SCRIPT, SLIDE]
    page.html.encode()


@pytest.mark.parametrize("logs", [1, 20])
def test_pages_of_large_robots_stay_small(rng: np.random.Generator, logs: int) -> None:
    curves = {name: rng.normal(scale=30, size=(12, 4000)) for name in ("measured", "model", "prior")}
    page = validated(evaluation_of(curves, logs, 1.6e9))
    assert len(page.html.encode()) < 6e6
    assert len(page.curves["logs"]) + page.curves["omitted"] == logs
    assert (f"{page.curves['omitted']} more logs" in page.text) == (logs > 1)


def test_curves_match_the_evaluation(noisy: dict[str, Array]) -> None:
    (log,) = validated(evaluation_of(noisy)).curves["logs"]
    assert log["t"] == (np.repeat(np.arange(200) + 0.5, 2) * 0.01).round(5).tolist()
    wanted = {"measured": noisy["measured"], "predicted": noisy["model"], "prior": noisy["prior"]}
    residual = (noisy["measured"] - noisy["model"]).reshape(3, -1, 2)
    wanted["residual"] = np.sort(residual, axis=-1)
    for j, joint in enumerate(log["joints"]):
        for name, x in wanted.items():
            drawn = np.array(joint[name], dtype=float)
            pairs = np.sort(x.reshape(3, -1, 2)[j], axis=-1).ravel()
            np.testing.assert_allclose(drawn, pairs, atol=1e-4 * np.nanmax(np.abs(pairs)))


def test_the_fit_page_draws_the_held_out_data(fitted: Fit, report: dict[str, Any]) -> None:
    (log,) = Page(fit_page(fitted, report, "idtool fit")).curves["logs"]
    (trace,) = fitted.validation.traces
    drawn = np.array([joint["predicted"] for joint in log["joints"]], dtype=float)
    np.testing.assert_allclose(drawn, trace.curves["identified"], atol=1e-3)
    np.testing.assert_allclose(log["t"], trace.t, atol=1e-5)
    assert np.isnan(drawn).any()  # the gap
    report["rms"]["validation"] = report["rms"]["prior_validation"] = None
    page = Page(fit_page(fitted, report, "idtool fit"))
    assert page.curves["logs"][0]["t"][0] < 0.5
    assert "nothing was held out" in page.text


def test_late_stamps_keep_their_digits(noisy: dict[str, Array]) -> None:
    (log,) = validated(evaluation_of(noisy, start=1.6e9)).curves["logs"]
    assert log["start"] == 1_600_000_000
    np.testing.assert_allclose(np.diff(log["t"][::2]), 0.01, atol=2e-5)


def test_merging_loses_no_extreme(rng: np.random.Generator) -> None:
    x = rng.normal(size=(2, 50))
    x[0, :20] = np.nan
    coarse = merged(x, 4)
    assert coarse.shape == (2, 14)
    assert np.isnan(coarse[0, :4]).all()
    assert not np.isnan(coarse[:, 4:]).any()
    for row, full in zip(coarse, x, strict=True):
        assert (np.nanmin(row), np.nanmax(row)) == (np.nanmin(full), np.nanmax(full))
    assert merged(x[1:], 1).tolist() == np.sort(x[1:].reshape(-1, 2)).reshape(1, -1).tolist()


def test_rounding_keeps_five_digits_of_the_largest() -> None:
    assert rounded(np.array([12.345678, -0.001234, np.nan])) == [12.346, -0.001, None]
    assert rounded(np.array([np.nan])) == [None]
    assert rounded(np.array([0.0, 1e-300])) == [0.0, 0.0]
    assert rounded(np.array([123456789.0])) == [123460000.0]


def test_tables_hold_the_reports_figures(fitted: Fit, report: dict[str, Any]) -> None:
    page = Page(fit_page(fitted, report, "idtool fit"))
    raw = page.table("held out")  # the last of equal headings: as logged
    for name in (SCRIPT, SLIDE, "overall"):
        assert raw[name]["held out"] == number(report["rms_raw"]["validation"][name])
        assert number(report["rms"]["train"][name]) in next(row for row in page.rows if row[0] == name)
    friction = page.table("viscous [N·m·s/rad]")[SCRIPT] | page.table("viscous [N·s/m]")[SLIDE]
    assert friction["viscous [N·s/m]"] == with_error(*pair(report, SLIDE, "viscous"))[0]
    assert friction["Coulomb [N]"] == "–"
    assert friction["viscous [N·m·s/rad]"] == with_error(*pair(report, SCRIPT, "viscous"))[0]
    bodies = page.table("prior mass [kg]")
    assert list(bodies) == list(report["bodies"])
    last = report["bodies"]["l2"]
    assert bodies["l2"]["mass [kg]"] == with_error(last["mass"], last["standard_error"][0])[0]
    assert bodies["l2"]["realizable"] == "yes"


def pair(report: dict[str, Any], joint: str, term: str) -> tuple[float, float]:
    found = report["friction"][joint]
    return found[term], found["standard_error"][term]


def test_units_are_those_of_the_joints(fitted: Fit, report: dict[str, Any], noisy: dict[str, Array]) -> None:
    page = Page(fit_page(fitted, report, "idtool fit"))
    assert [joint["unit"] for joint in page.curves["logs"][0]["joints"]] == ["N·m", "N"]
    heads = [row[1] for row in page.rows if len(row) == 3 and "in the band" in row[1]]
    assert [head.partition("[")[2] for head in heads] == ["N·m]", "N]", "N·m and N together]"]
    evaluation = evaluation_of(noisy)
    mixed = validated(evaluation, units={"j0": "N·m", "j1": "N", "j2": "N·m"})
    assert [joint["unit"] for joint in mixed.curves["logs"][0]["joints"]] == ["N·m", "N", "N·m"]
    assert "N·m and N together" in mixed.text
    assert "N·m and N together" not in validated(evaluation).text


def test_a_model_no_better_than_the_prior_is_called_so(fitted: Fit, report: dict[str, Any]) -> None:
    report["rms"]["validation"]["overall"] = 2 * report["rms"]["prior_validation"]["overall"]
    page = Page(fit_page(fitted, report, "idtool fit"))
    assert "no better. Do not use" in " ".join(page.text.split())
    assert levels(page)[0] == "bad"


def test_a_joint_no_better_than_the_prior_is_named(fitted: Fit, report: dict[str, Any]) -> None:
    for part, values in (("validation", (3.0, 0.1, 2.0)), ("prior_validation", (2.0, 9.0, 6.0)), ("train", (0.5,) * 3)):
        report["rms"][part] = dict(zip((SCRIPT, SLIDE, "overall"), values, strict=True))
    page = Page(fit_page(fitted, report, "idtool fit"))
    text = " ".join(page.text.split())
    assert f"No better than the prior: {SCRIPT}." in text
    assert "3.0 times as large" in text
    assert "longer or more varied logs" in text
    assert levels(page)[0] == "note"


def test_an_unrealizable_body_is_named(fitted: Fit, report: dict[str, Any]) -> None:
    report["bodies"][BODY]["realizable"] = False
    page = Page(fit_page(fitted, report, "idtool fit"))
    assert f"1 of 2 bodies are not: {BODY}." in page.text
    assert levels(page)[1] == "bad"
    assert page.table("prior mass [kg]")[BODY]["realizable"] == "NO"


def test_what_the_data_determine_is_counted(fitted: Fit, report: dict[str, Any]) -> None:
    known = fitted.uncertainty.identifiable
    text = Page(fit_page(fitted, report, "idtool fit")).text
    assert f"determine {known.sum()} of {len(known)} parameters" in text
    certain = replace(fitted, uncertainty=replace(fitted.uncertainty, identifiable=np.ones_like(known)))
    assert f"determine all {len(known)} parameters" in Page(fit_page(certain, report, "idtool fit")).text


def test_bounds_pass_or_fail(noisy: dict[str, Array]) -> None:
    page = validated(evaluation_of(noisy))
    results = {name: (row["bound"], row["result"]) for name, row in page.table("bound").items()}
    assert results == {"j0": ("0.500", "pass"), "j1": ("–", ""), "j2": ("–", ""), "overall": ("0.300", "FAIL")}
    assert "Not met: overall." in page.text
    assert levels(page) == ["good", "bad"]


def test_a_validation_without_prior_or_bounds(noisy: dict[str, Array]) -> None:
    evaluation = evaluation_of({name: noisy[name] for name in ("measured", "model")})
    units = dict.fromkeys(evaluation.spread, "N·m")
    page = Page(validation_page(evaluation, validation_report(evaluation, units, 40.0, {}), "idtool validate x"))
    assert "prior" not in page.text
    assert "bound" not in page.text
    assert "prior" not in page.curves["logs"][0]["joints"][0]
    assert levels(page) == ["good"]


def levels(page: Page) -> list[str | None]:
    return [attrs["class"] for tag, attrs in page.tags if tag == "li" and "class" in attrs]


def test_advice_is_on_warnings_that_exist() -> None:
    package = Path(idtool.__file__).parent
    sources = "".join(path.read_text() for path in package.rglob("*.py"))
    environment = jinja2.Environment(loader=jinja2.PackageLoader("idtool"), autoescape=True)
    advice: dict[str, str] = environment.get_template("advice.html").module.advice  # type: ignore[attr-defined]
    assert [phrase for phrase in advice if phrase not in sources] == []


def test_a_warning_comes_with_what_to_do(fitted: Fit, report: dict[str, Any]) -> None:
    report["warnings"] = ["joints held still: tail at 0"]
    text = Page(fit_page(fitted, report, "idtool fit")).text
    assert "joints held still: tail at 0" in text
    assert "say where under locked_joints" in text


@pytest.mark.parametrize(
    ("x", "digits", "text"),
    [(0.108512, 3, "0.109"), (13.0461, 4, "13.05"), (12345.6, 3, "12346"), (1.2345e-7, 3, "1.23e-07"), (0.0, 3, "0.00"),
     (-2e7, 2, "-2.0e+07"), (None, 3, "–"), (math.nan, 3, "–")],
)  # fmt: skip
def test_figures_have_sensible_digits(x: float | None, digits: int, text: str) -> None:
    assert number(x, digits) == text


@pytest.mark.parametrize(
    ("x", "error", "text"),
    [(3.10606, 0.0067001, ("3.1061", "0.0067")), (1234.5, 21.0, ("1234", "21")), (None, None, ("–", "")),
     (0.5217, None, ("0.5217", "not determined")), (0.5, 0.0, ("0.5000", "0.0"))],
)  # fmt: skip
def test_figures_have_the_digits_of_their_error(x: float | None, error: float | None, text: tuple[str, str]) -> None:
    assert with_error(x, error) == text


def test_lengths_and_shares() -> None:
    assert [metres(x) for x in (-1e-9, 0.12346, 1e6)] == ["0.0000", "0.1235", "1.00e+06"]
    assert [percent(x) for x in (0.0213, None)] == ["2.1 %", "–"]


def test_joints_of_one_kind_share_a_table() -> None:
    assert by_unit({"a": "N·m", "b": "N·m"}) == [("N·m", ["a", "b", "overall"])]
    assert [names for _, names in by_unit({"a": "N·m", "b": "N", "c": "N·m"})] == [["a", "c"], ["b"], ["overall"]]
