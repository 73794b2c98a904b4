"""A model run forwards, in `fit` and `validate`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

from idtool.reporting.figures import figure
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.terminal.base import STYLE, Terminal, new_table


def show_simulation(terminal: Terminal, found: Simulation | None) -> None:
    """Position errors of a model run forwards, by joint and by time since the restart."""
    if found is None:
        return
    closed = found.kind == "closed_loop"
    often = f"{found.window:g} s at a time" if found.window else f"{found.seconds:.3g} s, never restarted"
    how = f"{'closed loop under the controller' if closed else 'open loop'}, {often}"
    units = " or ".join(dict.fromkeys(found.units.values()))
    sources = {
        "model": (found.position, "position"),
        **({"prior": (found.prior.position, "prior")} if found.prior else {}),
        "q = qcmd" if closed else "stays": (found.baseline.position, "baseline"),
    }
    table = new_table(f"Simulated position, RMS error, {units}: {how}", "joint", *sources)
    for name in found.position:
        table.add_row(name, *(figure(errors[name]) for errors, _ in sources.values()))
    for at in found.horizon:
        reached = (figure((getattr(at, key) or {}).get("overall")) for _, key in sources.values())
        table.add_row(f"after {1000 * at.seconds:g} ms", *reached)
    terminal.show(table)
    if remark := _remark(found, often, "q = qcmd" if closed else "a robot that stays where it is"):
        terminal.say(f"{remark}\n", STYLE["warning"])


def _remark(found: Simulation, often: str, baseline: str) -> str | None:
    """That the model is no better than the baseline in all, and how long it is better; None where it is."""
    if _better(found.position, found.baseline.position):
        return None
    said = f"Over {often}, the model is farther from the data than {baseline}"
    better = itertools.takewhile(lambda at: _better(at.position, at.baseline), found.horizon)
    if good := [at.seconds for at in better]:
        long = f"{1000 * good[-1]:g} ms"
        return f"{said}; it is nearer up to {long} after a restart: trust its rollouts for no longer than that."
    return f"{said}: its rollouts are not to be trusted."


def _better(model: Mapping[str, Any], baseline: Mapping[str, Any] | None) -> bool:
    """Whether a model's error is below the baseline's; one that ran away has none."""
    own, other = model["overall"], (baseline or {}).get("overall")
    return own is not None and (other is None or own < other)
