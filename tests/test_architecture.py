"""The package's structure: eleven subpackages, which may import which, and where each library is used."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from idtool.dynamics.effects import effect_types

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "idtool"

# Each subpackage imports only from those above it in this list.
SUBPACKAGES = (
    "common",
    "robot",
    "data",
    "dynamics",
    "estimation",
    "diagnosis",
    "excitation",
    "setup",
    "reporting",
    "api",
    "cli",
)
MAX_IMPORT_CHAIN = 12  # files or folders, each importing the next

LIBRARY_USERS = {
    "clarabel": ("estimation/problem/conic.py",),
    "cvxpy": ("estimation/problem/backends.py",),
    "pinocchio": ("dynamics/simulation/rigid_body_dynamics.py",),
    "mcap": ("data/logs",),
    "typer": ("cli",),
    "rich": ("cli", "reporting/terminal"),
    "trimesh": ("robot/meshes.py",),
    "coal": ("robot/collision_geometry.py",),
    "rerun": ("reporting/rerun_recording.py",),
    "dask": ("common/cluster.py",),
    "distributed": ("common/cluster.py",),
    "upath": ("common/urls.py",),
}

# Where an effect's id stands outside `dynamics/effects`, and why. All else asks the effect.
EFFECTS = PACKAGE / "dynamics" / "effects"
IDS_ELSEWHERE = {
    (
        "data/inspection/motion_findings.py",
        "time_delay",
    ): "a message; data comes before dynamics and can ask none",
    ("data/inspection/motion_findings.py", "torque_gain"): "likewise",
    ("estimation/dataset/imu_delay.py", "imu_delay"): "the code of a notice",
    ("robot/config/example.py", "torque_offset"): "an example for messages; robot comes before dynamics",
    ("robot/config/unknown_keys.py", "rotor_inertia"): "a mistaken key; likewise",
    ("reporting/export/transmissions.py", "rotor_inertia"): "Drake's tag, drake:rotor_inertia",
}

Described = ast.ClassDef | ast.FunctionDef

FRONT_DOORS = (PACKAGE / "__init__.py", PACKAGE / "__main__.py")
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path not in FRONT_DOORS)
FOLDERS = sorted(path.parent for path in PACKAGE.rglob("__init__.py"))


def name(path: Path) -> str:
    """A file's or folder's path within the package."""
    return str(path.relative_to(PACKAGE))


def subpackage(path: Path) -> str:
    """The subpackage that a file is in."""
    return path.relative_to(PACKAGE).parts[0]


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Full names of all modules that a file imports, wherever in it."""
    return tuple(_imports(path))


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno} imports by a relative name"
            for alias in node.names:
                module = f"{node.module}.{alias.name}"
                yield module if file_of(module) else str(node.module)


def file_of(module: str) -> Path | None:
    """The file of a module of the package, or of a folder of it."""
    if module.partition(".")[0] != "idtool":
        return None
    path = ROOT.joinpath(*module.split("."))
    return next((file for file in (path / "__init__.py", path.with_suffix(".py")) if file.exists()), None)


def imported_files(path: Path) -> set[Path]:
    """The package's own files that a file imports."""
    return {file for module in imports(path) if (file := file_of(module)) is not None} - {path}


def imports_between(folder: Path) -> dict[str, set[str]]:
    """For each entry of a folder the other entries of it that it imports."""
    graph: dict[str, set[str]] = {}
    for path in folder.rglob("*.py"):
        if path in (folder / "__init__.py", *FRONT_DOORS):
            continue
        entry = path.relative_to(folder).parts[0]
        within = {file for file in imported_files(path) if file.is_relative_to(folder) and file.parent != folder}
        within |= {file for file in imported_files(path) if file.parent == folder and file.name != "__init__.py"}
        graph.setdefault(entry, set()).update({file.relative_to(folder).parts[0] for file in within} - {entry})
    return graph


def longest_import_chain(graph: Mapping[str, set[str]]) -> int:
    """How many entries the longest chain of imports passes."""
    height: dict[str, int] = {}
    for entry in TopologicalSorter(graph).static_order():
        height[entry] = 1 + max((height[lower] for lower in graph.get(entry, ())), default=0)
    return max(height.values(), default=0)


def test_the_listing_is_the_subpackages() -> None:
    entries = {path.name for path in PACKAGE.iterdir()} - {"__pycache__", "py.typed"}
    assert entries == {*SUBPACKAGES, "__init__.py", "__main__.py"}
    assert len(SUBPACKAGES) <= 12


@pytest.mark.parametrize("path", FILES, ids=name)
def test_a_subpackage_imports_only_from_above(path: Path) -> None:
    above = SUBPACKAGES[: SUBPACKAGES.index(subpackage(path)) + 1]
    imported = imported_files(path)
    assert not imported & set(FRONT_DOORS)
    assert {subpackage(file) for file in imported} <= set(above)


@pytest.mark.parametrize("folder", FOLDERS, ids=name)
def test_no_import_cycle_between_the_entries_of_a_folder(folder: Path) -> None:
    try:
        assert longest_import_chain(imports_between(folder)) <= MAX_IMPORT_CHAIN
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


