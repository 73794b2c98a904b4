"""Tightness of a hull's conditions: size of the largest body that they admit, over that of the largest that fits.

Run ``python benchmarks/hulls.py [MESH...]``; the hulls of mesh files are added to the table.

Centres of mass and shapes of second moments are drawn at random. For each of them, the largest body is computed: of
point masses on a grid of some thousand points in the hull, by a linear program, and of all bodies that a condition
admits. The table has the relative excess of the latter, as a length, over the bodies of each hull and of all:

- ``hull``: the conditions of `idtool.robot.shapes.Hull`.
- ``corners``: second moments bounded by point masses at the corners, Sigma_2 ⪯ Σ Lambda_i v_i v_iᵀ with Lambda_i ≥ 0.
- ``ellipsoid``: the exact condition of the smallest ellipsoid around the hull.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from solids import Largest, largest_on_grid, on_ball

from idtool.robot.shapes import Hull

Array = NDArray[np.float64]

CONDITIONS = {"hull": "conditions", "corners": "corners", "ellipsoid": "ellipsoid"}
BODIES = 20
GRID_POINTS = 6000
_MIN_SIZE = 0.05  # of the hull's extent; the grid is too coarse for smaller bodies


def solids() -> dict[str, Array]:
    """Points that span the hulls, by name."""
    rng = np.random.default_rng(0)
    angle = np.arange(64) * np.pi / 32
    ball = on_ball(rng, 2000, 3)
    cube = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    points = {
        "tetrahedron": np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 2], [-1, -1, -1]]),
        "cube": cube,
        "octagonal prism": np.array([[np.cos(a), np.sin(a), z] for a in angle[::8] for z in (-1, 1)]),
        "cylinder": np.array([[np.cos(a), np.sin(a), z] for a in angle for z in (-1, 1)]),
        "cone": np.array([[0, 0, 1.5], *([np.cos(a), np.sin(a), 0] for a in angle)]),
        "box with round edges": np.sign(ball) * [1, 0.6, 0.3] + 0.1 * ball,
        "ball": ball,
    }
    for count in (6, 8, 12, 30, 60):
        points[f"{count} random points"] = rng.normal(size=(count, 3))
    return points


def relative_excess(points: Array) -> Mapping[str, list[float]]:
    """Relative excess of the largest body that each condition admits, for every body drawn."""
    rng = np.random.default_rng(1)
    points = points - points.mean(axis=0)
    points = points / np.ptp(points, axis=0).max()
    hull = Hull.around(points)
    exact_hull = Hull.around(points, max_vertices=len(points))
    corners = np.array(exact_hull.vertices)
    grid = np.concatenate([corners, exact_hull._lattice((exact_hull.volume / GRID_POINTS) ** (1 / 3))])
    if len(grid) > 2 * GRID_POINTS:
        grid = np.concatenate([corners, rng.choice(grid, 2 * GRID_POINTS, replace=False)])
    largest = {name: Largest(hull, condition) for name, condition in CONDITIONS.items()}
    excess: dict[str, list[float]] = {name: [] for name in CONDITIONS}
    for _ in range(BODIES):
        com = rng.uniform(0.1, 0.9) * rng.dirichlet(np.full(len(corners), 0.3)) @ corners
        root = rng.normal(size=(3, 3)) * np.exp(0.7 * rng.normal(size=3))
        spread = root @ root.T / np.square(root).sum()
        size = largest_on_grid(grid, com, spread)
        if size > _MIN_SIZE:
            for name in CONDITIONS:
                excess[name].append(largest[name].size(com, spread) / size - 1)
    return excess


def table_row(name: str, excess: Mapping[str, list[float]]) -> str:
    """Row with mean, median and 90 % quantile of each condition."""
    figures = (f"{np.mean(x):8.1%} {np.median(x):6.1%} {np.quantile(x, 0.9):6.1%}" for x in excess.values())
    return f"{name:22} {len(excess['hull']):6} " + " ".join(figures)


def main() -> None:
    """Print the table."""
    hulls = solids()
    for path in sys.argv[1:]:
        hulls[Path(path).stem] = np.asarray(trimesh.load_mesh(path).vertices)
    print(f"{'':29} " + " ".join(f"{name:>8} median   90 %" for name in CONDITIONS))
    total: dict[str, list[float]] = {name: [] for name in CONDITIONS}
    for name, points in hulls.items():
        excess = relative_excess(points)
        print(table_row(name, excess), flush=True)
        for condition, values in excess.items():
            total[condition] += values
    print(table_row("all", total))


if __name__ == "__main__":
    main()
