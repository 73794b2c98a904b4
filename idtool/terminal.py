"""What a person sees in the terminal: tables, and a progress bar on what takes more than two seconds."""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from idtool.fit import Fit
from idtool.inspection import Inspection
from idtool.regression import Outcome

_PLAIN_WIDTH = 200  # characters
_WORST = 8  # parameters that are listed
_SIDE_BY_SIDE = 4  # logs in a table
_PATIENCE = 2.0  # s before a progress bar appears
_STYLE = {"problem": "bold red", "warning": "yellow", "note": "dim"}


class Terminal:
    """Where a command prints to.

    Parameters
    ----------
    quiet
        Print nothing but errors and what `json` asks for.
    as_json
        Print the result as JSON on standard output, everything else on standard error.
    """

    def __init__(self, quiet: bool, as_json: bool) -> None:
        self.as_json = as_json
        self.console = _console(quiet, sys.stderr if as_json else sys.stdout)
        self.errors = _console(quiet, sys.stderr)

    def say(self, text: str, style: str | None = None) -> None:
        """One line of plain text."""
        self.console.print(escape(text), style=style, soft_wrap=True)

    def show(self, table: Table) -> None:
        """A table under its title, which may be wider than the table."""
        self.say(str(table.title), "bold")
        table.title = None
        self.console.print(table)
        self.console.print()

    def warn(self, warnings: Sequence[str]) -> None:
        """What a user should know, at the end."""
        for warning in warnings:
            self.say(f"note: {warning}", "yellow")

    def result(self, result: Mapping[str, Any]) -> None:
        """The result as JSON, if it was asked for."""
        if self.as_json:
            sys.stdout.write(json.dumps(result, indent=2, allow_nan=False) + "\n")

    @contextmanager
    def progress(self) -> Iterator[Callable[[str, float], None]]:
        """A function to be told the stage and its share done; shows a bar once two seconds have gone by."""
        bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(), console=self.errors, transient=True
        )
        started = time.monotonic()
        tasks: list[TaskID] = []

        def tell(stage: str, share: float) -> None:
            if not self.errors.is_terminal or time.monotonic() - started < _PATIENCE:
                return
            if not tasks:
                bar.start()
                tasks.append(bar.add_task(stage, total=1.0))
            bar.update(tasks[0], description=escape(stage), completed=share)

        try:
            yield tell
        finally:
            if tasks:
                bar.stop()


def _console(quiet: bool, file: TextIO) -> Console:
    """A console; one that is no terminal has lines as long as they need."""
    return Console(quiet=quiet, file=file, highlight=False, width=None if file.isatty() else _PLAIN_WIDTH)


def _table(title: str, *columns: str) -> Table:
    """A table whose first column is text and whose others are figures."""
    table = Table(title=title, box=None, pad_edge=False, header_style="dim")
    table.add_column(columns[0])
    for column in columns[1:]:
        table.add_column(column, justify="right")
    return table


def _units(report: dict[str, Any]) -> str:
    return " or ".join(dict.fromkeys(report["units"].values()))


def _figure(x: float | None) -> str:
    return "-" if x is None else f"{x:.4g}"


def _show_simulation(terminal: Terminal, found: Mapping[str, Any] | None) -> None:
    """Position errors of a model run forwards, by joint and by time since the restart."""
    if found is None:
        return
    closed = found["kind"] == "closed_loop"
    often = f"{found['window']:g} s at a time" if found["window"] else f"{found['seconds']:.3g} s, never restarted"
    how = f"{'closed loop under the controller' if closed else 'open loop'}, {often}"
    units = " or ".join(dict.fromkeys(found["units"].values()))
    sources = {
        "model": (found, "position"),
        **({"prior": (found["prior"], "prior")} if found["prior"] else {}),
        "q = qcmd" if closed else "stays": (found["baseline"], "baseline"),
    }
    table = _table(f"Simulated position, RMS error, {units}: {how}", "joint", *sources)
    for name in found["position"]:
        table.add_row(escape(name), *(_figure(of["position"][name]) for of, _ in sources.values()))
    for at in found["horizon"]:
        reached = (_figure((at[key] or {}).get("overall")) for _, key in sources.values())
        table.add_row(f"after {1000 * at['seconds']:g} ms", *reached)
    terminal.show(table)