@pytest.mark.parametrize("path", FILES, ids=name)
def test_libraries_are_used_only_where_listed(path: Path) -> None:
    used = {imported.partition(".")[0] for imported in imports(path)}
    for library in used & LIBRARY_USERS.keys():
        assert any(path.is_relative_to(PACKAGE / user) for user in LIBRARY_USERS[library]), library


def test_every_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {re.split(r"[^\w-]", line)[0].lower().replace("_", "-") for line in project["dependencies"]}
    for extra in ("rerun", "cluster"):
        declared |= {re.split(r"[^\w-]", line)[0] for line in project["optional-dependencies"][extra]}
    by_path_file = {
        "pinocchio": ["pin"],
        "coal": ["coal"],
        "rerun": ["rerun-sdk"],
    }  # found through path files
    distributions = {**by_path_file, **packages_distributions()}
    used = {imported.partition(".")[0] for path in FILES for imported in imports(path)}
    for library in used - set(sys.stdlib_module_names) - {"idtool"}:
        assert {d.lower().replace("_", "-") for d in distributions[library]} & declared, library


def overrides(node: Described) -> bool:
    """Whether a method is marked as one that another class describes."""
    return any(isinstance(mark, ast.Name) and mark.id == "override" for mark in node.decorator_list)


@pytest.mark.parametrize("path", FILES, ids=name)
def test_what_is_public_is_described(path: Path) -> None:
    tree = ast.parse(path.read_text())
    public = [node for node in tree.body if isinstance(node, Described) and not node.name.startswith("_")]
    for node in list(public):
        if isinstance(node, ast.ClassDef):
            inner = [inner for inner in node.body if isinstance(inner, Described) and not inner.name.startswith("_")]
            public += [method for method in inner if not overrides(method)]
    assert ast.get_docstring(tree)
    assert not [node.name for node in public if not ast.get_docstring(node)]


def test_help_does_not_import_the_numerical_libraries() -> None:
    script = "import sys, idtool.cli; print(*{'numpy', 'scipy', 'cvxpy', 'lxml', 'pydantic'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


# Libraries and parts of the package that a fit of the leg does not need; with --quick, more of them.
NEVER_IMPORTED = {
    *("scipy.signal", "scipy.stats", "scipy.ndimage", "scipy.interpolate", "scipy.integrate"),
    *("trimesh", "networkx", "shapely", "PIL", "yourdfpy", "urllib.request", "mcap.writer"),
    *("plotly.graph_objects", "cvxpy", "mujoco", "idtool.diagnosis.diagnose", "idtool.reporting.results.validation"),
}
IMPORTED_FOR_SIMULATION_AND_CHECKS = {
    *("pinocchio", "coal", "scipy.optimize", "scipy.spatial", "scipy.fft"),
    *("idtool.data.inspection", "idtool.diagnosis.data_faults", "idtool.diagnosis.residual_maps"),
}


@pytest.mark.parametrize(
    ("options", "unneeded"),
    [(["--quick"], NEVER_IMPORTED | IMPORTED_FOR_SIMULATION_AND_CHECKS), ([], NEVER_IMPORTED)],
    ids=["quick", "full"],
)
def test_a_fit_does_not_import_what_it_does_not_need(tmp_path: Path, options: list[str], unneeded: set[str]) -> None:
    """Imports are most of the time of a short fit; copies of the process are counted too."""
    samples = ROOT / "sample_logs"
    logs = [str(samples / "leg_train.mcap"), "--validate", str(samples / "leg_validate.mcap")]
    command = ["fit", str(samples / "leg.urdf"), *logs, "--quiet", *options]
    script = (
        "import sys\n"
        "class Imports:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        print(name, file=sys.stderr, flush=True)\n"
        "sys.meta_path.insert(0, Imports())\n"
        "from idtool.cli import main\n"
        "main()\n"
    )
    arguments = [sys.executable, "-c", script, *command, "--out", str(tmp_path)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    imported = set(done.stderr.split())
    assert "numpy" in imported
    assert imported & unneeded == set()
    assert (tmp_path / "report.html").is_file()


def strings(path: Path) -> Iterator[str]:
    """All strings of a file but docstrings: those of a Python file, or the text of another."""
    if path.suffix != ".py":
        yield path.read_text()
        return
    tree = ast.parse(path.read_text())
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.value


def names_effect(text: str, effect: str) -> bool:
    """Whether a text has an effect's id: one that is a plain word counts where the text is nothing else, or quoted."""
    if "_" in effect:
        return re.search(rf"\b{effect}\b", text) is not None
    return text == effect or re.search(rf"""["'`]{effect}["'`]""", text) is not None


def test_no_effect_is_known_outside_its_folder() -> None:
    known = {
        (name(path), effect)
        for path in PACKAGE.rglob("*")
        if path.suffix in (".py", ".html", ".js", ".css") and not path.is_relative_to(EFFECTS)
        for text in strings(path)
        for effect in effect_types()
        if names_effect(text, effect)
    }
    assert known == IDS_ELSEWHERE.keys()


@pytest.mark.parametrize("path", FILES, ids=name)
def test_no_effect_is_imported_outside_its_folder(path: Path) -> None:
    if path.is_relative_to(EFFECTS):
        return
    modules = {kind.__module__ for kind in effect_types().values()}
    classes = {kind.__name__ for kind in effect_types().values()}
    assert not modules & set(imports(path))
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("idtool.dynamics.effects"):
            assert not classes & {alias.name for alias in node.names}
