"""Messages about unknown keys: the key that was meant, where it belongs, and an example."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from idtool.common.dataclass import dataclass
from idtool.common.names import join_names, printable

_SYNONYMS = {
    "damping": "viscous",
    "height": "length",
    "reflected_inertia": "armature",
    "rotor_inertia": "armature",
    "speed": "velocity",
    "torque": "tau",
}
_NAME, _ITEM = "<name>", "[]"  # in a path: of an entry, which the user chooses; an element of a list
_SIMILAR, _MUCH_ALIKE = 0.5, 0.8  # of keys, from 0 to 1
_BETTER = 0.1  # by which a key elsewhere must be more similar than one of the same section
_MIN_PART = 4  # characters by which a part of a key tells the whole
_MAX_EXAMPLE = 90  # characters
_MAX_LISTED = 10

Path = tuple[str, ...]


class UnknownKeyError(ValueError):
    """An unknown key in a record.

    Parameters
    ----------
    record
        Class of the record.
    key, value
        The key, and what the user gave for it.
    free_keys
        Key of the record under which any keys may stand; empty: there is none.
    """

    def __init__(self, record: type[BaseModel], key: str, value: Any, free_keys: str = "") -> None:
        super().__init__(f"unknown key '{key}'")
        self.record = record
        self.key = key
        self.value = value
        self.free_keys = free_keys


@dataclass(frozen=True)
class _Place:
    """Place of a key in a configuration: path of the record that holds it, class of the record, and key."""

    parent: Path
    record: type[BaseModel]
    key: str

    @property
    def path(self) -> Path:
        return (*self.parent, self.key)

    @property
    def depth(self) -> int:
        return sum(part != _ITEM for part in self.parent)

    @property
    def section(self) -> str:
        """The record in words, such as ``rotors.<name>.inertial``."""
        parts = [part for part in self.parent if part != _ITEM]
        while parts and parts[-1] == _NAME:
            parts.pop()
        return ".".join(parts)


def unknown_key_message(root: type[BaseModel], error: UnknownKeyError, example: str) -> str:
    """Message about an unknown key, one line.

    Parameters
    ----------
    root
        Class of the whole configuration.
    error
        The unknown key.
    example
        A configuration with every key, YAML; empty: there is none.
    """
    places = _places(root)
    own_places = [place for place in places if place.record is error.record]
    elsewhere = [place for place in places if place.key not in error.record.model_fields]
    key = _SYNONYMS.get(error.key, error.key)
    similarity_here, closest_here = _closest(key, list(error.record.model_fields))
    similarity, closest = _closest(key, [place.key for place in elsewhere])
    unknown = f"unknown key '{printable(error.key)}'"

    if error.free_keys and similarity_here < _MUCH_ALIKE:
        holders = [place for place in own_places if place.key == error.free_keys]
        example_text = _example(root, holders, example, {error.key: error.value})
        return f"{printable(error.key)} belongs under {error.free_keys}{_after(': ', example_text)}"

    is_misplaced = similarity == 1.0 and similarity_here < _MUCH_ALIKE + _BETTER
    if is_misplaced or (similarity >= _MUCH_ALIKE and similarity > similarity_here + _BETTER):
        nearest = _nearest([place for place in elsewhere if place.key == closest], own_places)
        sections = _alternatives([place.section for place in nearest])
        where = f"under {sections}" if sections else "at the top level"
        example_text = _example(root, nearest, example, error.value)
        if {place.parent for place in nearest} & {place.parent for place in own_places}:
            return f"{unknown}: it is a key of another kind{_after(', as in ', example_text)}"
        if is_misplaced and key == error.key:
            return f"{key} belongs {where}{_after(': ', example_text)}"
        return f"{unknown}; did you mean '{closest}' {where}?{_after(' Write ', example_text)}"

    if similarity_here >= _SIMILAR:
        meant = [place for place in own_places if place.key == closest_here]
        example_text = _example(root, meant, example, error.value)
        return f"{unknown}; did you mean '{closest_here}'?{_after(' Write ', example_text)}"
    available = join_names(list(error.record.model_fields), _MAX_LISTED)
    example_text = _example(root, [place for place in own_places if place.parent], example)
    return f"{unknown}; available: {available}{_after('; for example ', example_text)}"


def _after(words: str, text: str) -> str:
    """The text after some words; nothing if it is empty."""
    return f"{words}{text}" if text else ""


def _alternatives(names: Sequence[str]) -> str:
    """Names in words: "a, b or c"."""
    *first, last = dict.fromkeys(names)
    return f"{', '.join(first)} or {last}" if first else last


def missing_name_message(root: type[BaseModel], record: str, key: Any, example: str) -> str | None:
    """Message about a key of an entry where the entry's name should be; None: it is no such key.

    Parameters
    ----------
    root
        Class of the whole configuration.
    record
        Name of the class of the entry.
    key
        What is in the place of the name.
    example
        A configuration with every key, YAML; empty: there is none.
    """
    for place in _places(root):
        if place.record.__name__ == record and place.key == key and place.parent[-1:] == (_NAME,):
            return f"belongs under a name of your choice{_after(': ', _example(root, [place], example))}"
    return None


def _closest(key: str, known: Sequence[str]) -> tuple[float, str]:
    """The most similar of some keys, and its similarity from 0 to 1."""
    similarities = [(_similarity(key, name), name) for name in dict.fromkeys(known)]
    return max(similarities, key=lambda pair: pair[0], default=(0.0, ""))


def _similarity(key: str, name: str) -> float:
    ratio = difflib.SequenceMatcher(None, key, name).ratio()
    part, whole = sorted((key, name), key=len)
    is_part = len(part) >= _MIN_PART and part in whole
    return max(ratio, _MUCH_ALIKE) if is_part else ratio


def _nearest(places: Sequence[_Place], own: Sequence[_Place]) -> list[_Place]:
    """Those of some places that are below the record in which the key stands, or else highest up."""
    parents = {place.parent for place in own}
    below = [place for place in places if any(place.parent[: len(parent)] == parent for parent in parents)]
    candidates = below or list(places)
    depth = min(place.depth for place in candidates)
    return [place for place in candidates if place.depth == depth]


@cache
def _places(root: type[BaseModel]) -> tuple[_Place, ...]:
    """Every key of a configuration, those of the top level first in each section."""
    return tuple(_places_in(root, ()))


def _places_in(annotation: Any, path: Path) -> Iterator[_Place]:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for key in annotation.model_fields:
            yield _Place(path, annotation, key)
        for key, field in annotation.model_fields.items():
            yield from _places_in(field.annotation, (*path, key))
    elif origin is Annotated:
        yield from _places_in(arguments[0], path)
    elif origin in (Union, types.UnionType):
        for argument in arguments:
            yield from _places_in(argument, path)
    elif origin is dict:
        yield from _places_in(arguments[1], (*path, _NAME))
    elif origin is tuple and arguments[-1:] == (Ellipsis,):
        yield from _places_in(arguments[0], (*path, _ITEM))


def _example(root: type[BaseModel], places: Sequence[_Place], example: str, value: Any = None) -> str:
    """The example of the first of some places that it has, in one line of YAML; empty: it has none.

    The user's value takes the place of the example's if it fits.
    """
    data = yaml.safe_load(example) if example else {}
    for place in places:
        names = _names_in(data, place.path)
        if names is not None:
            return _example_at(root, data, place.path, names, value)
    return ""


def _example_at(root: type[BaseModel], data: Any, path: Path, names: Sequence[str | int], value: Any) -> str:
    """The whole entry that holds a key, or as much of it as one line takes."""
    first = next((i + 1 for i, part in enumerate(path) if part in (_NAME, _ITEM)), len(names))
    own_values = [] if value is None or len(repr(value)) > _MAX_EXAMPLE else [value]
    for depth in range(first, len(names) + 1):
        for own_value in own_values:
            branch = _branch(data, names, depth, own_value)
            if len(_one_line(branch)) <= _MAX_EXAMPLE and _is_valid(root, branch):
                return _one_line(branch)
        text = _one_line(_branch(data, names, depth, None))
        if len(text) <= _MAX_EXAMPLE:
            return text
    return _one_line(_branch(data, names, len(names), _first_entry(_value_at(data, names))))


def _value_at(data: Any, names: Sequence[str | int]) -> Any:
    for name in names:
        data = data[name]
    return data


def _first_entry(data: Any) -> Any:
    """The first entry of a list or mapping, as one."""
    if isinstance(data, list):
        return data[:1]
    return dict(list(data.items())[:1]) if isinstance(data, Mapping) else data


def _names_in(data: Any, path: Path) -> list[str | int] | None:
    """A path in the example, with names and numbers of entries that hold all of it; None: the example has it not."""
    if not path:
        return []
    if path[0] == _NAME and isinstance(data, Mapping):
        candidates: list[str | int] = list(data)
    elif path[0] == _ITEM and isinstance(data, list):
        candidates = list(range(len(data)))
    elif isinstance(data, Mapping) and path[0] in data:
        candidates = [path[0]]
    else:
        return None
    for name in candidates:
        rest = _names_in(data[name], path[1:])
        if rest is not None:
            return [name, *rest]
    return None


def _branch(data: Any, names: Sequence[str | int], depth: int, value: Any) -> Any:
    """The example without all that is beside a path, down to a depth; whole below; with another value at the end."""
    if not names:
        return data if value is None else value
    inner = _branch(data[names[0]], names[1:], depth - 1, value)
    if depth <= 0 and isinstance(data, Mapping):
        return {**data, names[0]: inner}
    return [inner] if isinstance(names[0], int) else {names[0]: inner}


def _one_line(data: Any) -> str:
    text = yaml.safe_dump(data, default_flow_style=True, width=float("inf"), sort_keys=False).strip()
    return text.removeprefix("{").removesuffix("}")


def _is_valid(root: type[BaseModel], data: Any) -> bool:
    try:
        root.model_validate(data)
    except ValidationError:
        return False
    return True