def show_fit(terminal: Terminal, fit: Fit, report: dict[str, Any], folder: Path) -> None:
    """The result of a fit: errors, bodies, friction, certificate, and where the files are."""
    rms = report["rms"]
    table = _table(
        f"RMS torque error, {_units(report)}, below {report['band_hz']:g} Hz", "joint", "prior", "train", "held out"
    )
    for name in (*report["joints"], "overall"):
        held_out = [(rms[key] or {}).get(name) for key in ("prior_validation", "validation")]
        table.add_row(escape(name), _figure(held_out[0]), _figure(rms["train"][name]), _figure(held_out[1]))
    terminal.show(table)
    _show_simulation(terminal, report["simulation"])
    _show_bodies(terminal, report)
    table = _table("Friction, with standard errors", "joint", "viscous", "± se", "Coulomb", "± se", "offset", "± se")
    for name, friction in report["friction"].items():
        pairs = [(friction[key], friction["standard_error"][key]) for key in ("viscous", "coulomb", "offset")]
        table.add_row(escape(name), *(_figure(x) for pair in pairs for x in pair))
    terminal.show(table)
    _show_trust(terminal, report)
    solver = report["solver"]
    terminal.say(f"optimum certified to a relative duality gap of {abs(solver['duality_gap']):.1e}")
    terminal.warn(fit.warnings)
    terminal.say(f"written: {folder}/identified.urdf, model.yaml, report.json, report.html")


def _show_bodies(terminal: Terminal, report: dict[str, Any]) -> None:
    """Masses, and how many of a body's ten parameters rest on what."""
    asked = report["base_parameters"] is not None
    grounds = ("data", "combination", "constraints", "prior") if asked else ("determined",)
    table = _table("Bodies", "body", "prior kg", "mass kg", "± se", *grounds, "realizable")
    for name, body in report["bodies"].items():
        on = [basis["on"] for basis in body["rests_on"]] if asked else []
        counts = [str(on.count(ground)) for ground in grounds] if asked else [f"{sum(body['identifiable'])}/10"]
        mass = (body["prior"][0], body["mass"], body["standard_error"][0])
        table.add_row(escape(name), *map(_figure, mass), *counts, "yes" if body["realizable"] else "NO")
    terminal.show(table)


def _show_trust(terminal: Terminal, report: dict[str, Any]) -> None:
    """What the numbers rest on, and whether several logs agree."""
    if base := report["base_parameters"]:
        terminal.say(
            f"the log determines {base['determined']} of the {base['structural']} combinations of the {base['of']} "
            "parameters that any motion of this robot can tell; the columns above say what each body's ten rest on"
        )
    if logs := report["repeatability"]:
        worst = sorted(logs["parameters"], key=lambda p: (p["agrees"], -(p["ratio"] or 0)))
        few = len(logs["logs"]) <= _SIDE_BY_SIDE
        names = map(escape, logs["logs"]) if few else ("least", "in", "greatest", "in")
        columns = ("parameter", *names, "times expected", "beyond chance")
        table = _table("Least repeatable between the logs", *columns)
        for p in worst[:_WORST]:
            values = map(_figure, p["value"]) if few else _extremes(p["value"], logs["logs"])
            table.add_row(escape(p["name"]), *values, _figure(p["ratio"]), "" if p["agrees"] else "yes")
        terminal.show(table)


def _extremes(values: Sequence[float | None], logs: Sequence[str]) -> list[str]:
    """The least and the greatest value, each with its log."""
    there = [(value, name) for value, name in zip(values, logs, strict=True) if value is not None]
    ends = (min(there), max(there)) if there else ((None, "-"), (None, "-"))
    return [text for value, name in ends for text in (_figure(value), escape(name))]


def show_validation(terminal: Terminal, report: dict[str, Any], folder: Path) -> None:
    """The result of a validation."""
    models = list(report["rms"])
    columns = [*models, "raw", "of torque", "bound"]
    table = _table(f"RMS torque error, {_units(report)}, below {report['band_hz']:g} Hz", "joint", *columns)
    for name in (*report["joints"], "overall"):
        bound = report["bound"].get(name)
        met = "" if bound is None else " ok" if report["ok"][name] else " NOT MET"
        share = report["nrms"].get(name)
        table.add_row(
            escape(name),
            *(_figure(report["rms"][model][name]) for model in models),
            _figure(report["rms_raw"]["model"][name]),
            "" if share is None else f"{share:.1%}",
            "" if bound is None else f"{bound:g}{met}",
        )
    terminal.show(table)
    _show_simulation(terminal, report["simulation"])
    terminal.warn(report["warnings"])
    terminal.say(f"written: {folder}/validation.json, validation.html")


def show_regression(terminal: Terminal, outcomes: Sequence[Outcome]) -> None:
    """Every case against its bounds."""
    table = _table("Regression: RMS torque error in the band, N·m or N", "case", "joint", "prior", "fit", "bound", "")
    for o in outcomes:
        met = "ok" if o.ok else "NOT MET"
        table.add_row(escape(o.case), escape(o.joint), _figure(o.prior), _figure(o.rms), _figure(o.bound), met)
    terminal.show(table)


