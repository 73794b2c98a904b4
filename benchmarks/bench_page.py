"""The documentation's page of benchmarks: ``python benchmarks/bench_page.py`` writes it and its plots.

The figures are those of ``bench.json``, which `bench` writes; the page is ``docs/pages/benchmarks.md``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from bench_record import FILE, Bench
from comparison import Comparison, duration_text, number_text
from growth import COMMAND, Growth

PAGES = Path(__file__).parents[1] / "docs" / "pages"

FONT = 'font-family="sans-serif" font-size="12" fill="#333"'
OURS, THEIRS, OTHER = "#1f77b4", "#d62728", "#7f7f7f"
WIDTH = 800  # px
FIGURES = {"wall": ("wall time", OURS), "cpu": ("CPU time", OTHER), "memory": ("memory", OURS)}

INTRODUCTION = """\
# Benchmarks

This page compares the speed of idtool with that of other programs, and shows how the time and memory of a fit grow.
The figures are from {commands} on {date}, with commit {commit} of idtool.

The machine: {machine}. Linear algebra used one thread.
The load (number of programs that run or wait) was between {least:.1f} and {most:.1f}. Without other programs it would
be at most 2.
"""

COMPARISON = """\
## Comparison with other programs

The ratio is the time of the other program divided by that of idtool: above 1, idtool is faster. Both take turns. The
ratio is the median over the repetitions, with its range in brackets. In the plot, red bars show where idtool is slower.

The last column shows how far the results of the two programs are apart. *Relative cost* is the amount by which the
cost of the other program's optimum exceeds that of idtool. *Relative parameters* is the distance of the parameters, in
units of the masses and sizes of the bodies. *Relative columns* is the largest difference of the regressor's entries,
relative to the largest entry.

![Ratios of computing times](images/bench_ratios.svg)
"""

GROWTH = """\
## Growth of time and memory

Each size is fitted by `{command}` in a new process, `thorough` without `--quick`. `benchmarks/long_logs.py` makes
the robots and the logs. Times are those of the whole command: start, reading, fit and report, the least of at least two
runs (`thorough`: of one). Memory is the peak of the largest process.

The exponent is the slope in the double logarithmic plot. With an exponent of 1, twice the size takes twice the time.
The constant time of the start and the constant memory of the libraries decrease it. Therefore the slope between the
two largest sizes is given, too. For processes, the exponent of the wall time is −1 at best, if the cores are free.

