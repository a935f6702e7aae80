"""The values that an axis of a study takes: a list, or numbers spaced between two ends; objects may carry labels.

A value may also be several keys that are set together, and may depend on a distribution that need not be installed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from mbdkit.errors import SpecError
from mbdkit.spec.plain_data import found
from mbdkit.text import did_you_mean, listed

#: More values than this in one set are a slip of the pen.
LARGEST_SET = 10_000

SPACED = ("geomspace", "linspace")
LABELLED = ("label", "value", "set", "if_installed")
"""What a value with a label consists of: one of `value` and `set` beside the label."""
FORMS = "a list of values, {geomspace: [first, last, number]} or {linspace: [first, last, number]}"

#: Digits to which spaced numbers are rounded, so that every machine gets the same ones.
DIGITS = 12
_DISTRIBUTION = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9])?")
LONGEST_LABEL = 60


@dataclass(frozen=True)
class Value:
    """One value of a set.

    Parameters
    ----------
    value
        What the key is set to, as plain data; or the dotted keys that are set together, with their values.
    label
        What stands for it in tables and figures: the value itself if it is a number or a text.
    place
        Where it stands in its set: indices and keys.
    together
        Whether `value` is several dotted keys, and the axis has a name of its own instead of a key.
    if_installed
        The distribution without which the value is left out; empty where it needs none.
    """

    value: Any
    label: int | float | str
    place: tuple[str | int, ...]
    together: bool = False
    if_installed: str = ""


def check_values(given: Any) -> Any:
    """Return a value set as it was given, once it is known to be one.

    Raises
    ------
    SpecError
        With the key within the set.
    """
    match given:
        case list():
            if not given:
                raise SpecError("needs at least one value")
            for index, entry in enumerate(given):
                _check_labelled(entry, f"[{index}]")
        case {"geomspace": limits, **others} | {"linspace": limits, **others}:
            kind = next(name for name in SPACED if name in given)
            if others:
                raise SpecError(f"stands alone: '{next(iter(others))}' has no place beside '{kind}'", key=kind)
            _check_limits(kind, limits)
        case Mapping() if len(given) == 1:
            word = str(next(iter(given)))
            raise SpecError(f"unknown key{did_you_mean(word, SPACED)}; the values of an axis are {FORMS}", key=word)
        case _:
            raise SpecError(f"should be {FORMS}, not {found(given)}")
    if len(expand(given)) > LARGEST_SET:
        raise SpecError(f"has more than {LARGEST_SET} values")
    return given


def _check_labelled(entry: Any, key: str) -> None:
    """Check an entry that is a value with a label; all others are left to the run spec that they become part of."""
    if not is_labelled(entry):
        return
    for word in entry:
        if word not in LABELLED:
            raise SpecError(
                f"unknown key{did_you_mean(str(word), LABELLED)}; a value with a label has {listed(LABELLED)}",
                key=f"{key}.{word}",
            )
    if "value" in entry and "set" in entry:
        raise SpecError("takes either `value` or `set`, not both", key=key)
    if "set" in entry and not (isinstance(entry["set"], Mapping) and entry["set"]):
        message = f"should be dotted keys of a run spec with their values, not {found(entry['set'])}"
        raise SpecError(message, key=f"{key}.set")
    name = entry.get("if_installed")
    if "if_installed" in entry and not (isinstance(name, str) and _DISTRIBUTION.fullmatch(name)):
        message = f"should be the name of a distribution, such as mbdkit-generalized-alpha, not {found(name)}"
        raise SpecError(message, key=f"{key}.if_installed")


def is_labelled(entry: Any) -> bool:
    """Return whether an entry of a list is a value with a label: `label` beside `value` or `set`."""
    return isinstance(entry, Mapping) and "label" in entry and ("value" in entry or "set" in entry)


def _check_limits(kind: str, limits: Any) -> None:
    if not isinstance(limits, list) or len(limits) != 3 or not all(map(_is_number, limits)):
        raise SpecError(f"should be [first, last, number of values], not {found(limits)}", key=kind)
    first, last, count = limits
    if count != int(count) or not 1 <= count <= LARGEST_SET:
        raise SpecError(f"should be a whole number of values from 1 to {LARGEST_SET}, not {count!r}", key=f"{kind}[2]")
    if count == 1 and first != last:
        raise SpecError(f"one value cannot be both {first!r} and {last!r}", key=f"{kind}[2]")
    if kind == "geomspace" and not first * last > 0:
        place = 0 if first == 0 else 1
        raise SpecError(
            "both ends should be other than 0 and of one sign: their ratio is divided", key=f"{kind}[{place}]"
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def expand(values: Any) -> tuple[Value, ...]:
    """Return the values of a checked set.

    Parameters
    ----------
    values
        A list, or a mapping with ``geomspace`` or ``linspace``.
    """
    if isinstance(values, Mapping):
        kind, (first, last, count) = next(iter(values.items()))
        return tuple(Value(number, number, (kind,)) for number in _spaced(kind, first, last, int(count)))
    entries = []
    for index, entry in enumerate(values):
        if is_labelled(entry):
            kind = "set" if "set" in entry else "value"
            needed = entry.get("if_installed", "")
            entries.append(Value(entry[kind], str(entry["label"]), (index, kind), kind == "set", needed))
        else:
            entries.append(Value(entry, label_of(entry), (index,)))
    return _told_apart(entries)


def _spaced(kind: str, first: float, last: float, count: int) -> list[int | float]:
    whole = isinstance(first, int) and isinstance(last, int)
    numbers: list[int | float] = []
    for index in range(count):
        share = index / max(1, count - 1)
        if index in (0, count - 1):
            number = float(last if index else first)
        elif kind == "linspace":
            number = first + (last - first) * share
        else:
            number = math.copysign(math.exp(math.log(abs(first)) + math.log(last / first) * share), first)
        number = float(f"{number:.{DIGITS}g}") if 0 < index < count - 1 else number
        numbers.append(int(number) if whole and number.is_integer() else number)
    return numbers


def label_of(value: Any) -> int | float | str:
    """Return what stands for a value: a number or text itself, an object by its name and its short options."""
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


def _short(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _told_apart(entries: Sequence[Value]) -> tuple[Value, ...]:
    """Number the labels of different values that would read the same."""
    seen: dict[int | float | str, list[Any]] = {}
    result = []
    for entry in entries:
        namesakes = seen.setdefault(entry.label, [])
        if entry.value not in namesakes:
            namesakes.append(entry.value)
        number = namesakes.index(entry.value) + 1
        label = entry.label if number == 1 else f"{entry.label} ({number})"
        result.append(replace(entry, label=label))
    return tuple(result)


_LIMITS = {
    "type": "array",
    "prefixItems": [{"type": "number"}, {"type": "number"}, {"type": "integer", "minimum": 1}],
    "minItems": 3,
    "maxItems": 3,
    "description": "First value, last value, number of values.",
}

#: The values of one key of an axis, as they were written.
ValueSet = Annotated[
    Any,
    BeforeValidator(check_values),
    WithJsonSchema(
        {
            "description": f"The values that the key takes: {FORMS}. A value may carry a label: {{label, value}}. "
            "Several keys are set together by {label, set: {KEY: VALUE, ...}}; the axis then has a name of its own "
            "instead of a key. With `if_installed: DISTRIBUTION` a labelled value is left out where that is missing.",
            "anyOf": [
                {"type": "array", "minItems": 1},
                *(
                    {
                        "type": "object",
                        "properties": {kind: _LIMITS},
                        "required": [kind],
                        "additionalProperties": False,
                    }
                    for kind in SPACED
                ),
            ],
        }
    ),
]
