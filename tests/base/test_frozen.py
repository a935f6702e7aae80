"""Frozen dataclasses with shared methods, against those of the standard library."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mbdkit.base import frozen

MAKERS = [frozen.dataclass, dataclasses.dataclass]


class Plain:
    """A body of classes: a field without a default, one that is neither compared nor shown, and a list."""

    x: int
    hidden: int = dataclasses.field(default=0, compare=False, repr=False)
    inner: Any = None


class Single:
    """A body with one field."""

    x: Any


class WithOwn:
    """A body with its own comparison and text."""

    x: int

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WithOwn)

    def __repr__(self) -> str:
        return "own"


class WithHash:
    """A body with its own hash."""

    x: int

    def __hash__(self) -> int:
        return 5


def _facts(make: Callable[..., Any], body: type, options: dict[str, bool]) -> list[object]:
    made = make(**options)(type("Made", (), dict(vars(body))))
    first, second, third = made(1), made(1), made(2)
    facts: list[object] = [first == second, first == third, first == (1,), repr(first).partition(" object at ")[0]]
    facts += [hash(first) == hash(second) if made.__hash__ else "no hash", made.__match_args__]
    same = np.array([math.nan, 1.0])
    facts += [made(same) == made(same), made(math.nan) == made(math.nan)]
    if body is Plain:
        facts += [made(1, hidden=3) == first, hash(made(1, hidden=3)) == hash(first)] if made.__hash__ else []
        if not options.get("frozen"):
            return facts
        loop: list[object] = []
        loop.append(made(1, inner=loop))
        facts.append(repr(loop[0]).partition(" object at ")[0])
    try:
        first.x = 3
    except dataclasses.FrozenInstanceError as error:
        facts.append(str(error))
    return [*facts, dataclasses.replace(first, x=9) == made(9)]


@pytest.mark.parametrize("body", [Plain, Single, WithOwn, WithHash])
@pytest.mark.parametrize(
    "options",
    [{}, {"frozen": True}, {"frozen": True, "eq": False}, {"frozen": True, "repr": False, "kw_only": False},
     {"frozen": True, "slots": True}],
)  # fmt: skip
def test_a_class_behaves_as_one_of_the_standard_library(body: type, options: dict[str, bool]) -> None:
    ours, standard = (_facts(make, body, options) for make in MAKERS)
    assert ours == standard
