"""Make the reference of the JSON files, and the JSON schemas, from the types in idtool: ``python docs/reference.py``.

It writes what follows the marker in ``docs/pages/json.md``, and ``docs/pages/schemas/*.schema.json``, of which
``idtool.schema.json`` is the configuration's: editors complete and check a configuration with it.
"""

from __future__ import annotations

import json
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.results.base import Keys, ReadOnly, Record, Result, Vector
from idtool.reporting.results.diagnosis import DiagnosisReport
from idtool.reporting.results.ellipsoids import CheckReport, EllipsoidsReport
from idtool.reporting.results.excitation import ExcitationReport
from idtool.reporting.results.export import ExportReport
from idtool.reporting.results.fit import FitReport
from idtool.reporting.results.inspection import InspectionReport
from idtool.reporting.results.setup import InitReport
from idtool.reporting.results.simulation import SimulationReport
from idtool.reporting.results.study import StudyReport
from idtool.reporting.results.validation import RegressionReport, ValidationReport
from idtool.robot.config import Config

PAGES = Path(__file__).parent / "pages"
PAGE = PAGES / "json.md"
SCHEMAS = PAGES / "schemas"
MARKER = "<!-- What follows is made by docs/reference.py from idtool/reporting/results. -->\n"

RESULTS: dict[str, tuple[type[Result], str]] = {
    "report.json": (FitReport, "Written by `idtool fit`."),
    "validation.json": (ValidationReport, "Written by `idtool validate`."),
    "diagnosis.json": (DiagnosisReport, "Written by `idtool diagnose`."),
    "study.json": (StudyReport, "Written by `idtool study`."),
    "adapt.json": (AdaptationReport, "Written by `idtool adapt`."),
    "inspect": (InspectionReport, "Printed by `idtool inspect --json`."),
    "init": (InitReport, "Printed by `idtool init --json`."),
    "simulate": (SimulationReport, "Printed by `idtool simulate --json`; the motion is in the log that it writes."),
    "excite": (ExcitationReport, "Printed by `idtool excite --json`."),
    "export": (ExportReport, "Printed by `idtool export --json`."),
    "ellipsoids": (EllipsoidsReport, "Printed by `idtool ellipsoids --json`."),
    "ellipsoids --check": (CheckReport, "Printed by `idtool ellipsoids --check --json`."),
    "The regression": (RegressionReport, "Printed by `idtool validate --json` without a URDF."),
}
_PLAIN = {float: "number", int: "integer", str: "text", bool: "true or false", Any: "any", type(None): "null"}


def reference() -> str:
    """The generated part of the page."""
    lines = []
    kinds: dict[str, type[Record]] = {}
    for heading, (result, remark) in RESULTS.items():
        lines += [f"## {heading}", "", remark, "", *_table(result), ""]
        kinds |= {kind.__name__: kind for kind in _nested(result)}
    lines += ["## Types", ""]
    for name, kind in sorted(kinds.items()):
        lines += [f"### {name}", "", (kind.__doc__ or "").strip(), "", *_table(kind), ""]
    return "\n".join(lines).rstrip() + "\n"


def schemas() -> dict[str, str]:
    """The JSON schemas by file name."""
    models = {heading: result for heading, (result, _) in RESULTS.items() if heading.endswith(".json")}
    texts = {f"{name.removesuffix('.json')}.schema.json": model.model_json_schema() for name, model in models.items()}
    texts["idtool.schema.json"] = Config.model_json_schema()
    return {name: json.dumps(schema, indent=2, ensure_ascii=False) + "\n" for name, schema in texts.items()}


def _table(record: type[Record]) -> Iterator[str]:
    """A row for each key of a record."""
    yield "| key | value | meaning |"
    yield "| --- | --- | --- |"
    for name, field in record.model_fields.items():
        annotation = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
        yield f"| `{field.alias or name}` | {_words(annotation)} | {field.description} |"


def _words(annotation: Any) -> str:
    """A type in words."""
    if annotation == Vector:
        return "list of numbers"
    arguments = get_args(annotation)
    if get_origin(annotation) is Annotated:
        keys = next((argument.name for argument in arguments[1:] if isinstance(argument, Keys)), None)
        if keys is None:
            return _words(arguments[0])
        return f"by {keys}: {_words(get_args(arguments[0])[0])}"
    if get_origin(annotation) in (Union, types.UnionType):
        return " or ".join(_words(argument) for argument in arguments)
    if get_origin(annotation) is Literal:
        return " or ".join(f"`{argument}`" for argument in arguments)
    if get_origin(annotation) is tuple:
        inner = [_words(argument) for argument in arguments if argument is not Ellipsis]
        return f"list of {inner[0]}" if Ellipsis in arguments else f"[{', '.join(inner)}]"
    if get_origin(annotation) in (ReadOnly, dict):
        return "object"
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
    return _PLAIN.get(annotation, "list of numbers")


def _nested(annotation: Any) -> Iterator[type[Record]]:
    """The records that a type holds, at any depth."""
    if isinstance(annotation, type) and issubclass(annotation, Record):
        if not issubclass(annotation, Result):
            yield annotation
        for field in annotation.model_fields.values():
            yield from _nested(field.annotation)
    for argument in get_args(annotation):
        yield from _nested(argument)


def main() -> None:
    """Write the page and the schemas."""
    introduction = PAGE.read_text().partition(MARKER)[0]
    PAGE.write_text(introduction + MARKER + "\n" + reference())
    SCHEMAS.mkdir(exist_ok=True)
    for name, text in schemas().items():
        (SCHEMAS / name).write_text(text)


if __name__ == "__main__":
    main()
