"""Pictures of the sample leg's report: ``python docs/picture.py`` writes ``report.svg`` and ``report.png``.

They are in docs/pages/images/. The first shows torque and residual over four seconds of the validation log, as in
report.html. The second, in README.md, is a photograph of the beginning of report.html; it needs Chromium.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import idtool

ROOT = Path(__file__).parent.parent
IMAGES = ROOT / "docs" / "pages" / "images"

PAGE_WIDTH, PAGE_HEIGHT = 1100, 1260  # px, of the photograph
DRAWING_TIME = 20_000  # ms, that the browser has for the figures in 3D
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")

LENGTH = 4.0  # s
WIDTH, LEFT, RIGHT, TOP, BOTTOM = 800, 64, 12, 44, 40  # px
TORQUE, RESIDUAL, GAP = 120, 60, 14  # heights, and the space below each joint [px]
LABELS = {"measured": "measured", "predicted": "identified model", "prior": "original URDF", "residual": "residual"}


def picture(result: idtool.FitResult) -> str:
    """The SVG: for every joint a panel with the torques, and one with the residual of the identified model."""
    traces = list(result.plot().data)  # four for each joint: measured, predicted, prior, residual
    start = float(np.floor(traces[0].x[0]))
    height = TOP + len(result.joints) * (TORQUE + RESIDUAL + GAP) + BOTTOM
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        'font-size="12" fill="#333">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        *legend(traces[:4]),
    ]
    top = TOP
    for k, joint in enumerate(result.joints):
        torques, residual = traces[4 * k : 4 * k + 3], traces[4 * k + 3]
        lines += panel([torques[2], torques[0], torques[1]], start, top, TORQUE, f"{joint} [{result.units[joint]}]")
        lines += panel([residual], start, top + TORQUE, RESIDUAL, "residual")
        top += TORQUE + RESIDUAL + GAP
    for t in range(int(LENGTH) + 1):
        lines.append(f'<text x="{across(t):.1f}" y="{top + 4}" text-anchor="middle">{start + t:.0f}</text>')
    lines.append(f'<text x="{across(LENGTH / 2):.1f}" y="{top + 22}" text-anchor="middle">time [s]</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def across(seconds: float) -> float:
    """Horizontal position of a time since the start of the picture [px]."""
    return LEFT + seconds / LENGTH * (WIDTH - LEFT - RIGHT)


def legend(traces: list[Any]) -> list[str]:
    """Names of the curves, above the panels."""
    lines = []
    for k, trace in enumerate(traces):
        x = LEFT + 165 * k
        lines.append(f'<path d="M{x} 20h24" stroke="{trace.line.color}" stroke-width="3"/>')
        lines.append(f'<text x="{x + 30}" y="24">{LABELS[trace.name]}</text>')
    return lines


def panel(traces: list[Any], start: float, top: float, height: float, title: str) -> list[str]:
    """A frame with curves and labels; its vertical range is that of the curves."""
    curves = []
    for trace in traces:
        t = np.array(trace.x) - start
        y = np.array(trace.y, dtype=float)
        shown = np.isfinite(y) & (t <= LENGTH)
        curves.append((trace, t[shown], y[shown]))
    least = min(float(y.min()) for _, _, y in curves)
    greatest = max(float(y.max()) for _, _, y in curves)
    scale = (height - 10) / (greatest - least)  # px per unit
    zero = top + 5 + scale * greatest
    mark = float(f"{0.7 * min(-least, greatest):.1g}")
    lines = [
        f'<rect x="{LEFT}" y="{top}" width="{WIDTH - LEFT - RIGHT}" height="{height}" fill="none" stroke="#ccc"/>',
        f'<path d="M{LEFT} {zero:.1f}H{WIDTH - RIGHT}" stroke="#ddd"/>',
        f'<text transform="translate(14 {top + height / 2}) rotate(-90)" text-anchor="middle">{title}</text>',
    ]
    for value in (-mark, 0.0, mark):
        lines.append(f'<text x="{LEFT - 6}" y="{zero - scale * value + 4:.1f}" text-anchor="end">{value:g}</text>')
    for trace, t, y in curves:
        points = " ".join(f"{across(s):.1f},{zero - scale * value:.1f}" for s, value in zip(t, y, strict=True))
        width = 5 if trace.name == "measured" else 1.2
        lines.append(f'<polyline points="{points}" fill="none" stroke="{trace.line.color}" stroke-width="{width}"/>')
    return lines


def fitted(quick: bool) -> idtool.FitResult:
    """The model of the sample leg."""
    samples = ROOT / "sample_logs"
    return idtool.fit(
        samples / "leg.urdf", samples / "leg_train.mcap", validate=samples / "leg_validate.mcap", quick=quick
    )


def photograph(page: Path, file: Path) -> None:
    """Write the beginning of a page as a PNG.

    Raises
    ------
    SystemExit
        If there is no Chromium.
    """
    browser = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if browser is None:
        raise SystemExit("error: chromium: is not installed; the photograph of report.html needs it")
    options = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--use-angle=swiftshader"]
    options += ["--enable-unsafe-swiftshader", f"--window-size={PAGE_WIDTH},{PAGE_HEIGHT}"]
    options += [f"--virtual-time-budget={DRAWING_TIME}", f"--screenshot={file}"]
    subprocess.run([browser, *options, page.as_uri()], check=True, capture_output=True)  # noqa: S603


def main(file: Path = IMAGES / "report.svg") -> None:
    """Fit the leg and draw torque and residual."""
    file.parent.mkdir(exist_ok=True)
    file.write_text(picture(fitted(quick=True)))


if __name__ == "__main__":
    main()
    with tempfile.TemporaryDirectory() as folder:
        fitted(quick=False).save(folder)
        photograph(Path(folder, "report.html"), IMAGES / "report.png")
