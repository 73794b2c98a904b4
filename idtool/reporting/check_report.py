"""The record of a check of a URDF's inertials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.estimation.problem.link_check import LinkCheck
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.ellipsoids import CheckedLink, CheckReport, RepairedLink
from idtool.robot.inertia import mass_com_inertia, symmetric_entries
from idtool.robot.urdf.reading import Robot


def check_report(robot: Robot, checks: Sequence[LinkCheck], nearest: Mapping[str, Array]) -> CheckReport:
    """The content that `idtool ellipsoids --check` prints as JSON.

    Parameters
    ----------
    robot
        From the URDF.
    checks
        Its links.
    nearest
        Inertials that some body can have, for those that none can, shape (10,) each.
    """
    links = {}
    for link in checks:
        name, pi = link.body.name, link.body.pi
        links[name] = CheckedLink(
            mass=float(pi[0]),
            violations=link.violations,
            nearest=_repaired_link(pi, nearest[name]) if name in nearest else None,
        )
    notices = [
        Notice("not_realizable", "problem", link.body.name, violation)
        for link in checks
        for violation in link.violations
    ]
    return CheckReport(links=links, urdf=str(robot.path), **notice_fields(notices))


def _repaired_link(pi: Array, nearest: Array) -> RepairedLink:
    mass, com, inertia = mass_com_inertia(nearest)
    before = mass_com_inertia(pi)[2]
    change = 0.0
    if before.any():
        change = float(np.abs(inertia - before).max() / np.abs(before).max())
    return RepairedLink(mass=mass, com=com.tolist(), inertia_com=symmetric_entries(inertia).tolist(), moved=change)
