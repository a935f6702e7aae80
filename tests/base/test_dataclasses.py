"""Frozen dataclasses behave like those of the standard library from their first use on."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from dataclasses import FrozenInstanceError, field, fields, replace
from typing import Any

import pytest

from mbdkit.base import dataclasses as own


def classes_of(dataclass: Callable[..., Any]) -> tuple[Any, Any]:
    """Return a class and a subclass of it, which have the same names whoever makes them."""

    @dataclass(frozen=True)
    class Point:
        x: float
        y: float = 0.0
        tags: list[str] = field(default_factory=list, compare=False, repr=False)

    @dataclass(frozen=True, kw_only=True, eq=False)
    class Named(Point):
        name: str = "p"

        def __repr__(self) -> str:
            return self.name

    return Point, Named


_standard = classes_of(dataclasses.dataclass)


@pytest.mark.parametrize(
    "use",
    [
        lambda point, named: point(1.0, tags=["a"]),
        lambda point, named: point(float("nan")) == point(float("nan")),
        lambda point, named: (point(1.0, tags=["a"]) == point(1.0), point(1.0) == point(2.0), point(1.0) == 1.0),
        lambda point, named: hash(point(1.0, 2.0)),
        lambda point, named: (named(1.0, name="q"), named(1.0) == named(1.0), named(1.0) == point(1.0)),
        lambda point, named: [(entry.name, entry.default) for entry in fields(named)],
        lambda point, named: replace(named(1.0), y=3.0).y,
        lambda point, named: (str(inspect.signature(point)), str(inspect.signature(named))),
        lambda point, named: (point.__match_args__, dataclasses.is_dataclass(point), hasattr(point, "tags")),
        lambda point, named: (named(1.0).tags is named(1.0).tags, point.y),
    ],
)
def test_methods_return_what_those_of_the_standard_library_return(use: Callable[[Any, Any], object]) -> None:
    assert repr(use(*classes_of(own.dataclass))) == repr(use(*_standard))


def test_instances_cannot_be_changed() -> None:
    point, _ = classes_of(own.dataclass)
    with pytest.raises(FrozenInstanceError):
        object.__new__(point).x = 1.0
    with pytest.raises(FrozenInstanceError):
        del point(1.0).x


def test_unpickled_instances_compare_before_any_other_instance_is_made() -> None:
    point, _ = classes_of(own.dataclass)
    first, second = object.__new__(point), object.__new__(point)
    for instance in (first, second):  # as `pickle` does
        vars(instance).update(x=1.0, y=2.0)
    assert first == second
    assert hash(first) == hash((1.0, 2.0))
    assert repr(first).endswith("Point(x=1.0, y=2.0)")


def test_a_class_of_the_standard_library_inherits() -> None:
    _, named = classes_of(own.dataclass)

    @dataclasses.dataclass(frozen=True)
    class Coloured(named):  # type: ignore[misc, valid-type]
        colour: str = "red"

    assert Coloured(1.0, 0.0, [], "blue", name="q").colour == "blue"
    assert Coloured(1.0) == Coloured(1.0) != Coloured(1.0, name="r")
