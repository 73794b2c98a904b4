"""What the tests of the pages share: a page taken apart, and contents of the JSON files that pages are made of."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.estimation.dataset.envelope import Trace
from idtool.estimation.evaluation.torque_errors import Errors, Evaluation
from idtool.robot.inertia import from_mass_com_inertia

Array = NDArray[np.float64]

SCRIPT = "<script>alert(1)</script>"
SLIDE = "slide'\"&<!--{{ 7 * 7 }}"
BODY = "<img src=x onerror=alert(2)>"
VOID = {"meta", "br", "input"}


@dataclass(frozen=True)
class DrawnFigure:
    """A figure as a page holds it: its description, traces and layout."""

    label: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]

    @property
    def names(self) -> list[str]:
        """Names of the curves."""
        return [trace["name"] for trace in self.data if "name" in trace]

    def y(self, name: str) -> list[float | None]:
        """Values of a curve."""
        (values,) = [trace["y"] for trace in self.data if trace.get("name") == name]
        return list(values)

    @property
    def x(self) -> list[float | None]:
        """Values that all curves have."""
        first = self.data[0]["x"]
        assert all(trace["x"] == first for trace in self.data)
        return list(first)

    @property
    def titles(self) -> list[str]:
        """Titles of the y axes, then of the x axis."""
        axes = [axis for name, axis in self.layout.items() if name.startswith("yaxis")]
        return [axis["title"]["text"] for axis in (*axes, self.layout["xaxis"])]


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
        if "nav" in self.open:  # the headings once more
            return
        self.text += data
        if {"th", "td"} & set(self.open):
            self.rows[-1][-1] += data

    @property
    def data(self) -> dict[str, Any]:
        """What the figures and the bodies in 3D are drawn from."""
        scripts = [attrs for tag, attrs in self.tags if tag == "script"]
        (found,) = [i for i, attrs in enumerate(scripts) if attrs.get("id") == "data"]
        loaded: dict[str, Any] = json.loads(self.scripts[found])
        return loaded

    @property
    def figures(self) -> list[DrawnFigure]:
        """The figures, in order, each with what it shows in words and its arrays."""
        data = self.data
        drawn = []
        for _, attrs in self.tags:
            if "data-figure" not in attrs:
                continue
            assert {"plot"} == set((attrs["class"] or "").split())
            figure = data["figures"][int(attrs["data-figure"] or "")]
            traces = [
                {key: data["arrays"][value] if key in ("x", "y", "text") else value for key, value in trace.items()}
                for trace in figure["data"]
            ]
            drawn.append(DrawnFigure(attrs["aria-label"] or "", traces, figure["layout"]))
        assert len(drawn) == len(data["figures"])
        return drawn

    def figures_of(self, start: str) -> list[DrawnFigure]:
        """The figures whose description starts so."""
        return [figure for figure in self.figures if figure.label.startswith(start)]

    @property
    def plain(self) -> str:
        """The text with single spaces."""
        return " ".join(self.text.split())

    @property
    def levels(self) -> list[str | None]:
        """How to take each finding, in order, the reasons of a verdict left out."""
        items = [attrs for tag, attrs in self.tags if tag == "li" and "class" in attrs]
        return [attrs["class"] for attrs in items if "data-about" not in attrs]

    def table(self, head: str, first: Sequence[str] = ("joint", "body")) -> dict[str, dict[str, str]]:
        """Rows by name of the tables whose heading opens with one of ``first`` and has ``head``; cells by heading."""
        found: dict[str, dict[str, str]] = {}
        heads: list[str] = []
        for row in self.rows:
            if row[0] in first:
                heads = row
            elif head in heads and len(row) == len(heads):
                found[row[0]] = dict(zip(heads, row, strict=True))
        return found


def complete(page: Page) -> None:
    """Nothing is fetched or run from elsewhere, and every plot says what it shows."""
    for tag, attrs in page.tags:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base", "form")
        assert not {"src", "srcset", "data", "action"} & set(attrs)
        assert (attrs.get("href") or "#").startswith("#")  # a place on the page
        assert not any(name.startswith("on") for name in attrs)
        if "plot" in (attrs.get("class") or "").split():
            assert attrs["role"] == "img"
            assert attrs["aria-label"]
    (style,) = page.styles
    assert "url(" not in style
    assert "@import" not in style
    (policy,) = [attrs["content"] for _, attrs in page.tags if attrs.get("http-equiv") == "Content-Security-Policy"]
    assert policy
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy
    assert b"Plotly" in gzip.decompress(base64.b64decode(page.scripts[0]))
    assert len(page.html.encode()) < 6e6


def evaluation_of(curves: dict[str, Array], logs: int = 1, start: float = 0.0) -> Evaluation:
    """Made-up errors, and traces of the given curves: measured torque, then models', then maybe the angle ``q``."""
    curves = {**curves, "residual": curves["measured"] - list(curves.values())[1]}
    nv, points = curves["measured"].shape
    t = start + np.repeat(np.arange(points // 2) + 0.5, 2) * 0.01
    errors = {
        name: Errors(10, np.full(nv, 10), np.full(nv, 0.6 + i), np.full(nv, 3.6 + i), np.full(1, nv * (0.6 + i)))
        for i, name in enumerate(curves)
        if i and name not in ("residual", "q")
    }
    spread = {f"j{j}": 2.0 for j in range(nv)}
    traces = tuple(Trace(f"log {i}", t, curves) for i in range(logs))
    return Evaluation(errors, spread, traces, dict.fromkeys(spread, 5.0))


def _rms(joints: Sequence[str], value: float) -> dict[str, float]:
    return {**{joint: value * (1 + 0.1 * i) for i, joint in enumerate(joints)}, "overall": value}


def study_of(joints: Sequence[str], bodies: Sequence[str]) -> dict[str, Any]:
    """The content of study.json: tighter sets err less with few samples, and alike, within 5 %, from 100 on."""
    counts = [1, 2, 5, 10, 20, 30, 50, 100, 300, 1000]
    sets = {"none": 9.0, "semi": 6.0, "full": 3.0, "ellipsoid": 1.0}
    few = {
        name: [1.0 + (excess / n if n < 100 else 0.01 * excess / 9) for n in counts] for name, excess in sets.items()
    }
    violation = {"none": 0.8, "semi": 0.3, "full": 0.0, "ellipsoid": 0.0}
    t = np.linspace(0, 10, 4001)
    rates = {"none": 0.1, "full": 0.5, "ellipsoid": 2.0}
    return {
        "idtool": "0.0",
        "versions": {"python": "3.14"},
        "inputs": [{"kind": "log", "path": SCRIPT, "sha256": None}],
        "schema": 1,
        "joints": list(joints),
        "units": dict.fromkeys(joints, "N·m"),
        "band_hz": 40.0,
        "samples": {"train": 7000, "validation": 3000},
        "urdf": "/robots/leg.urdf",
        "logs": ["/logs/leg.mcap"],
        "seconds": 12.3,
        "sets": {
            name: {
                "rms": {"train": _rms(joints, 0.9), "validation": _rms(joints, 1 + 0.01 * i)},
                "seconds": 0.012 * (i + 1),
                "objective": 1.25,
                "duality_gap": 3e-9,
                "iterations": 10 + i,
                "lmi": {"none": "–", "semi": "6×6", "full": "4×4", "ellipsoid": "4×4, 1 linear"}[name],
                "violations": {"none": 2, "semi": 1}.get(name, 0),
                "worst_margin": {"none": -0.3, "semi": -0.1}.get(name, 0.002),
                "masses": {body: (j + 1) * (-0.5 if name == "none" else 0.5) for j, body in enumerate(bodies)},
            }
            for i, name in enumerate(sets)
        },
        "estimators": {
            name: {
                "rms": {"train": _rms(joints, 0.9), "validation": _rms(joints, 1.0)},
                "seconds": 0.02,
                "duality_gap": 1e-9 if i < 3 else None,
                "iterations": 12,
                "status": "optimal" if i < 3 else "converged",
                "note": "" if name != "manifold" else "It stopped 12 % above the convex optimum.",
            }
            for i, name in enumerate(("euclidean", "entropic", "pullback", "log_cholesky", "manifold"))
        },
        "learning": {
            "counts": counts,
            "draws": 30,
            "unit_overall": "N·m",
            "advantage": {
                name: {
                    "advantage": [float(np.log(a / b)) for a, b in zip(few["none"], y, strict=True)],
                    "advantage_error": [0.0 if name == "none" else 0.02] * len(counts),
                }
                for name, y in few.items()
            },
            "curves": {
                name: {"median": y, "lower": [0.8 * v for v in y], "upper": [1.3 * v for v in y]}
                for name, y in few.items()
            },
            "violation": {name: [most / n if n < 100 else 0.0 for n in counts] for name, most in violation.items()},
        },
        "adaptation": {
            "t": t.tolist(),
            "error": {name: np.exp(-rate * t).tolist() for name, rate in rates.items()},
            "time_to_10_percent": {"none": None, "full": 4.605, "ellipsoid": 1.151},
            "forgetting": 2.0,
        },
        "notices": [],
        "warnings": [],
    }


def notice_of(message: str, advice: str = "") -> dict[str, Any]:
    """What JSON files hold of a notice."""
    return {"code": "any", "severity": "warning", "subject": None, "message": message, "advice": advice}


def body_of(kind: str = "link", **extra: Any) -> dict[str, Any]:
    """What report.json holds of a body: a realizable one in one ellipsoid."""
    pi = from_mass_com_inertia(0.6, [0, 0, -0.16], np.diag([4e-3, 4e-3, 4e-4]))
    corners = 0.15**0.5 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    places = corners * [0.03, 0.03, 0.2] + [0, 0, -0.16]
    return {
        "copy_of": None,
        "ellipsoids": [{"center": [0, 0, -0.17], "semi_axes": [0.08, 0.08, 0.25], "rpy": [0, 0.1, 0]}],
        "shapes": [],
        "split": None,
        "witness": {"masses": [0.1, 0.1, 0.1, 0.3], "points": places.tolist()},
        "violations": [],
        "deviation_ellipsoid": {"center": [0, 0, -0.16], "semi_axes": [0.02, 0.02, 0.08], "rpy": [0.2, 0, 0]},
        "mass": 0.6,
        "com": [0.0, 0.0, -0.16],
        "pi": pi.tolist(),
        "prior": from_mass_com_inertia(0.5, [0, 0, -0.171], np.diag([5e-3, 5e-3, 3e-4])).tolist(),
        "kind": kind,
        "realizable": True,
        **extra,
    }


def with_shapes(report: dict[str, Any]) -> dict[str, Any]:
    """A report whose bodies have all that `body_of` says of one; what they have already stays."""
    bodies = {name: {**body_of(), **body} for name, body in report["bodies"].items()}
    return {
        **report,
        "bodies": bodies,
        "regularization": report.get("regularization", {}),
        "known": report.get("known", []),
    }


def basis_of(on: str = "prior", data: float = 0.0, constraints: float = 0.0, **extra: Any) -> dict[str, Any]:
    """What report.json holds of what a parameter rests on."""
    shares = {"data": data, "constraints": constraints, "prior": 1 - data - constraints}
    return {"on": on, **shares, "range": [0.0, 1.0], "moves_with": [], "combinations": [], "text": "", **extra}


def trust_of(bodies: Sequence[str], joints: Sequence[str]) -> dict[str, Any]:
    """What report.json holds of trust: masses known, first moments in combinations, the rest from the prior."""
    words = ("mass", *("m·c_x", "m·c_y", "m·c_z"), *("I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz"))
    texts = ["determined by the data", *["by the data only in a combination: x + y"] * 3, *["prior only"] * 6]
    grounds = [basis_of("data", 0.9, 0.04), *[basis_of("combination", 0.6, 0.1)] * 3, *[basis_of()] * 6]
    parameter = {"terms": [], "unit": "N·m", "value": 1.234, "standard_error": 0.1, "interval": [1.0, 1.4], "pull": 0.0}
    return {
        "units": dict.fromkeys(joints, "N·m"),
        "joints": list(joints),
        "rms": {"train": _rms(joints, 0.9), "validation": _rms(joints, 1.0)},
        "bodies": {
            body: body_of(
                standard_error=[0.02, *[None] * 9],
                interval=[[0.55, 0.65], *[None] * 9],
                identifiable=[True, *[False] * 9],
                rests_on=[
                    {**basis, "text": f"{body} {word}: {text}"}
                    for basis, word, text in zip(grounds, words, texts, strict=True)
                ],
            )
            for body in bodies
        },
        "friction": {
            joint: {"viscous": 0.1, "coulomb": 0.2, "offset": None}
            | {"standard_error": {"viscous": 0.01, "coulomb": 0.01, "offset": None}}
            for joint in joints
        },
        "rotors": {},
        "uncertainty": {
            "confidence": 0.95,
            "blocks": 32,
            "block_seconds": 0.25,
            "correlated_beyond_blocks": False,
            "bootstrap_ratio": 1.07,
            "independent_samples": dict.fromkeys(joints, 512.4),
            "torque_standard_error": dict.fromkeys(joints, 0.0123),
            "torque_standard_error_largest": dict.fromkeys(joints, 0.0456),
            "torque_undetermined": dict.fromkeys(joints, 0.125),
        },
        "base_parameters": {
            "of": 12 * len(bodies),
            "structural": 2 * len(joints),
            "determined": 2 * len(joints),
            "held_away": 0,
            "parameters": [{**parameter, "name": f"{joint} {k}"} for joint in joints for k in ("viscous", "coulomb")],
        },
        "repeatability": None,
    }
