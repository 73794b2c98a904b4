"""`dataclass`, like that of the standard library, but made several times as fast.

The standard library's decorator compiles up to six methods for each class. For hundreds of classes, that took a fifth
of the time of a short fit. This one compiles ``__init__`` only.

Objects of a frozen class can be hashed. That they do not change is left to the type checker. Other options than those
below are refused. A frozen class of the standard library cannot derive from a class that is made here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass

Class = TypeVar("Class", bound=type)

if not TYPE_CHECKING:

    def dataclass(
        cls: Class | None = None, *, frozen: bool = False, eq: bool = True, repr: bool = True, kw_only: bool = False
    ) -> Class | Callable[[Class], Class]:
        """Class with ``__init__``, ``__repr__`` and comparison by its fields.

        Parameters
        ----------
        cls
            The class; None: return the decorator.
        frozen
            True if objects do not change, so that they can be hashed.
        eq
            False if an object is equal to itself only.
        repr
            False to leave ``__repr__`` as it is.
        kw_only
            True if all fields are given by name.
        """

        def decorate(cls: Class) -> Class:
            if cls.__doc__ is None:
                cls.__doc__ = cls.__name__  # else the standard library makes a signature for it, which takes long
            dataclasses.dataclass(eq=False, repr=False, kw_only=kw_only)(cls)
            fields = dataclasses.fields(cls)
            compared = [field.name for field in fields if field.compare]
            hashed = [field.name for field in fields if (field.compare if field.hash is None else field.hash)]
            defined = set(vars(cls))
            if "__eq__" in defined and cls.__hash__ is None:
                defined.remove("__hash__")  # set by Python itself
            if repr and "__repr__" not in defined:
                cls.__repr__ = _repr_of([field.name for field in fields if field.repr])
            if eq and "__hash__" not in defined:
                cls.__hash__ = _hash_of(hashed) if frozen else None
            if eq and "__eq__" not in defined:
                cls.__eq__ = _equality_of(compared)
            return cls

        return decorate if cls is None else decorate(cls)


def _repr_of(names: Sequence[str]) -> Callable[[Any], str]:
    """A ``__repr__`` that shows some fields."""

    @recursive_repr()
    def __repr__(self: Any) -> str:  # noqa: N807
        shown = [f"{name}={getattr(self, name)!r}" for name in names]
        return f"{type(self).__qualname__}({', '.join(shown)})"

    return __repr__


def _equality_of(names: Sequence[str]) -> Callable[[Any, object], bool]:
    """An ``__eq__`` that compares some fields of objects of the same class."""

    def __eq__(self: Any, other: object) -> bool:  # noqa: N807
        if other.__class__ is not self.__class__:
            return NotImplemented
        return _values(self, names) == _values(other, names)

    return __eq__


def _hash_of(names: Sequence[str]) -> Callable[[Any], int]:
    """A ``__hash__`` of some fields."""

    def __hash__(self: Any) -> int:  # noqa: N807
        return hash(_values(self, names))

    return __hash__


def _values(instance: object, names: Sequence[str]) -> tuple[object, ...]:
    return tuple([getattr(instance, name) for name in names])
