"""A new effect is one file, the one in the documentation, in every command that concerns it; nothing else knows of it.

The logs are of a pendulum with such a spring, simulated here by scipy.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import idtool
from doc_pages import PAGES, blocks
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from idtool.dynamics import effects
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.init_trial import InitTrial

Array = NDArray[np.float64]

PACKAGE = Path(effects.__file__).parents[2]

STIFFNESS, REST = 0.8, 0.4  # N·m/rad³, rad
MASS, LENGTH, INERTIA, VISCOUS = 1.2, 0.3, 0.05, 0.15  # kg, m, kg·m², N·m·s/rad
SECONDS, RATE = 16.0, 250.0  # s, Hz

URDF = f"""<robot name="pendulum">
<link name="base"/>
<link name="bob"><inertial>
  <origin xyz="0 0 {-LENGTH}"/><mass value="{MASS}"/>
  <inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="0.01" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="swing" type="revolute">
  <parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
  <limit lower="-6" upper="6" effort="50" velocity="50"/>
</joint>
</robot>"""
PLAIN: dict[str, Any] = {"friction": {"viscous": True, "coulomb": False}, "filter": {"cutoff_hz": 20}}
START = {"stiffness": 0.0, "rest_position": REST}


def recorded(path: Path, seed: int) -> Path:
    """A log of the pendulum under a sum of sines, with noise."""
    rng = np.random.default_rng(seed)
    hertz = np.array([0.11, 0.23, 0.41, 0.73, 1.3, 2.1])
    size = np.array([2.5, 2.0, 1.5, 1.2, 1.0, 1.0])
    phase = rng.uniform(0, 2 * np.pi, len(hertz))

    def torque(t: float) -> float:
        return float(size @ np.sin(2 * np.pi * hertz * t + phase))

    def derivative(t: float, state: Array) -> list[float]:
        q, v = state
        gravity = MASS * 9.81 * LENGTH * np.sin(q)
        spring = STIFFNESS * (q - REST) ** 3
        return [v, (torque(t) - gravity - VISCOUS * v - spring) / (INERTIA + MASS * LENGTH**2)]

    t = np.arange(round(SECONDS * RATE)) / RATE
    q, v = solve_ivp(derivative, (0, SECONDS), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-9).y
    tau = np.array([torque(x) for x in t])
    noise = rng.normal(size=(3, len(t))) * np.array([[1e-5], [1e-3], [1e-2]])
    rows = np.column_stack([t, q + noise[0], v + noise[1], tau + noise[2]])
    np.savetxt(path, rows, delimiter=",", header="t,q_swing,v_swing,tau_swing", comments="", fmt="%.9g")
    return path


@pytest.fixture(scope="module", autouse=True)
def added(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The file is there as if it stood beside the package's own effects."""
    folder = tmp_path_factory.mktemp("effects")
    (example,) = [block for block in blocks(PAGES / "effects.md") if block.language == "python"]
    (folder / "cubic_spring.py").write_text(example.text)
    effects.__path__.append(str(folder))
    effect_types.cache_clear()
    yield
    effects.__path__.remove(str(folder))
    effect_types.cache_clear()
    del sys.modules[f"{effects.__name__}.cubic_spring"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """URDF, configurations without and with the effect, and logs to fit and to compare with."""
    folder = tmp_path_factory.mktemp("pendulum")
    (folder / "pendulum.urdf").write_text(URDF)
    (folder / "plain.yaml").write_text(yaml.safe_dump(PLAIN))
    entry = {"effect": "cubic_spring", "joint": "swing", "parameters": START}
    (folder / "spring.yaml").write_text(yaml.safe_dump({**PLAIN, "effects": [entry]}))
    recorded(folder / "run.csv", 3)
    recorded(folder / "other.csv", 4)
    return folder


@pytest.fixture(scope="module")
def run(folder: Path) -> Callable[..., str]:
    """Runs a command in that folder; what it prints."""

    def runs(*arguments: object) -> str:
        done = idtool(*arguments, folder=folder)
        assert done.code == 0, done.err
        return done.out

    return runs


@pytest.fixture(scope="module")
def fitted(run: Callable[..., str]) -> Path:
    """Folders of fits without and with the effect."""
    for name in ("plain", "spring"):
        printed = run("fit", "pendulum.urdf", "run.csv", "--config", f"{name}.yaml", "--out", name)
        assert ("stiffness" in printed) == (name == "spring")
    return Path()


def only(entries: list[dict[str, Any]], **wanted: object) -> dict[str, Any]:
    """The entry that has these values."""
    (entry,) = [one for one in entries if wanted.items() <= one.items()]
    return entry


def test_nothing_else_knows_of_it() -> None:
    for path in PACKAGE.rglob("*.py"):
        assert "cubic_spring" not in path.read_text(), path


def test_it_is_fitted_and_reported_with_its_unit(folder: Path, fitted: Path) -> None:
    report = json.loads((folder / fitted / "spring" / "report.json").read_text())
    spring = only(report["base_parameters"]["parameters"], name="swing stiffness")
    assert spring["unit"] == "N·m/rad³"
    assert spring["value"] == pytest.approx(STIFFNESS, rel=1e-2)
    assert "swing stiffness" in (folder / fitted / "spring" / "report.html").read_text()

    (effect,) = report["effects"]
    assert (effect["effect"], effect["joint"], effect["link"]) == ("cubic_spring", "swing", None)
    assert effect["parameters"] == {"stiffness": pytest.approx(STIFFNESS, rel=1e-2), "rest_position": REST}
    assert effect["standard_error"]["stiffness"] == pytest.approx(spring["standard_error"])
    assert effect["standard_error"]["rest_position"] is None
    assert effect["units"] == {"stiffness": "N·m/rad³", "rest_position": "rad"}

    (entry,) = yaml.safe_load((folder / fitted / "spring" / "model.yaml").read_text())["effects"]
    assert entry["parameters"]["stiffness"]["value"] == pytest.approx(STIFFNESS, rel=1e-2)
    assert entry["parameters"]["stiffness"]["standard_error"] < 0.01
    assert entry["parameters"]["rest_position"] == REST


def test_it_is_named_by_diagnose_in_its_own_words(folder: Path, run: Callable[..., str]) -> None:
    printed = run("diagnose", "pendulum.urdf", "run.csv", "--config", "plain.yaml", "--out", "diagnosed")
    report = json.loads((folder / "diagnosed" / "diagnosis.json").read_text())
    (step,) = report["steps"]
    assert (step["effect"], step["joint"]) == ("cubic_spring", "swing")
    assert step["parameters"] == pytest.approx({"stiffness": STIFFNESS, "rest_position": REST}, rel=1e-2)
    assert step["units"] == {"stiffness": "N·m/rad³", "rest_position": "rad"}

    page = (folder / "diagnosed" / "diagnosis.html").read_text()
    for text in (" ".join(printed.split()), page):
        assert "The original model lacks a cubic spring on swing" in text
        assert re.search(r"A spring that stiffens acts across the joint \(stiffness 0\.(8|79)", text)
        assert "N·m/rad³, rest position 0." in text
    assert "Cubic spring on swing" in page
    (entry,) = yaml.safe_load((folder / "diagnosed" / "model.yaml").read_text())["effects"]
    assert entry["effect"] == "cubic_spring"


def test_it_is_simulated(fitted: Path, run: Callable[..., str]) -> None:
    errors = {}
    for name in ("plain", "spring"):
        printed = run("simulate", fitted / name / "identified.urdf", "other.csv", "--out", f"{name}.csv", "--json")
        errors[name] = json.loads(printed)["rmse"]["position"]["swing"]
    assert errors["spring"] < 0.02 * errors["plain"]


@pytest.mark.parametrize("to", ["mujoco", "drake"])
def test_export_says_that_simulators_do_not_carry_it(fitted: Path, run: Callable[..., str], to: str) -> None:
    report = json.loads(run("export", fitted / "spring", "--to", to, "--json"))
    part = only(report["not_carried"], what="cubic_spring")
    assert part["of"] == "swing"
    assert (part["value"], part["unit"]) == (pytest.approx(STIFFNESS, rel=1e-2), "N·m/rad³")
    assert "cubic_spring" not in {one["what"] for one in report["carried"]}


def test_init_tries_it_if_it_says_so(folder: Path, run: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    run("init", "pendulum.urdf", "run.csv", "--out", "untried.yaml")
    assert "cubic_spring" not in (folder / "untried.yaml").read_text()

    words = InitTrial(name="a cubic spring", heading="stiffening spring", comment="{value}, the hose")
    monkeypatch.setattr(effect_types()["cubic_spring"], "init_trial", words)
    report = json.loads(run("init", "pendulum.urdf", "run.csv", "--out", "tried.yaml", "--json"))
    trial = only(report["trials"], effect="cubic_spring", joint="swing")
    assert trial["kept"]
    assert any(line.startswith("stiffening spring: swing ") for line in report["found"])
    text = (folder / "tried.yaml").read_text()
    assert "N·m/rad³, the hose: " in text
    entry = only(yaml.safe_load(text)["effects"], effect="cubic_spring")
    assert entry["parameters"].keys() == {"stiffness", "rest_position"}
