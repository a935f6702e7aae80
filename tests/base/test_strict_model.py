"""Strict models accept lists for tuples, which JSON and YAML do not have, and convert nothing else."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from mbdkit.base.strict_model import StrictModel


class Ends(StrictModel):
    """Two ends."""

    pair: tuple[float, float]
    names: tuple[str, ...] | None = None


class Strut(StrictModel):
    """A strut with inner ends."""

    ends: list[Ends] | Ends


def test_a_list_is_accepted_for_a_tuple_from_python_as_from_json() -> None:
    given = {"ends": {"pair": [1.0, 2.0], "names": ["a", "b"]}}
    strut = Strut.model_validate(given)
    assert strut.ends == Ends(pair=(1.0, 2.0), names=("a", "b"))
    assert strut == Strut.model_validate_json('{"ends": {"pair": [1, 2], "names": ["a", "b"]}}')


@pytest.mark.parametrize("pair", [[1.0], [1.0, 2.0, 3.0], ["1", 2.0], 1.0, "12", [True, 2.0]])
def test_items_of_another_number_or_type_are_refused(pair: object) -> None:
    with pytest.raises(ValidationError):
        Ends.model_validate({"pair": pair})