![Time and memory of a fit](images/bench_growth.svg)
"""


def page(bench: Bench) -> str:
    """Text of the page."""
    machine = bench.machine
    cores = f"{machine.cores} cores" if machine.cores > 1 else "one core"
    memory = f"{machine.memory / 2**30:.0f} GiB of memory"
    introduction = INTRODUCTION.format(
        commands=" and ".join(f"`{command}`" for command in bench.commands),
        date=bench.date,
        commit=bench.commit or "unknown",
        machine=f"{machine.processor}, {cores}, {memory}, {machine.system}, Python {machine.python}",
        least=min(bench.load),
        most=max(bench.load),
    )
    return "\n".join([introduction, *_comparison_section(bench), *_growth_section(bench)])


def _comparison_section(bench: Bench) -> list[str]:
    """The table of ratios, and notes on the differences between the tasks."""
    if not bench.comparisons and not bench.not_installed:
        return []
    lines = ["| task | other program | idtool | other | ratio | difference of the results |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    notes: list[str] = []
    for one in bench.comparisons:
        note = ""
        if one.remark:
            if one.remark not in notes:
                notes.append(one.remark)
            note = f" ({notes.index(one.remark) + 1})"
        times = f"{duration_text(one.ours)} | {duration_text(one.theirs)}"
        lines.append(f"| {one.task}{note} | {one.peer} | {times} | {one.ratio_text} | {one.agreement_text} |")
    for peer in bench.not_installed:
        lines.append(f"| | {peer} | | | not installed | |")
    for name in bench.failures:
        lines.append(f"| {name} | | | | failed | |")
    if notes:
        lines += ["", "Differences between the tasks:", ""]
        lines += [f"{i + 1}. {note}" for i, note in enumerate(notes)]
    return [COMPARISON, "\n".join(lines), ""]


def _growth_section(bench: Bench) -> list[str]:
    """Tables of the growth."""
    if not bench.growth:
        return []
    parts = [GROWTH.format(command=COMMAND)]
    full = " --full" if any("--full" in command for command in bench.commands) else ""
    for growth in bench.growth:
        command = f"python benchmarks/growth.py {growth.quantity}{full}"
        lines = [f"### {growth.quantity.capitalize()}", ""]
        description = f"{growth.description[0].upper()}{growth.description[1:]}"
        lines.append(f"{description}. Load before: {growth.load:.1f}. Command: `{command}`.")
        lines += ["", f"| {growth.unit} | wall time [s] | CPU time [s] | memory [MiB] |", "| --- | --- | --- | --- |"]
        for size, cost in zip(growth.sizes, growth.costs, strict=True):
            lines.append(f"| {size:g} | {cost.wall:.2f} | {cost.cpu:.2f} | {cost.memory / 2**20:.0f} |")
        rows = [("exponent", growth.exponent)]
        if len(growth.sizes) > 2:
            rows.append(("exponent of the two largest", growth.last_exponent))
        for words, exponent in rows:
            values = " | ".join(f"{exponent(name):.2f}" for name in FIGURES)
            lines.append(f"| {words} | {values} |")
        parts += ["\n".join(lines), ""]
    return parts


@dataclass(frozen=True)
class Axis:
    """A logarithmic axis from ``low`` to ``high`` between two places [px]."""

    low: float
    high: float
    start: float
    end: float

    def place(self, value: float) -> float:
        """Place of a value [px]."""
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.start + share * (self.end - self.start)

    def decades(self) -> list[float]:
        """Powers of ten on the axis."""
        first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
        return [10.0**k for k in range(first, last + 1)]


def ratio_plot(comparisons: Sequence[Comparison]) -> str:
    """SVG of the ratios: a bar from 1 for each, with its range."""
    row, top, bottom = 38, 16, 44  # px
    height = top + row * len(comparisons) + bottom
    low = 10 ** math.floor(math.log10(min(0.9, *(one.least_ratio for one in comparisons))))
    high = 10 ** math.ceil(math.log10(max(1.1, *(one.greatest_ratio for one in comparisons))))
    axis = Axis(low, high, 20, WIDTH - 60)
    foot = top + row * len(comparisons)
    lines = [_svg_head(height)]
    for decade in axis.decades():
        x = axis.place(decade)
        lines.append(f'<path d="M{x:.1f} {top}V{foot}" stroke="{"#333" if decade == 1 else "#ddd"}"/>')
        lines.append(f'<text x="{x:.1f}" y="{foot + 16}" text-anchor="middle">{decade:g}</text>')
    for i, one in enumerate(comparisons):
        y = top + row * i
        x, zero = axis.place(one.ratio), axis.place(1)
        color = OURS if one.ratio >= 1 else THEIRS
        name = escape(f"{one.peer}: {one.task}")
        ends = [axis.place(ratio) for ratio in (one.least_ratio, one.greatest_ratio)]
        lines.append(f'<text x="24" y="{y + 13}" font-size="11">{name}</text>')
        lines.append(
            f'<rect x="{min(x, zero):.1f}" y="{y + 18}" width="{abs(x - zero):.1f}" height="12" fill="{color}"/>'
        )
        lines.append(f'<path d="M{ends[0]:.1f} {y + 24}H{ends[1]:.1f}" stroke="#333"/>')
        lines.append(f'<text x="{max(x, zero, *ends) + 6:.1f}" y="{y + 28}">{number_text(one.ratio)}</text>')
    words = "time of the other program / time of idtool; above 1, idtool is faster"
    lines.append(f'<text x="{WIDTH / 2}" y="{foot + 36}" text-anchor="middle">{words}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def growth_plot(growths: Sequence[Growth]) -> str:
    """SVG of the growth: for each quantity a panel of times and one of memory, both logarithmic."""
    panel, gap, top, left = 150, 62, 30, 70  # px
    width = (WIDTH - 2 * left - 20) / 2
    lines = [_svg_head(top + len(growths) * (panel + gap))]
    for i, (name, (words, color)) in enumerate(FIGURES.items()):
        if name != "memory":
            lines.append(f'<path d="M{left + 110 * i} 14h20" stroke="{color}" stroke-width="3"/>')
            lines.append(f'<text x="{left + 26 + 110 * i}" y="18">{words}</text>')
    for i, growth in enumerate(growths):
        y = top + i * (panel + gap)
        lines += _panel(growth, ("wall", "cpu"), left, y, width, panel, "time [s]", 1.0)
        lines += _panel(growth, ("memory",), 2 * left + width, y, width, panel, "memory [MiB]", 2.0**20)
    return "\n".join([*lines, "</svg>"]) + "\n"


def _panel(
    growth: Growth,
    names: Sequence[str],
    x: float,
    y: float,
    width: float,
    height: float,
    label: str,
    unit: float,
) -> list[str]:
    """Curves of some figures over the sizes, in units of ``unit``."""
    curves = {name: [value / unit for value in growth.values(name)] for name in names}
    values = [value for curve in curves.values() for value in curve]
    sizes = growth.sizes
    across = Axis(sizes[0] / 1.2, sizes[-1] * 1.2, x, x + width)
    up = Axis(10 ** math.floor(math.log10(min(values))), 10 ** math.ceil(math.log10(max(values) * 1.01)), y + height, y)
    lines = [f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="none" stroke="#ccc"/>']
    for decade in up.decades():
        place = up.place(decade)
        lines.append(f'<path d="M{x} {place:.1f}h{width}" stroke="#eee"/>')
        lines.append(f'<text x="{x - 6}" y="{place + 4:.1f}" text-anchor="end">{decade:g}</text>')
    for size in sizes:
        lines.append(f'<text x="{across.place(size):.1f}" y="{y + height + 16}" text-anchor="middle">{size:g}</text>')
    lines.append(f'<text x="{x + width / 2}" y="{y + height + 34}" text-anchor="middle">{escape(growth.unit)}</text>')
    place = f"translate({x - 44} {y + height / 2}) rotate(-90)"
    lines.append(f'<text transform="{place}" text-anchor="middle">{label}</text>')
    for name, curve in curves.items():
        color = FIGURES[name][1]
        points = [(across.place(size), up.place(value)) for size, value in zip(sizes, curve, strict=True)]
        path = " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
        lines.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        lines += [f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3.5" fill="{color}"/>' for px, py in points]
    return lines


def _svg_head(height: float) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" {FONT}>\n'
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>'
    )


def main(file: Path = FILE, pages: Path = PAGES) -> None:
    """Write the page and its plots."""
    bench = Bench.from_json(file.read_text())
    images = pages / "images"
    images.mkdir(parents=True, exist_ok=True)
    (pages / "benchmarks.md").write_text(page(bench))
    if bench.comparisons:
        (images / "bench_ratios.svg").write_text(ratio_plot(bench.comparisons))
    if bench.growth:
        (images / "bench_growth.svg").write_text(growth_plot(bench.growth))


if __name__ == "__main__":
    main()
