"""How much larger a body a hull's conditions admit than fits.

Run ``python benchmarks/hulls.py [MESH...]``; with mesh files their hulls are judged too.

For centres of mass and forms of a body drawn at random, the largest body is sought: of point masses on a grid of some
thousand places in the hull, by a linear programme, and of all that a condition admits. Printed is by how much the
latter is larger, as a length, over the bodies of each hull and of all:

- ``hull``: the conditions of `idtool.robot.shapes.Hull`.
- ``corners``: second moments within those of masses at the corners, Sigma_2 ⪯ Σ Lambda_i v_i v_iᵀ with Lambda_i ≥ 0.
- ``ellipsoid``: the exact condition of the least ellipsoid around the hull.
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

FORMS = {"hull": "conditions", "corners": "corners", "ellipsoid": "ellipsoid"}
BODIES = 20
PLACES = 6000
_SMALLEST = 0.05  # of the hull's extent: the grid is too coarse for smaller bodies


def solids() -> dict[str, Array]:
    """Points whose hulls are judged, by name."""
    rng = np.random.default_rng(0)
    angle = np.arange(64) * np.pi / 32
    ball = on_ball(rng, 2000, 3)
    cube = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    found = {
        "tetrahedron": np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 2], [-1, -1, -1]]),
        "cube": cube,
        "octagonal prism": np.array([[np.cos(a), np.sin(a), z] for a in angle[::8] for z in (-1, 1)]),
        "cylinder": np.array([[np.cos(a), np.sin(a), z] for a in angle for z in (-1, 1)]),
        "cone": np.array([[0, 0, 1.5], *([np.cos(a), np.sin(a), 0] for a in angle)]),
        "box with round edges": np.sign(ball) * [1, 0.6, 0.3] + 0.1 * ball,
        "ball": ball,
    }
    return found | {f"{count} random points": rng.normal(size=(count, 3)) for count in (6, 8, 12, 30, 60)}


def beyond(points: Array) -> Mapping[str, list[float]]:
    """By how much the largest body of each form is too large, relatively, for every body drawn."""
    rng = np.random.default_rng(1)
    points = points - points.mean(axis=0)
    points = points / np.ptp(points, axis=0).max()
    hull, true = Hull.around(points), Hull.around(points, max_vertices=len(points))
    corners = np.array(true.vertices)
    places = np.concatenate([corners, true._lattice((true.volume / PLACES) ** (1 / 3))])
    if len(places) > 2 * PLACES:
        places = np.concatenate([corners, rng.choice(places, 2 * PLACES, replace=False)])
    largest = {name: Largest(hull, form) for name, form in FORMS.items()}
    found: dict[str, list[float]] = {name: [] for name in FORMS}
    for _ in range(BODIES):
        com = rng.uniform(0.1, 0.9) * rng.dirichlet(np.full(len(corners), 0.3)) @ corners
        root = rng.normal(size=(3, 3)) * np.exp(0.7 * rng.normal(size=3))
        spread = root @ root.T / np.square(root).sum()
        fits = largest_on_grid(places, com, spread)
        if fits > _SMALLEST:
            for name in FORMS:
                found[name].append(largest[name].size(com, spread) / fits - 1)
    return found


def line(name: str, found: Mapping[str, list[float]]) -> str:
    """Mean, median and nine tenths of each form."""
    figures = (f"{np.mean(x):8.1%} {np.median(x):6.1%} {np.quantile(x, 0.9):6.1%}" for x in found.values())
    return f"{name:22} {len(found['hull']):6} " + " ".join(figures)


def main() -> None:
    """Print the table."""
    cases = solids() | {Path(path).stem: np.asarray(trimesh.load_mesh(path).vertices) for path in sys.argv[1:]}
    print(f"{'':29} " + " ".join(f"{name:>8} median   90 %" for name in FORMS))
    total: dict[str, list[float]] = {name: [] for name in FORMS}
    for name, points in cases.items():
        found = beyond(points)
        print(line(name, found), flush=True)
        for form, values in found.items():
            total[form] += values
    print(line("all", total))


if __name__ == "__main__":
    main()
