"""Results made of plain data in which only what a test is about is given."""

from __future__ import annotations

from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import numpy as np

from idtool.reporting.results.base import ReadOnly, Record, Vector

R = TypeVar("R", bound=Record)
EMPTY: dict[Any, Any] = {tuple: (), ReadOnly: ReadOnly({})}
SCALARS = (bool, int, float, str)


def partial(cls: type[R], data: Any) -> R:
    """A record of plain data, not validated: a field that is not given is None, or empty."""
    if isinstance(data, Record):
        return data  # type: ignore[return-value]
    values = {}
    for name, field in cls.model_fields.items():
        key = field.alias or name
        annotation = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        values[name] = _value(annotation, data[key]) if key in data else _missing(annotation)
    return cls.model_construct(**values)


def _plain(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated and annotation != Vector:
        annotation = get_args(annotation)[0]
    return annotation


def _missing(annotation: Any) -> Any:
    annotation = _plain(annotation)
    return EMPTY.get(get_origin(annotation))


def _value(annotation: Any, value: Any) -> Any:
    """Plain data as a field of a record holds it."""
    annotation = _plain(annotation)
    if annotation == Vector or annotation is np.ndarray or get_origin(annotation) is np.ndarray:
        return np.array([np.nan if x is None else x for x in value], dtype=float)
    if value is None:
        return None
    if get_origin(annotation) in (Union, UnionType):
        (annotation,) = {_plain(a) for a in get_args(annotation)} - {type(None)}
        return _value(annotation, value)
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return partial(annotation, value)
    arguments = get_args(annotation)
    if get_origin(annotation) is ReadOnly:
        return ReadOnly({key: _value(arguments[0], inner) for key, inner in value.items()})
    if get_origin(annotation) is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        if _plain(arguments[0]) in SCALARS:
            return tuple(value)
        return tuple(_value(arguments[0], inner) for inner in value)
    return tuple(value) if get_origin(annotation) is tuple else value
