"""The pipeline is the directory listing: who may import whom, and which library is whose."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "idtool"

# Lowest first. A file imports only from files above it; a new file takes its place here.
ORDER = (
    "common",
    "robot",
    "data",
    "dynamics",
    "estimation",
    "excitation",
    "diagnosis",
    "setup",
    "reporting",
    "api",
    "cli",
    "__main__",
)

WALLS = {
    "clarabel": {"conic"},
    "cvxpy": {"backends"},
    "pinocchio": {"dynamics"},
    "mcap": {"logs"},
    "yourdfpy": {"robot", "reading"},
    "typer": {"cli"},
    "rich": {"cli", "terminal", "progress"},
    "trimesh": {"meshes"},
    "coal": {"pieces", "collision_geometry"},
    "rerun": {"rerun_recording"},
}

Described = ast.ClassDef | ast.FunctionDef

FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def module(path: Path) -> str:
    """The file or folder of the package that a path belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path: Path) -> Iterator[str]:
    """Full names of all that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno} imports by a relative name"
            if node.module == "idtool":
                yield from (f"idtool.{alias.name}" for alias in node.names)
            else:
                yield str(node.module)


def name(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def test_every_file_has_its_place_in_the_order() -> None:
    assert sorted(ORDER) == sorted({module(path) for path in FILES})


@pytest.mark.parametrize("path", FILES, ids=name)
def test_a_file_imports_only_from_above(path: Path) -> None:
    above = {module(path), *ORDER[: ORDER.index(module(path))], "__version__"}
    within = {imported.split(".")[1] for imported in imports(path) if imported.startswith("idtool.")}
    assert within <= above


@pytest.mark.parametrize("path", FILES, ids=name)
def test_libraries_stay_behind_their_walls(path: Path) -> None:
    used = {imported.partition(".")[0] for imported in imports(path)}
    places = {part.removesuffix(".py") for part in path.relative_to(PACKAGE).parts}
    trespassing = {library for library in used & set(WALLS) if not places & WALLS[library]}
    assert not trespassing


def test_every_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {re.split(r"[^\w-]", line)[0].lower().replace("_", "-") for line in project["dependencies"]}
    declared |= {re.split(r"[^\w-]", line)[0] for line in project["optional-dependencies"]["rerun"]}
    by_path_file = {"pinocchio": ["pin"], "coal": ["coal"], "rerun": ["rerun-sdk"]}  # behind their back
    distributions = {**by_path_file, **packages_distributions()}
    used = {imported.partition(".")[0] for path in FILES for imported in imports(path)}
    for library in used - set(sys.stdlib_module_names) - {"idtool"}:
        assert {d.lower().replace("_", "-") for d in distributions[library]} & declared, library


@pytest.mark.parametrize("path", FILES, ids=name)
def test_what_is_public_is_described(path: Path) -> None:
    tree = ast.parse(path.read_text())
    public = [node for node in tree.body if isinstance(node, Described) and not node.name.startswith("_")]
    for node in list(public):
        if isinstance(node, ast.ClassDef):
            public += [inner for inner in node.body if isinstance(inner, Described) and not inner.name.startswith("_")]
    assert ast.get_docstring(tree)
    assert not [node.name for node in public if not ast.get_docstring(node)]


def test_help_does_not_wait_for_the_numerics() -> None:
    script = "import sys, idtool.cli; print(*{'numpy', 'scipy', 'cvxpy', 'lxml', 'pydantic'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
