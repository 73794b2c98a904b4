"""An arm in MuJoCo on a fixed base that is pushed at its hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_arm import COULOMB, JOINTS, LINKS, SENSOR, Push, urdf_text, wrench_channels, write_log

import idtool
from idtool.common.exceptions import ConfigError, LogError

SIDEWAYS = (9.81 * 0.6, 0.0, -9.81 * 0.8)  # gravity of an arm that is mounted on a slope
TRUE_MASS = {link.name: link.mass for link in LINKS}
PUSH = Push(np.array([12.0, -8.0, 15.0, 0.5, 0.8, -0.6]), np.array([0.2, 0.01, 0.03]))
FORCE = Push(np.array([12.0, -8.0, 15.0, 0.0, 0.0, 0.0]), PUSH.point)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm")
    no_offset = np.zeros(6)
    write_log(path / "free.csv", 8.0, no_offset, seed=5, gravity=SIDEWAYS)
    write_log(path / "pushed.csv", 10.0, no_offset, push=PUSH, gravity=SIDEWAYS)
    write_log(path / "touched.csv", 10.0, no_offset, push=FORCE, gravity=SIDEWAYS)
    lighter = urdf_text()
    for mass in TRUE_MASS.values():
        lighter = lighter.replace(f'mass value="{mass}"', f'mass value="{0.8 * mass:g}"')
    (path / "prior.urdf").write_text(lighter)
    (path / "arm.urdf").write_text(urdf_text())
    return path


def measured(frame: str, **changes: Any) -> dict[str, Any]:
    """The push, measured along the axes of the base or of the hand."""
    channels = wrench_channels("base" if frame == "world" else "hand")
    wrench = {"force": channels[:3], "moment": channels[3:]}
    return {
        "name": "tool",
        "link": "hand",
        "kind": "surface",
        "frame": frame,
        "point": [*PUSH.point],
        **wrench,
        **changes,
    }


UNKNOWN = {"name": "tool", "link": "hand", "point": [*PUSH.point], "flag": "contact_tool", "widen": 0.01}


def model_of(folder: Path, *contacts: Mapping[str, Any], urdf: str = "prior.urdf", **config: Any) -> idtool.Model:
    ellipsoids = {link.name: [{"center": [0.1, 0, 0.05], "semi_axes": [0.3, 0.2, 0.2]}] for link in LINKS}
    settings = {"gravity": SIDEWAYS, "contacts": list(contacts), "bounding_ellipsoids": ellipsoids, **config}
    return idtool.Model(folder / urdf, config=settings)


def error_without_push(folder: Path, model: idtool.Model, log: str, out: str) -> tuple[float, idtool.FitResult]:
    """Torque error of the model that was fitted to a log, in a log without a push [N·m], and the fit."""
    result = idtool.fit(model, folder / log, quick=True)
    result.save(folder / out)
    identified = idtool.Model(folder / out / "identified.urdf", config=folder / out / "model.yaml")
    free = idtool.Model(identified.path, config={**identified.settings.model_dump(exclude_unset=True), "contacts": []})
    return idtool.validate(free, folder / "free.csv", simulation=False).rms.model["overall"], result


if __name__ == "__main__":
    import sys, time

    f = Path("/tmp/h/6/arm")
    f.mkdir(exist_ok=True)

    class T:
        def mktemp(self, n):
            return f

    folder.__wrapped__(T()) if not (f / "touched.csv").exists() else None
    for name, log, contacts in [
        ("free", "free.csv", []),
        ("link", "pushed.csv", [measured("link")]),
        ("world", "pushed.csv", [measured("world")]),
        ("none", "pushed.csv", []),
        ("unknown", "touched.csv", [UNKNOWN]),
        ("nounknown", "touched.csv", []),
    ]:
        t0 = time.time()
        e, r = error_without_push(f, model_of(f, *contacts), log, name)
        print(
            name,
            e,
            [r.friction[j].coulomb for j in JOINTS],
            r.rms.validation,
            r.bodies["hand"].mass * np.array(r.bodies["hand"].com),
            r.simulation and r.simulation.to_dict() if False else None,
            [n.code for n in r.notices],
            time.time() - t0,
        )
