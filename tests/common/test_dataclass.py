"""Objects of `idtool.common.dataclass` are shown, compared and hashed as those of the standard library."""

import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from idtool.common.dataclass import dataclass


def make(decorate: Callable[[type], type]) -> Any:
    class Point:
        """A point."""

        x: float
        name: str = dataclasses.field(default="", repr=False)
        hits: list[int] = dataclasses.field(default_factory=list, compare=False)

        @property
        def double(self) -> float:
            return 2 * self.x

    return decorate(Point)


@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize("eq", [False, True])
def test_objects_are_shown_and_compared_as_the_standard_library_does(frozen: bool, eq: bool) -> None:
    own = make(dataclass(frozen=frozen, eq=eq))
    standard = make(dataclasses.dataclass(frozen=frozen, eq=eq))
    for made in (own, standard):
        assert (made(1.0) == made(1.0, hits=[3])) is eq
        assert made(1.0) != made(2.0)
        assert made(1.0, "a") != made(1.0, "b")
        assert made(1.0) != (1.0, "", [])
        assert repr(made(1.0, hits=[3])).endswith("Point(x=1.0, hits=[3])")
        assert made(1.0).double == 2.0
        assert dataclasses.replace(made(1.0, "a"), x=3.0) == dataclasses.replace(made(1.0, "a"), x=3.0) or not eq
        assert (made.__hash__ is None) == (eq and not frozen)
    if frozen and eq:
        assert hash(own(1.0)) == hash(own(1.0, hits=[1])) == hash(standard(1.0))


def test_own_methods_stay() -> None:
    @dataclass(frozen=True)
    class Named:
        name: str

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Named) and other.name.lower() == self.name.lower()

        def __hash__(self) -> int:
            return hash(self.name.lower())

        def __repr__(self) -> str:
            return self.name

    assert Named("A") == Named("a")
    assert {Named("A"), Named("a")} == {Named("A")}
    assert repr(Named("A")) == "A"


def test_a_subclass_has_the_fields_of_both_and_differs_from_its_base() -> None:
    @dataclass(frozen=True)
    class Base:
        x: int

    @dataclass(frozen=True, kw_only=True)
    class Derived(Base):
        y: int

    assert Derived(x=1, y=2) == Derived(x=1, y=2)
    assert Derived(x=1, y=2) != Base(x=1)
    with pytest.raises(TypeError):
        Derived(1, 2)  # type: ignore[misc]


@dataclass(frozen=True)
class Pair:
    first: int
    second: list[int] = dataclasses.field(default_factory=list, hash=False)


def test_objects_are_copied_and_pickled() -> None:
    pair = Pair(1, [2])
    for other in (copy.copy(pair), copy.deepcopy(pair), pickle.loads(pickle.dumps(pair))):  # noqa: S301
        assert other == pair
        assert other is not pair


def test_fields_without_hash_may_be_unhashable() -> None:
    assert hash(Pair(1, [2])) == hash(Pair(1, [3]))


@pytest.mark.parametrize("decorator", [dataclass, dataclasses.dataclass])
def test_a_frozen_class_with_its_own_equality_is_hashed_by_its_fields(decorator: Any) -> None:
    @decorator(frozen=True)
    class Rounded:
        x: float

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Rounded) and round(self.x) == round(other.x)

    assert Rounded(1.0) == Rounded(1.2)
    assert hash(Rounded(1.0)) == hash(Rounded(1.0))


@pytest.mark.parametrize("decorator", [dataclass, dataclasses.dataclass])
def test_a_class_may_say_that_it_has_no_hash(decorator: Any) -> None:
    @decorator(frozen=True)
    class Unhashable:
        x: int
        __hash__ = None  # type: ignore[assignment]

    assert Unhashable(1) == Unhashable(1)
    with pytest.raises(TypeError, match="unhashable"):
        hash(Unhashable(1))


def test_an_object_that_holds_itself_is_shown() -> None:
    @dataclass()
    class Node:
        others: list[Any]

    node = Node([])
    node.others.append(node)
    assert repr(node).endswith("Node(others=[...])")


@pytest.mark.parametrize("decorator", [dataclass, dataclasses.dataclass])
def test_a_subclass_that_is_not_compared_by_its_fields_is_compared_by_those_of_its_base(decorator: Any) -> None:
    @decorator()
    class Base:
        x: int

    @decorator(eq=False)
    class Derived(Base):
        y: int

    assert Derived(1, 2) == Derived(1, 3)
    assert Derived(1, 2) != Derived(2, 2)
