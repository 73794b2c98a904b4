"""The reference pages name every key, effect, parameter, command and option that there is, and no others."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterator
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
import typer
import yaml
from commands import JOINTS, LEG
from doc_pages import PAGES, README, pages
from doc_tables import codes, keys, rows, section
from paths import CHECKOUT
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import idtool as idtool_library
from idtool.cli import app
from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects import JointTerm, effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.robot.config import Config, EffectEntry
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
COMPLETION = {"--install-completion", "--show-completion", "--help"}

REQUIRED = object()


def fields(kind: type[BaseModel], at: str = "") -> Iterator[tuple[str, Any, bool]]:
    """Keys of a record and all within: the path, its default, and whether it is one that holds no others."""
    for name, info in kind.model_fields.items():
        yield from _keys(info.annotation, f"{at}{name}", _default(info))


def _default(info: FieldInfo) -> Any:
    if info.is_required():
        return REQUIRED
    value = info.get_default(call_default_factory=True)
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    return list(value) if isinstance(value, tuple) else value


def _keys(kind: Any, at: str, default: Any) -> Iterator[tuple[str, Any, bool]]:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        yield from _keys(arguments[0], at, default)
    elif origin in (Union, types.UnionType):
        for one in arguments:
            if one is not type(None):
                yield from _keys(one, at, default)
    elif origin is dict:
        yield at, default, False
        yield from _keys(arguments[1], f"{at}.<>", default)
    elif origin is tuple and arguments[-1] is Ellipsis and _holds_records(arguments[0]):
        yield from _keys(arguments[0], f"{at}[]", default)
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        yield at, default, False
        yield from fields(kind, f"{at}.")
    else:
        yield at, default, True


def _holds_records(kind: Any) -> bool:
    return any(at for at, _, _ in _keys(kind, "", None))


def plain(key: str) -> str:
    """A documented key, whatever its placeholders are called."""
    return re.sub(r"<\w+>", "<>", key)


CONFIG = list(fields(Config))


def test_every_key_of_the_configuration_is_documented_and_no_other() -> None:
    text = (PAGES / "config.md").read_text()
    by_joint = {key for row in rows(text) for key in codes(row[4]) if "<joint>." in key}
    documented = {plain(key) for key in {*keys(text), *by_joint}}
    assert {at for at, _, is_key in CONFIG if is_key} - documented == set()
    assert documented - {at for at, _, _ in CONFIG} == set()


def test_the_defaults_of_the_configuration_are_those_documented() -> None:
    defaults: dict[str, list[Any]] = {}
    for at, default, _ in CONFIG:
        defaults.setdefault(at, []).append(default)
    compared = 0
    for row in rows((PAGES / "config.md").read_text()):
        named, stated = codes(row[0]), row[3]
        if len(named) == 1 and "," not in re.sub(r"\[.*\]", "", stated):
            expected = REQUIRED if stated == "required" else yaml.safe_load(codes(stated)[0])
            assert expected in defaults[plain(named[0])], named[0]
            compared += 1
    assert compared > 50


def parameters(effect: str) -> set[str]:
    """Names of an effect's parameters: with one more it says which they are."""
    kind = effect_types()[effect]
    if issubclass(kind, JointEffect):
        return {*kind.linear_parameters(), *(held.name for held in kind.nonlinear_parameters)}
    robot = read_robot(LEG)
    on = {"link": "shank_link"} if issubclass(kind, LinkEffect) else {}
    with pytest.raises(ConfigError, match="needs the parameters") as caught:
        kind.from_entry(EffectEntry(effect=effect, **on), build_model(robot, Config(), JOINTS))
    optional = kind.optional_parameter_names if issubclass(kind, LinkEffect) else ()
    return {*re.findall(r"\w+", str(caught.value).partition("add ")[2]), *optional}


def test_every_effect_is_documented_and_no_other() -> None:
    text = (PAGES / "effects.md").read_text()
    assert set(re.findall(r"^### (\w+)$", text, re.M)) == {*effect_types(), "unknown"}


@pytest.mark.parametrize("effect", sorted(effect_types()))
def test_an_effect_is_documented_with_its_parameters(effect: str) -> None:
    kind = effect_types()[effect]
    said = {row[0]: row[1] for row in rows(section("effects.md", f"### {effect}"))}
    found = [name for what in ("fit finds", "given") for name in codes(said.get(what, ""))]
    assert parameters(effect) == set(found) - {"joint"}
    if issubclass(kind, JointEffect):
        assert set(kind.linear_parameters()) == set(codes(said.get("fit finds", "")))
    assert said["form"]
    assert said["confused with"]
    assert said["shows in"] == kind.excitation_hint


def test_the_classes_and_attributes_of_an_effect_exist() -> None:
    named, own = section("effects.md", "## Adding an effect").split("These attributes and methods are optional")
    for row in rows(own):
        for name in codes(row[0]):
            assert hasattr(JointTerm, name), name
    files = "".join(path.read_text() for path in (CHECKOUT / "idtool" / "dynamics" / "effects").glob("*.py"))
    for row in rows(named):
        for name in codes(row[0]):
            assert f"\nclass {name}(" in files, name


def test_every_command_and_option_is_documented() -> None:
    text = README.read_text() + "".join(page.read_text() for page in pages())
    reference = (PAGES / "commands.md").read_text()
    assert set(re.findall(r"^## (\w+)$", reference, re.M)) == set(COMMANDS)
    for name, command in COMMANDS.items():
        for option in {o for p in command.params if p.param_type_name == "option" for o in p.opts} - COMPLETION:
            assert re.search(rf"{option}\b", reference), f"{name} {option}"
    known = {o for command in COMMANDS.values() for p in command.params for o in p.opts} | COMPLETION | {"--version"}
    named = {word for code in re.findall(r"`(--[\w-]+)[^`]*`", text) for word in [code]}
    lines = [line for line in text.splitlines() if re.match(r"\s*(\.venv/bin/)?idtool ", line)]
    named |= {word for line in lines for word in re.findall(r"(?<=\s)--[\w-]+", line)}
    assert named - known == set()


def test_every_public_name_and_option_is_in_the_python_page() -> None:
    text = (PAGES / "python.md").read_text()
    for name in set(idtool_library.__all__) - {"__version__"}:
        kind = getattr(idtool_library, name)
        assert re.search(rf"\b{name}\b", text) or name.endswith("Result"), name
        if inspect.isfunction(kind) and name != "read_log":
            options = [p.name for p in inspect.signature(kind).parameters.values() if p.kind is p.KEYWORD_ONLY]
            row = next(row for row in rows(text) if f"idtool.{name}" in codes(row[0]))
            assert codes(row[1]) == options
