"""A model run forwards, in `fit` and `validate`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.markup import escape

from idtool.terminal.base import Terminal, figure, new_table


def show_simulation(terminal: Terminal, found: Mapping[str, Any] | None) -> None:
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
    table = new_table(f"Simulated position, RMS error, {units}: {how}", "joint", *sources)
    for name in found["position"]:
        table.add_row(escape(name), *(figure(of["position"][name]) for of, _ in sources.values()))
    for at in found["horizon"]:
        reached = (figure((at[key] or {}).get("overall")) for _, key in sources.values())
        table.add_row(f"after {1000 * at['seconds']:g} ms", *reached)
    terminal.show(table)
