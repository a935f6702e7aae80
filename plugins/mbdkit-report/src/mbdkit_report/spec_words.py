"""Keys of run specs in words with units, for readers: ``time.step`` becomes step [s]."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any

from pydantic import BaseModel

from mbdkit.base.errors import MbdkitError
from mbdkit.base.plain_data import Path, path_text
from mbdkit.base.strict_model import description
from mbdkit.base.units import described_units
from mbdkit.mechanism.bodies import Element
from mbdkit.mechanism.parameters import ParameterValues, names_in, parameter_values
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import parse_key
from mbdkit_report.unit_of_use import unit_of_use

_WORDS = {
    "time.step": "step",
    "time.end": "end of the run",
    "time.start": "start of the run",
    "time.steps": "number of steps",
    "integrator": "method",
    "integrator.rtol": "relative tolerance",
    "integrator.atol": "absolute tolerance",
    "output.every": "steps between recorded rows",
}
_SECTIONS = {"model", "integrator", "time", "output", "limits", "stabilization", "parameters"}
_KINDS = {"bodies", "joints", "forces", "markers", "muscles", "springs"}
_ENDS = {"from": "point 1", "to": "point 2"}
#: Keys whose values have an x and a y component.
_VECTORS = {"position", "velocity", "point", "at", "from", "to", "axis", "gravity"}


def key_words(key: str | Path) -> str:
    """Return a key of a run spec in words, such as stiffness of support for ``model.springs.support.stiffness``."""
    path = [str(part) for part in _parts(key)]
    if ".".join(path) in _WORDS:
        return _WORDS[".".join(path)]
    if len(path) > 3 and path[-3:-1] == ["pathway", "angles"]:
        return f"radius of {path[-4]} at {path[-1]}"
    shown = [_ENDS.get(part, part).replace("_", " ") for part in path if part not in _KINDS]
    if len(shown) > 1 and path[0] in _SECTIONS:
        shown = shown[1:]
    if "points" in shown[:-1] and shown[place := shown.index("points") + 1].isdigit():
        shown[place - 1 : place + 1] = [f"point {int(shown[place]) + 1}"]
    if shown[-1].isdigit() and len(shown) > 1:
        if shown[-1] in ("0", "1") and shown[-2].split()[0] in _VECTORS:
            shown[-1] = "xy"[int(shown[-1])]
        else:
            shown[-2:] = [f"{shown[-2]}[{shown[-1]}]"]
    return " of ".join(reversed(shown))


def key_unit(key: str | Path, specs: Iterable[BaseModel]) -> str:
    """Return the unit in the description of the option that a key sets, or the unit of a named parameter; empty if
    there is none.

    Parameters
    ----------
    specs
        Specs that have this key. The first of them that contains the option determines the unit.
    """
    for spec in specs:
        # the option is computed, or its plugin is not installed
        with suppress(MbdkitError, LookupError, TypeError, AttributeError):
            return _unit(spec, _parts(key))
    return ""


def stated_units(base: Mapping[str, object]) -> dict[str, str]:
    """Return the SI units of the parameters that have one in the data of a spec, by dotted key."""
    units = parameter_values(base.get("parameters")).units
    return {f"parameters.{name}": unit.si.removesuffix("1") for name, unit in units.items()}


def described_unit(description: str, along: str = "") -> str:
    """Return the unit in a description, such as ``[N/m]``; empty if there is none.

    Parameters
    ----------
    along
        Unit of the length of the pathway, ``m`` or ``rad``, which selects one of ``[N/m or N m/rad]``. Empty if it is
        not known; both units are then returned.
    """
    units = described_units(description)
    if along and units:
        return units[-1] if along == "rad" else units[0]
    return " or ".join(units).replace("^2", "²") if len(units) < 3 and "1" not in units else ""


def _parts(key: str | Path) -> Path:
    return parse_key(key) if isinstance(key, str) else key


def _unit(holder: Any, path: Path) -> str:
    """Return the unit in the description of the last field along a path through pydantic models."""
    if len(path) == 2 and path[0] == "parameters" and isinstance(holder, ModelSpec):
        return _parameter_unit(holder, str(path[1]))
    described = along = ""
    for part in path:
        if isinstance(holder, BaseModel):
            along = holder.unit_along(dict(holder)) if isinstance(holder, Element) else along
            name, described = _field(holder, str(part))
            holder = getattr(holder, name)
        else:
            holder = holder[part if isinstance(holder, Mapping) else int(part)]
    return described_unit(described, along)


def _parameter_unit(spec: ModelSpec, name: str) -> str:
    """Return the SI unit of a named parameter, as given or from its uses; empty if it has none, or if it is unknown."""
    numbers = spec.numbers
    units = numbers.units if isinstance(numbers, ParameterValues) else {}
    if name in units:
        return units[name].si.removesuffix("1")
    uses = [(str(text), key_unit(key, [spec])) for key, text in spec.written.items() if name in names_in(text)]
    derived = {other: str(text) for other, text in spec.parameters.items() if name in names_in(text)}
    uses += ((text, _parameter_unit(spec, other)) for other, text in derived.items())
    return unit_of_use(name, uses, units)


def _field(holder: BaseModel, key: str) -> tuple[str, str]:
    name = {field.alias: name for name, field in type(holder).model_fields.items()}.get(key, key)
    return name, description(type(holder), name)


def keys_ending_in(name: str, holder: object, path: Path = ("model",)) -> Iterator[str]:
    """Yield the dotted keys in plain data, which is at `path`, whose last part is `name`."""
    items = holder.items() if isinstance(holder, dict) else enumerate(holder) if isinstance(holder, list) else ()
    for part, value in items:
        if part == name:
            yield path_text((*path, part))
        yield from keys_ending_in(name, value, (*path, part))


def leaves(data: object, path: Path = ()) -> Iterator[tuple[Path, object]]:
    """Yield the values in plain data, which is at `path`, that are neither mappings nor lists, with their paths."""
    items = data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list) else None
    if items is None:
        yield path, data
    for key, value in items or ():
        yield from leaves(value, (*path, key))
