"""Notebooks, run as a kernel would do it, but without one: their cells in order, and what each shows."""

from __future__ import annotations

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any

FIGURE = "application/vnd.plotly.v1+json"


def read_notebook(path: Path) -> dict[str, Any]:
    """A notebook's content."""
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def write_notebook(path: Path, notebook: dict[str, Any]) -> None:
    """Write a notebook as Jupyter does."""
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")


def run_notebook(notebook: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The notebook with the outputs that it has when it is run in a folder."""
    names: dict[str, Any] = {}
    cells = []
    count = 0
    with contextlib.chdir(folder):
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                count += 1
                outputs = _run_cell("".join(cell["source"]), names, count)
                cell = cell | {"execution_count": count, "outputs": outputs}
            cells.append(cell)
    return notebook | {"cells": cells}


def output_texts(cell: dict[str, Any]) -> dict[str, str]:
    """The texts of a cell's outputs, by their kind: ``stdout``, ``text/plain``, ``text/html``."""
    texts: dict[str, str] = {}
    for output in cell.get("outputs", []):
        if output["output_type"] == "stream":
            texts[output["name"]] = "".join(output["text"])
        else:
            data = output["data"]
            texts |= {kind: "".join(text) for kind, text in data.items() if kind.startswith("text/")}
    return texts


def _run_cell(source: str, names: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """The outputs of a cell: what it prints, and the value of the expression at its end."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    value = None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)  # noqa: S102  # our own notebooks
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # noqa: S307
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"name": "stdout", "output_type": "stream", "text": _lines(printed.getvalue())})
    if value is not None:
        shown = {"data": _shown(value), "execution_count": count, "metadata": {}, "output_type": "execute_result"}
        outputs.append(shown)
    return outputs


def _shown(value: Any) -> dict[str, Any]:
    """The forms of a value that a notebook stores."""
    if hasattr(value, "to_plotly_json"):
        return {FIGURE: json.loads(value.to_json())}
    forms = {"text/plain": _lines(repr(value))}
    if hasattr(value, "_repr_html_"):
        forms = {"text/html": _lines(value._repr_html_()), **forms}
    return forms


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)
