"""`ellipsoids` and `check`: bounds of a robot's links from their geometry, and the check of their inertias."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.model import Model, Source, as_model
from idtool.api.notebook import Displayable
from idtool.api.results import notice_lines, table_lines
from idtool.common.notice import Notice
from idtool.common.number_text import number
from idtool.common.outputs import as_yaml, check_file, write_all
from idtool.estimation.problem.link_check import check_links, nearest_bodies, repaired
from idtool.reporting.check_report import check_report
from idtool.reporting.results.base import LinkEllipsoid, notice_fields
from idtool.reporting.results.ellipsoids import CheckReport, EllipsoidsReport
from idtool.robot.bounding import bounding_ellipsoids

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output


class EllipsoidsResult(EllipsoidsReport, Displayable):
    """Bounding ellipsoids of a robot's links."""

    _header: str

    @property
    def yaml(self) -> str:
        """The ellipsoids as a part of a configuration."""
        ellipsoids = self.to_json()["bounding_ellipsoids"]
        return as_yaml({"bounding_ellipsoids": ellipsoids}, self._header)

    def save(self, file: str | os.PathLike[str]) -> Path:
        """Write the ellipsoids as YAML; OutputError if the file cannot be written."""
        path = Path(file)
        write_all(path.parent, {path.name: self.yaml})
        return path

    def _show(self, output: Output) -> None:
        output.say(self.yaml.rstrip())
        output.notices(self.notices)

    def __repr__(self) -> str:
        title = f"EllipsoidsResult: {', '.join(self.bounding_ellipsoids)}"
        return "\n".join([title, *notice_lines(self.notices)])


class CheckResult(CheckReport, Displayable):
    """Result of the check: the links whose inertia is not physically realizable."""

    _repaired: bytes

    @property
    def ok(self) -> bool:
        """True if every link has an inertia that a body can have."""
        return not any(link.violations for link in self.links.values())

    def save(self, file: str | os.PathLike[str]) -> Path:
        """Write the nearest URDF with realizable inertias; OutputError if the file cannot be written."""
        path = Path(file)
        check_file(path, [])
        write_all(path.parent, {path.name: self._repaired})
        return path

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.check import show_check

        show_check(output, self, None)

    def __repr__(self) -> str:
        rows = []
        for name, link in self.links.items():
            rows.append([name, number(link.mass), "; ".join(link.violations) or "ok"])
        table = table_lines(["link", "mass [kg]", "inertia"], rows)
        return "\n".join([f"CheckResult {self.urdf}", *table])


def ellipsoids(urdf: Model | Source, *, margin: float = 0.05) -> EllipsoidsResult:
    """Bounding ellipsoids of the links' meshes and primitives; `idtool ellipsoids` as a function.

    Parameters
    ----------
    urdf
        The URDF, or a model.
    margin
        Fraction by which the semi-axes are enlarged.

    Raises
    ------
    IdtoolError
        If the URDF cannot be read.
    """
    robot = urdf.robot if isinstance(urdf, Model) else Model.bare(urdf).robot
    ellipsoids_by_link, reasons = bounding_ellipsoids(robot, margin)
    result = EllipsoidsResult(
        bounding_ellipsoids={
            link: [LinkEllipsoid(**ellipsoid.to_dict())] for link, ellipsoid in ellipsoids_by_link.items()
        },
        **notice_fields([_without_ellipsoid(link, why) for link, why in reasons.items()]),
    )
    enlarged = f"semi-axes enlarged by {100 * margin:.0f} %"
    result._header = f"Smallest ellipsoids around the links of {robot.path.name}, {enlarged}; m, rad."
    return result


def _without_ellipsoid(link: str, reason: str) -> Notice:
    return Notice("no_ellipsoid", "warning", link, f"no ellipsoid; {reason}", "add one under bounding_ellipsoids")


def check(model: Model | Source, *, repair: bool = False) -> CheckResult:
    """Find the links whose inertia is not physically realizable, like `idtool ellipsoids --check`.

    Parameters
    ----------
    model
        The model, or the path of its URDF. The bounds in its configuration are taken into account.
    repair
        Whether to compute the nearest realizable inertias.

    Raises
    ------
    IdtoolError
        If the URDF or the configuration cannot be used.
    """
    model = as_model(model)
    links = check_links(model.robot, model.settings)
    nearest = nearest_bodies(links) if repair else {}
    result = CheckResult.from_result(check_report(model.robot, links, nearest))
    result._repaired = repaired(model.robot, nearest)
    return result