def show_inspection(terminal: Terminal, inspection: Inspection) -> None:
    """What is in a log, and the findings."""
    terminal.say(
        f"{inspection.path}: {inspection.samples} samples, {inspection.duration:.2f} s at {inspection.rate_hz:.4g} Hz, "
        f"{inspection.segments} stretches without a gap"
    )
    table = _table(
        "Joints", "joint", "signals", "from", "to", "v rms", "tau rms", "band Hz", "at rest", "v lag ms", "tau"
    )
    for name, joint in inspection.joints.items():
        q, tau, v = joint.signals.get("q"), joint.signals.get("tau"), joint.velocity
        table.add_row(
            escape(name),
            " ".join(joint.signals),
            _figure(q.minimum if q else None),
            _figure(q.maximum if q else None),
            _figure(joint.speed_rms),
            _figure(tau.rms if tau else None),
            _figure(joint.band_hz),
            f"{joint.standstill:.0%}",
            _figure(v.lag_ms if v else None),
            joint.torque.kind if joint.torque else "-",
        )
    terminal.show(table)
    for meaning, group in itertools.groupby(inspection.findings, key=lambda finding: finding.meaning):
        for finding in group:
            where = f"{finding.joint}: " if finding.joint else ""
            terminal.say(f"{finding.severity}: {where}{finding.what}", _STYLE[finding.severity])
        terminal.say(f"    {meaning}")
    terminal.warn(inspection.warnings)


def show_check(terminal: Terminal, report: dict[str, Any], repair: Path | None) -> None:
    """Which links' inertias no body can have, and what was written for them."""
    table = _table("Links", "link", "mass kg", "can exist", *(["repaired kg", "moved"] if repair else []))
    for name, link in report["links"].items():
        nearest = link["nearest"]
        moved = [_figure(nearest["mass"]), f"{nearest['moved']:.2%}"] if nearest else ["", ""]
        table.add_row(
            escape(name), _figure(link["mass"]), "NO" if link["violations"] else "yes", *(moved if repair else [])
        )
    terminal.show(table)
    for name, link in report["links"].items():
        for violation in link["violations"]:
            terminal.say(f"{name}: {violation}", _STYLE["problem"])
    wrong = sum(bool(link["violations"]) for link in report["links"].values())
    terminal.say(f"{wrong} of {len(report['links'])} links have an inertia that no body can have")
    if repair:
        terminal.say(f"written: {repair}")


def show_study(terminal: Terminal, report: dict[str, Any], folder: Path) -> None:
    """Constraint sets, estimators, learning curves and Remark 5 in tables."""
    unit, band = _units(report), report["band_hz"]
    table = _table(
        f"Constraint sets: RMS torque error, {unit}, below {band:g} Hz",
        *("set", "inequalities", "train", "held out", "unrealizable", "ms", "gap"),
    )
    for name, s in report["sets"].items():
        rms = [_figure(s["rms"][part]["overall"]) for part in ("train", "validation")]
        table.add_row(
            name, s["lmi"], *rms, str(s["violations"]), _figure(1000 * s["seconds"]), f"{abs(s['duality_gap']):.0e}"
        )
    terminal.show(table)
    table = _table("Estimators", "estimator", "train", "held out", "ms", "gap", "iterations")
    for name, e in report["estimators"].items():
        rms = [_figure(e["rms"][part]["overall"]) for part in ("train", "validation")]
        table.add_row(name, *rms, _figure(1000 * e["seconds"]), f"{abs(e['duality_gap']):.0e}", str(e["iterations"]))
    terminal.show(table)
    learning = report["learning"]
    title = f"Median held-out RMS, {unit}, against training samples, {learning['draws']} draws"
    table = _table(title, "samples", *learning["curves"], *(f"{name} violation" for name in learning["violation"]))
    for k, count in enumerate(learning["counts"]):
        medians = [_figure(curve["median"][k]) for curve in learning["curves"].values()]
        table.add_row(str(count), *medians, *(_figure(v[k]) for v in learning["violation"].values()))
    terminal.show(table)
    settled = report["adaptation"]["time_to_10_percent"]
    table = _table("Online: time to 10 % parameter error", "set", "s")
    for name, seconds in settled.items():
        table.add_row(name, "not reached" if seconds is None else _figure(seconds))
    terminal.show(table)
    terminal.warn([e["note"] for e in report["estimators"].values() if e["note"]] + report["warnings"])
    terminal.say(f"written: {folder}/study.json, study.html ({report['seconds']:.0f} s)")


def show_adaptation(terminal: Terminal, report: dict[str, Any], folder: Path) -> None:
    """The error of the prediction one sample ahead, and the bodies at the end."""
    title = f"RMS error of the torque predicted one sample ahead, {_units(report)}, below {report['band_hz']:g} Hz"
    table = _table(title, "joint", "rms")
    for name in (*report["joints"], "overall"):
        table.add_row(escape(name), _figure(report["prediction_rms"][name]))
    terminal.show(table)
    table = _table("Bodies at the end", "body", "mass kg", "realizable")
    for name, body in report["final"]["bodies"].items():
        table.add_row(escape(name), _figure(body["mass"]), "yes" if body["realizable"] else "NO")
    terminal.show(table)
    terminal.warn(report["warnings"])
    terminal.say(f"{report['samples']} samples in {report['seconds']:.1f} s")
    terminal.say(f"written: {folder}/adapt.json, adapt.html")
