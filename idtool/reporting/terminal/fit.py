"""The result of `idtool fit`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from idtool.estimation.problem.certificate import GAP, ROUNDING
from idtool.reporting.terminal.base import Terminal, figure, new_table, units_of
from idtool.reporting.terminal.simulation import show_simulation
from idtool.reporting.terminal.tables import Words

_WORST = 8  # parameters that are listed
_SIDE_BY_SIDE = 4  # logs in a table


def show_fit(terminal: Terminal, report: dict[str, Any], folder: Path) -> None:
    """The result of a fit: errors, bodies, friction, certificate, and where the files are."""
    rms = report["rms"]
    table = new_table(
        f"RMS torque error, {units_of(report)}, below {report['band_hz']:g} Hz", "joint", "prior", "train", "held out"
    )
    for name in (*report["joints"], "overall"):
        held_out = [(rms[key] or {}).get(name) for key in ("prior_validation", "validation")]
        table.add_row(name, figure(held_out[0]), figure(rms["train"][name]), figure(held_out[1]))
    terminal.show(table)
    show_simulation(terminal, report["simulation"])
    _show_bodies(terminal, report)
    kinds = ("viscous", "Coulomb", "offset")
    table = new_table("Friction, with standard errors", "joint", *((kind, "± se") for kind in kinds))
    for name, friction in report["friction"].items():
        pairs = [(friction[key], friction["standard_error"][key]) for key in ("viscous", "coulomb", "offset")]
        table.add_row(name, *(figure(x) for pair in pairs for x in pair))
    terminal.show(table)
    if report["controller"] and report["controller"]["text"]:
        terminal.say(f"controller delay: {report['controller']['text']}")
    _show_trust(terminal, report)
    prior = report["regularization"]
    if prior["automatic"] is not None:
        terminal.say(f"the prior's weight is {prior['weight']:.2g}: {prior['automatic']['reason']}")
    terminal.say(_optimality(report["solver"]))
    terminal.warn(report["warnings"])
    terminal.say(f"written: {folder}/identified.urdf, model.yaml, report.json, report.html")


def _optimality(solver: dict[str, Any]) -> str:
    """How far the cost may be above the least."""
    gap = max(abs(solver["duality_gap"]), ROUNDING)
    if gap <= GAP:
        return f"optimum certified to a relative duality gap of {gap:.1e}"
    return f"not the optimum: {solver['name']} ended at a cost that may be {gap:.1e} above the least, relative to it"


def _show_bodies(terminal: Terminal, report: dict[str, Any]) -> None:
    """Masses, and how many of a body's ten parameters rest on what."""
    asked = report["base_parameters"] is not None
    grounds = ("data", "combination", "constraints", "prior") if asked else ("determined",)
    table = new_table("Bodies", "body", "prior kg", ("mass kg", "± se"), grounds, "realizable")
    for name, body in report["bodies"].items():
        on = [basis["on"] for basis in body["rests_on"]] if asked else []
        counts = [str(on.count(ground)) for ground in grounds] if asked else [f"{sum(body['identifiable'])}/10"]
        mass = (body["prior"][0], body["mass"], body["standard_error"][0])
        table.add_row(name, *map(figure, mass), *counts, "yes" if body["realizable"] else "NO")
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
        values = logs["logs"] if few else (("least", "in"), ("greatest", "in"))
        columns = (Words("parameter"), *values, ("times expected", "beyond chance"))
        table = new_table("Least repeatable between the logs", *columns)
        for p in worst[:_WORST]:
            values = map(figure, p["value"]) if few else _extremes(p["value"], logs["logs"])
            table.add_row(p["name"], *values, figure(p["ratio"]), "" if p["agrees"] else "yes")
        terminal.show(table)


def _extremes(values: Sequence[float | None], logs: Sequence[str]) -> list[str]:
    """The least and the greatest value, each with its log."""
    there = [(value, name) for value, name in zip(values, logs, strict=True) if value is not None]
    ends = (min(there), max(there)) if there else ((None, "-"), (None, "-"))
    return [text for value, name in ends for text in (figure(value), name)]
