"""The page of notices, against the codes in the source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from idtool.data.inspection import FaultKind

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "pages" / "notices.md"


def codes_in_source() -> Iterator[str]:
    """First argument of every ``Notice(…)``, where it is a literal."""
    for path in (ROOT / "idtool").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", None) == "Notice" and node.args:
                code = node.args[0]
                if isinstance(code, ast.Constant):
                    assert isinstance(code.value, str)
                    yield code.value


def test_every_code_is_documented_once_and_no_other() -> None:
    documented = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    codes = [code for code in documented if code not in ("problem", "warning", "note")]
    assert len(codes) == len(set(codes))
    assert set(codes) == {*codes_in_source(), *get_args(FaultKind)}
