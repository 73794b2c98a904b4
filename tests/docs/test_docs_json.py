"""The reference of JSON files and the JSON schemas are those of the types, and name every command's result."""

from __future__ import annotations

import importlib.util
import re
import sys
from types import ModuleType

import pytest
import typer
from paths import CHECKOUT

from idtool.cli import app

DOCS = CHECKOUT / "docs"
FILES = {"fit": "report.json", "validate": "validation.json", "diagnose": "diagnosis.json"}
FILES |= {"compare": "comparison.json"} | {name: f"{name}.json" for name in ("study", "adapt")}


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    """The script that makes them."""
    spec = importlib.util.spec_from_file_location("reference_of_docs", DOCS / "reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_page_is_that_of_the_types(reference: ModuleType) -> None:
    _, marker, generated = (DOCS / "pages" / "json.md").read_text().partition(reference.MARKER)
    assert marker
    assert generated.lstrip() == reference.reference(), "run python docs/reference.py"


def test_the_schemas_are_those_of_the_types(reference: ModuleType) -> None:
    written = {path.name: path.read_text() for path in (DOCS / "pages" / "schemas").iterdir()}
    assert written == reference.schemas(), "run python docs/reference.py"


def test_every_key_has_a_meaning(reference: ModuleType) -> None:
    rows = re.findall(r"^\| `(.*)` \| (.*) \| (.*) \|$", reference.reference(), re.M)
    assert len(rows) > 300
    assert [key for key, value, meaning in rows if not value or meaning in ("", "None")] == []


def test_every_command_has_a_section() -> None:
    headings = set(re.findall(r"^## (.*)$", (DOCS / "pages" / "json.md").read_text(), re.M))
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    others = {"The regression test", "ellipsoids --check", "Types"}
    assert headings == {FILES.get(name, name) for name in commands} | others
