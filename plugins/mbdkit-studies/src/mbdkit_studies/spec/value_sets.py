"""The values of an axis of a study: a list, or equally or geometrically spaced numbers; values may have labels.

A value may also set several keys together, and may be skipped if a distribution is not installed.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import LARGEST_NUMBER, Path, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.units import QUANTITY, Unit, read_quantity

#: Sets with more values are assumed to be mistakes.
LARGEST_SET = 10_000

SPACED = ("geomspace", "linspace")
#: Keys of a value with a label; either `value` or `set` is required.
LABELLED = ("label", "value", "set", "if_installed")
FORMS = "a list of values, {geomspace: [first, last, number]} or {linspace: [first, last, number]}"

#: Significant digits to which spaced numbers are rounded, so that they are identical on all machines.
DIGITS = 12
_DISTRIBUTION = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9])?")
LONGEST_LABEL = 60


@dataclass(frozen=True)
class Value:
    """One value of a set.

    Parameters
    ----------
    value
        Plain data that the key is set to, or a mapping of the dotted keys that are set together.
    label
        Label in tables and figures: the value itself if it is a number or text.
    place
        Indices and keys that lead to the value in its set.
    together
        Whether `value` is a mapping of several dotted keys; the axis then has a name instead of a key.
    if_installed
        Distribution without which the value is skipped; empty if none is needed.
    unit
        SI unit, if the value is written with a unit; empty otherwise.
    """

    value: Any
    label: int | float | str
    place: Path
    together: bool = False
    if_installed: str = ""
    unit: str = ""


def check_values(given: Any) -> Any:
    """Check a value set and return it unchanged.

    Raises
    ------
    SpecError
        If this is not a valid value set. The error has the key within it.
    """
    match given:
        case list():
            if not given:
                raise SpecError("needs at least one value")
            for index, entry in enumerate(given):
                _check_labelled(entry, f"[{index}]")
                _quantity(entry, f"[{index}]")
        case {"geomspace": limits, **others} | {"linspace": limits, **others}:
            kind = next(name for name in SPACED if name in given)
            if others:
                raise SpecError(f"cannot be combined with other keys, such as '{next(iter(others))}'", key=kind)
            _check_limits(kind, limits)
        case Mapping() if len(given) == 1:
            word = str(next(iter(given)))
            raise SpecError(f"unknown key{did_you_mean(word, SPACED)}; the values of an axis are {FORMS}", key=word)
        case _:
            raise SpecError(f"should be {FORMS}, not {value_text(given)}")
    if size(given) > LARGEST_SET:
        raise SpecError(f"has more than {LARGEST_SET} values")
    return given


def _check_labelled(entry: Any, key: str) -> None:
    """Check an entry that is a value with a label; other entries are checked when the run spec is validated."""
    if not is_labelled(entry):
        return
    for word in entry:
        if word not in LABELLED:
            message = f"unknown key{did_you_mean(str(word), LABELLED)}; a value with a label has {listed(LABELLED)}"
            raise SpecError(message, key=f"{key}.{word}")
    if "value" in entry and "set" in entry:
        raise SpecError("takes either `value` or `set`, not both", key=key)
    if "set" in entry and not (isinstance(entry["set"], Mapping) and entry["set"]):
        message = f"should be dotted keys of a run spec with their values, not {value_text(entry['set'])}"
        raise SpecError(message, key=f"{key}.set")
    name = entry.get("if_installed")
    if "if_installed" in entry and not (isinstance(name, str) and _DISTRIBUTION.fullmatch(name)):
        message = f"should be the name of a Python package, such as mbdkit-generalized-alpha, not {value_text(name)}"
        raise SpecError(message, key=f"{key}.if_installed")


def is_labelled(entry: object) -> bool:
    """Return whether an entry of a list is a value with a label: it has the keys `label`, and `value` or `set`."""
    return isinstance(entry, Mapping) and "label" in entry and ("value" in entry or "set" in entry)


def _check_limits(kind: str, limits: object) -> None:
    if not isinstance(limits, list) or len(limits) != 3 or not all(map(_is_number, _in_si(kind, limits))):
        raise SpecError(f"should be [first, last, number of values], not {value_text(limits)}", key=kind)
    limits = _in_si(kind, limits)
    for place, limit in enumerate(limits):
        if not abs(limit) <= LARGEST_NUMBER:
            message = f"should be a finite number of at most {float(LARGEST_NUMBER):.2g} in size"
            raise SpecError(message, key=f"{kind}[{place}]")
    first, last, count = limits
    if count != int(count) or not 1 <= count <= LARGEST_SET:
        raise SpecError(f"should be a whole number of values from 1 to {LARGEST_SET}, not {count!r}", key=f"{kind}[2]")
    if count == 1 and first != last:
        raise SpecError(f"a single value cannot be both {first!r} and {last!r}", key=f"{kind}[2]")
    if kind == "geomspace" and (first == 0 or last == 0 or (first > 0) != (last > 0)):
        place = 0 if first == 0 else 1
        raise SpecError(
            "both limits should be non-zero and have the same sign: the spacing is geometric", key=f"{kind}[{place}]"
        )


def _in_si(kind: str, limits: list[Any]) -> list[Any]:
    """Return the limits of a set in SI units; raise SpecError unless both have units of one kind, or none."""
    quantities = [_quantity(limit, f"{kind}[{place}]") for place, limit in enumerate(limits[:2])]
    if len({None if quantity is None else quantity[1].si for quantity in quantities}) > 1:
        raise SpecError("both limits should have units of the same kind, or none", key=kind)
    return [limit if one is None else one[0] for one, limit in zip(quantities, limits, strict=False)] + limits[2:]


def _quantity(given: object, key: str) -> tuple[float, Unit] | None:
    """Return the value and the unit of a number with a unit; None for anything else."""
    with SpecError.locate(key):
        return read_quantity(given)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def size(values: Any) -> int:
    """Return the number of values of a set without expanding it."""
    if isinstance(values, Mapping):
        _, (_, _, count) = next(iter(values.items()))
        return int(count)
    return len(values)


def sets_together(values: Any) -> list[tuple[Path, Mapping[str, Any]]]:
    """Return the values that set several keys together: their indices in the set, and the keys that they set."""
    if isinstance(values, Mapping):
        return []
    return [((i, "set"), entry["set"]) for i, entry in enumerate(values) if is_labelled(entry) and "set" in entry]


def expand(values: Any) -> tuple[Value, ...]:
    """Return the values of a set that has been checked.

    Parameters
    ----------
    values
        A list, or a mapping with ``geomspace`` or ``linspace``.
    """
    if isinstance(values, Mapping):
        kind, limits = next(iter(values.items()))
        first, last, count = _in_si(kind, limits)
        unit = quantity[1].si if (quantity := read_quantity(limits[0])) else ""
        return tuple(Value(number, number, (kind,), unit=unit) for number in _spaced(kind, first, last, int(count)))
    entries = []
    for index, entry in enumerate(values):
        if is_labelled(entry):
            kind = "set" if "set" in entry else "value"
            needed = entry.get("if_installed", "")
            entries.append(Value(entry[kind], str(entry["label"]), (index, kind), kind == "set", needed))
        else:
            quantity = read_quantity(entry)
            value, unit = (entry, "") if quantity is None else (quantity[0], quantity[1].si)
            entries.append(Value(value, label_of(value), (index,), unit=unit))
    return _told_apart(entries)


def _spaced(kind: str, first: float, last: float, count: int) -> list[int | float]:
    whole = isinstance(first, int) and isinstance(last, int)
    first, last = float(first), float(last)
    numbers: list[int | float] = []
    for index in range(count):
        share = index / max(1, count - 1)
        if index in (0, count - 1):
            number = last if index else first
        elif kind == "linspace":
            number = 2 * (first / 2 + (last / 2 - first / 2) * share)  # last - first may overflow
        else:
            number = math.copysign(elementary.exp(elementary.log(abs(first)) + _log_ratio(first, last) * share), first)
        number = float(f"{number:.{DIGITS}g}") if 0 < index < count - 1 else number
        numbers.append(int(number) if whole and number.is_integer() else number)
    return numbers


def _log_ratio(first: float, last: float) -> float:
    """Return the logarithm of last / first; the quotient itself may overflow or underflow."""
    ratio = last / first
    return elementary.log(ratio) if 0 < ratio < math.inf else elementary.log(abs(last)) - elementary.log(abs(first))


def label_of(value: object) -> int | float | str:
    """Return the label of a value: the value itself if it is a number or text; for a mapping, its name and options."""
    match value:
        case bool() | None:
            return json.dumps(value)
        case int() | float() | str():
            return value
        case Mapping() if isinstance(value.get("name"), str):
            options = [f"{key} {_short(item)}" for key, item in value.items() if key != "name"]
            text = ", ".join([value["name"], *options])
        case _:
            text = _short(value)
    return text if len(text) <= LONGEST_LABEL else text[: LONGEST_LABEL - 3] + "..."


def _short(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _told_apart(entries: Sequence[Value]) -> tuple[Value, ...]:
    """Append numbers to labels that different values share, so that labels are unique."""
    taken: set[int | float | str] = {entry.label for entry in entries}
    namesakes: dict[int | float | str, list[Value]] = defaultdict(list)  # with their unique labels
    numbers: dict[int | float | str, Iterator[int]] = defaultdict(lambda: itertools.count(2))
    result = []
    for entry in entries:
        known = namesakes[entry.label]
        equal = next((other for other in known if other.value == entry.value), None)
        label = entry.label if equal is None else equal.label
        if known and equal is None:
            numbered = (f"{entry.label} ({number})" for number in numbers[entry.label])
            label = next(one for one in numbered if one not in taken)
            taken.add(label)
        result.append(replace(entry, label=label))
        if equal is None:
            known.append(result[-1])
    return tuple(result)


NUMBER = {"type": ["number", "string"], "pattern": QUANTITY}  #: JSON schema of a number, which may have a unit.
_LIMITS = {
    "type": "array",
    "prefixItems": [NUMBER, NUMBER, {"type": "integer", "minimum": 1}],
    "minItems": 3,
    "maxItems": 3,
    "description": "First value, last value, number of values.",
}

#: The values of one key of an axis, as written in the spec.
ValueSet = Annotated[
    Any,
    BeforeValidator(check_values),
    WithJsonSchema(
        {
            "description": f"The values of the key: {FORMS}. A value may have a label: {{label, value}}. "
            "{label, set: {KEY: VALUE, ...}} sets several keys together; the axis then has a name instead of a key. "
            "A labelled value with `if_installed: DISTRIBUTION` is skipped if this distribution is not installed.",
            "anyOf": [
                {"type": "array", "minItems": 1},
                *(
                    {"type": "object", "properties": {kind: _LIMITS}, "required": [kind], "additionalProperties": False}
                    for kind in SPACED
                ),
            ],
        }
    ),
]
