"""The section `tolerances` of a study: how far numbers of its base may deviate."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import value_text
from mbdkit.base.units import Unit, read_quantity
from mbdkit.spec.sections import Section
from mbdkit_studies.spec.value_sets import NUMBER


def _check_size(given: object) -> Any:
    """Check the size of a deviation and return it unchanged."""
    value, unit = _quantity(given)
    if unit is not None and unit.si == "1":
        raise SpecError(f"should be a size in the unit of the number, not {value_text(given)}")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise SpecError(f"should be a number from 0 on, such as 0.001 or '1 mm', not {value_text(given)}")
    return given


def _quantity(given: Any) -> tuple[Any, Unit | None]:
    """Return a size in SI units, and its unit."""
    return read_quantity(given) or (given, None)


Deviation = Annotated[Any, BeforeValidator(_check_size), WithJsonSchema(NUMBER)]


class Tolerance(Section):
    """How far a number may deviate from its value in the base."""

    plus: Deviation = 0.0
    """Largest amount by which the number may exceed its value, such as `0.1 mm`."""
    minus: Deviation = 0.0
    """Largest amount by which the number may fall below its value, such as `0.1 mm`."""

    @model_validator(mode="after")
    def _consistent(self) -> Tolerance:
        if not any(self.limits):
            raise SpecError("needs `plus` or `minus` above 0")
        if len({unit and unit.si for value, unit in map(_quantity, (self.plus, self.minus)) if value}) > 1:
            raise SpecError("`plus` and `minus` should have units of the same kind, or none")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest deviation, in SI units."""
        return -float(_quantity(self.minus)[0]), float(_quantity(self.plus)[0])

    @property
    def unit(self) -> str:
        """SI unit; empty for plain numbers."""
        return next((unit.si for _, unit in map(_quantity, (self.plus, self.minus)) if unit), "")
