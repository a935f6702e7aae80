"""Values of the measures of a run, and the integrals and extrema on which they depend, as attributes of an archive."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.base.plain_data import json_data

#: Integrals over time of numbers or vectors, and extrema, by expression, in SI units; nan where undefined.
Integrals = Mapping[str, float | tuple[float, ...]]


#: Values of expressions in comparison runs, in SI units, for error estimates; nan where unknown.
#:
#: Each expression has its values in two runs of increasing accuracy and in one run of another method.
ComparedMeasures = Mapping[str, tuple[float, ...]]


def compared_json(compared: ComparedMeasures) -> str:
    """Return the attribute ``compared_measures`` of the group ``/accuracy``."""
    return json.dumps({text: [*map(_finite, x)] for text, x in compared.items()}, ensure_ascii=False)


def compared_from_json(text: str) -> ComparedMeasures:
    """Return the values in the attribute ``compared_measures``; raise ValueError if the text is not valid."""
    try:
        return {name: tuple(map(_number, x)) for name, x in json_data(text).items()}
    except (AttributeError, TypeError) as error:
        raise ValueError("the attribute compared_measures has no numbers by name") from error


def integrals_json(integrals: Integrals) -> str:
    """Return the text of the attribute ``integrals``."""
    return json.dumps(
        {name: [*map(_finite, x)] if isinstance(x, tuple) else _finite(x) for name, x in integrals.items()}
    )


def integrals_from_json(text: str) -> Integrals:
    """Return the integrals in the attribute ``integrals``; raise ValueError if the text is not valid."""
    try:
        return {
            name: (_number(x[0]), _number(x[1])) if isinstance(x, list) else _number(x)
            for name, x in json_data(text).items()
        }
    except (AttributeError, IndexError, TypeError) as error:
        raise ValueError("the attribute integrals has no numbers by name") from error


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


class MeasuredValues(ReadOnlyDict[str, float]):
    """Values of measures by name; nan where one is undefined.

    - `values`: values by name, each in its unit.
    - `units`: units by name.
    - `reasons`: why a value could not be computed, by name.
    - `errors`: estimated errors by name, for checked runs and inverse dynamics; nan where unknown.
    - `parameter_errors`: errors by the estimates of parameters by name: bounds of 95 %, nan where unknown and in runs
      without estimates.
    - `remarks`: remarks on values, by name: why the error is unknown although the run was checked, or that recorded
      rows exceed the value.
    """

    def __init__(
        self,
        values: Mapping[str, float],
        units: Mapping[str, str],
        reasons: Mapping[str, str] | None = None,
        errors: Mapping[str, float] | None = None,
        remarks: Mapping[str, str] | None = None,
        parameter_errors: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(values)
        unknown = dict.fromkeys(values, math.nan)
        self.parameter_errors: ReadOnlyDict[str, float] = ReadOnlyDict(unknown | dict(parameter_errors or {}))
        self.errors: ReadOnlyDict[str, float] = ReadOnlyDict(unknown | dict(errors or {}))
        self.units: ReadOnlyDict[str, str] = ReadOnlyDict(units)
        self.reasons: ReadOnlyDict[str, str] = ReadOnlyDict(reasons or {})
        self.remarks: ReadOnlyDict[str, str] = ReadOnlyDict(remarks or {})

    @classmethod
    def from_json(cls, text: str) -> MeasuredValues:
        """Return the values in the attribute ``measures`` of an archive.

        Raises ValueError if the text is not such an attribute.
        """
        measures = json_data(text)
        try:
            values = {name: _number(measure["value"]) for name, measure in measures.items()}
            units = {name: str(measure["unit"]) for name, measure in measures.items()}
            reasons = {name: str(measure["reason"]) for name, measure in measures.items() if "reason" in measure}
            errors, by_parameters = (
                {name: _number(measure[key]) for name, measure in measures.items() if key in measure}
                for key in ("error", "error_by_parameters")
            )
            remarks = {name: str(measure["remark"]) for name, measure in measures.items() if "remark" in measure}
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError("the attribute measures has no values and units by name") from error
        return cls(values, units, reasons, errors, remarks, by_parameters)

    def to_dict(self) -> dict[str, dict[str, float | str | None]]:
        """Return value, unit and, where available, estimated errors, reason of failure and remark of each measure.

        Values that are not finite become None.
        """
        values: dict[str, dict[str, float | str | None]] = {}
        for name, value in self.items():
            values[name] = {"value": _finite(value), "unit": self.units[name]}
            for key, errors in (("error", self.errors), ("error_by_parameters", self.parameter_errors)):
                if not math.isnan(errors[name]):
                    values[name][key] = _finite(errors[name])
            for key, texts in (("reason", self.reasons), ("remark", self.remarks)):
                if name in texts:
                    values[name][key] = texts[name]
        return values

    def to_json(self) -> str:
        """Return the text of the attribute ``measures``."""
        return json.dumps(self.to_dict(), ensure_ascii=False, allow_nan=False)
