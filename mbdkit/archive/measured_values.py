"""Values of the measures of a run, and their units: the attribute ``measures`` of an archive."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

from mbdkit.archive.read_only_dict import ReadOnlyDict


class MeasuredValues(ReadOnlyDict[str, float]):
    """Values of measures by name; nan where one is undefined.

    Parameters
    ----------
    values
        Values by name, each in its unit.
    units
        Units by name.
    reasons
        Why a value could not be taken, by name.
    """

    def __init__(
        self, values: Mapping[str, float], units: Mapping[str, str], reasons: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(values)
        self.units: ReadOnlyDict[str, str] = ReadOnlyDict(units)
        self.reasons: ReadOnlyDict[str, str] = ReadOnlyDict(reasons or {})

    @classmethod
    def from_json(cls, text: str) -> MeasuredValues:
        """Return the values in the attribute of an archive.

        Raises
        ------
        ValueError
            The text is not such an attribute.
        """
        found = json.loads(text)
        try:
            values = {name: math.nan if one["value"] is None else float(one["value"]) for name, one in found.items()}
            units = {name: str(one["unit"]) for name, one in found.items()}
            reasons = {name: str(one["reason"]) for name, one in found.items() if "reason" in one}
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError("the attribute measures has no values and units by name") from error
        return cls(values, units, reasons)

    def to_dict(self) -> dict[str, dict[str, float | str | None]]:
        """Return value, unit and, where it failed, reason of each measure; values that are not finite become None."""
        found: dict[str, dict[str, float | str | None]] = {}
        for name, value in self.items():
            found[name] = {"value": value if math.isfinite(value) else None, "unit": self.units[name]}
            if name in self.reasons:
                found[name]["reason"] = self.reasons[name]
        return found

    def to_json(self) -> str:
        """Return the attribute of an archive."""
        return json.dumps(self.to_dict(), ensure_ascii=False, allow_nan=False)
