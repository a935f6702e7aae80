"""Files with results of identifications: writing, reading, and checks.

The group ``/parameters`` is the one that `parameters: {from: FILE.h5}` of other specs reads.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from mbdkit.plugin import listed
from mbdkit.plugin.archives import ResultFile, ResultTable, TableColumn
from mbdkit.plugin.seams import file_problems
from mbdkit_identify.identification import VERDICTS, Doubt, Estimate, Identification, NextExperiment, Profile, Residuals

FILE = ResultFile("mbdkit-identification", 1, "result of an identification", "repeat the identification")
_TEXTS = ("verdict", "title", "way")
_NUMBERS = ("level", "cost", "log_likelihood", "seconds", "unknowns")
_AS_JSON = {"spec": dict, "base": dict, "combinations": list, "notes": list, "doubts": list}
#: Types of arrays, by the type of a field.
_KINDS: Mapping[Any, Any] = {"str": object, "bool": int, "float": float}
_LONG_NAMES = {
    "value": "estimate",
    "lower": "lower limit of the interval, -inf without one",
    "upper": "upper limit of the interval, inf without one",
    "deviation": "standard deviation",
    "identifiable": "whether the data determine the value",
    "at_bound": "bound at which the value is",
    "why": "why no standard deviation describes the errors of the estimate, empty if one does",
    "mean": "value that belongs to the covariance, nan without one",
    "white": "whitened residuals",
    "band": "half width of the band that contains the measured values",
    "values": "fixed values",
    "costs": "increase of the sum of squares of the whitened residuals",
}
_OF_ITEM = TypeVar("_OF_ITEM", Residuals, Profile)


def write_identification(result: Identification, path: str | Path, overwrite: bool = False) -> Path:
    """Write the result of an identification to an HDF5 file, and return its path.

    Parameters
    ----------
    path
        Name of the file, which ends in ``.h5``.
    overwrite
        Whether an existing file may be replaced; it is not changed before the new one is complete.

    Raises
    ------
    SpecError
        If no file of this name may be written.
    ResourceError
        If the system refuses to write the file, as on a full disk.
    """
    return FILE.write(path, lambda file: _fill(file, result), overwrite=overwrite)


def load_identification(path: str | Path) -> Identification:
    """Read the result of an identification from a file of `mbdkit.identify` or ``mbdkit identify``.

    Raises
    ------
    SpecError
        If there is no such file, or it is not the result of an identification.
    ArchiveError
        If the file is damaged.
    """
    with FILE.open(path) as file:
        return _read(file)


@file_problems
def problems(path: Path) -> list[str] | None:
    """Return the problems of the result of an identification as sentences; None for a file of another kind."""
    return FILE.problems(path, load_identification)


def _fill(file: h5py.File, result: Identification) -> None:
    doubts = [[doubt.place, doubt.text, *doubt.strength] for doubt in result.doubts]
    FILE.set_texts(file, {name: getattr(result, name) for name in (*_TEXTS, *_AS_JSON)} | {"doubts": doubts})
    file.attrs["evaluations"] = result.evaluations
    for name in _NUMBERS:
        file.attrs[name] = float(getattr(result, name))
    covariance = TableColumn(result.covariance, ("parameter", "other"), "mixed", "covariance", "unit")
    columns = _estimates(result, "parameter", result.parameters)
    others = [name for name in result.estimates if name not in result.parameters]
    other = columns["parameter"]._replace(axes=("other",))
    _write(file, "parameters", {**columns, "other": other, "covariance": covariance})
    _write(file, "estimates", _estimates(result, "estimate", others))
    for number, signal in enumerate(result.residuals):
        _write_item(file.require_group("residuals"), number, signal, "time", {"time": "s", "white": "1"}, signal.unit)
    for number, profile in enumerate(result.profiles.values()):
        unit = result.estimates[profile.name].unit
        _write_item(file.require_group("profiles"), number, profile, "values", {"values": unit}, "1")
    if (following := result.next_experiment) is not None:
        columns = _estimates(result, "estimate", following.half_widths[""])
        widths = np.array([[*one.values()] for one in following.half_widths.values()], float)
        candidates = np.array([*following.half_widths], object)
        table = {
            "candidate": TableColumn(candidates, ("candidate",), "1", "candidate; an empty name is the present state"),
            **{name: columns[name] for name in ("estimate", "unit")},
            "half_width": TableColumn(widths, ("candidate", "estimate"), "mixed", "half width of the interval", "unit"),
        }
        texts = {"narrows": following.narrows, "best": following.best}
        FILE.set_texts(_write(file, "next_experiment", table), texts)


def _estimates(result: Identification, axis: str, names: Iterable[str]) -> dict[str, TableColumn]:
    """Return the columns of some of the estimates."""
    other = Estimate("", "", np.nan, np.nan, np.nan, np.nan, True)  # of a quantity that an experiment should narrow
    estimates, columns = [result.estimates.get(name, replace(other, name=name)) for name in names], {}
    for one in fields(Estimate):
        values = np.array([getattr(estimate, one.name) for estimate in estimates], _KINDS[one.type])
        long_name = _LONG_NAMES.get(one.name, "")
        units = ("mixed", long_name, "unit") if one.type == "float" else ("1", long_name)
        columns[axis if one.name == "name" else one.name] = TableColumn(values, (axis,), *units)
    return columns


def _write_item(
    parent: h5py.Group, number: int, item: Residuals | Profile, axis: str, units: Mapping[str, str], unit: str
) -> None:
    """Write an item to a group: its arrays, whose units are `unit` unless `units` has others, and its attributes."""
    values = {one.name: getattr(item, one.name) for one in fields(item)}
    columns = {
        name: TableColumn(value, (axis,), units.get(name, unit) or "1", _LONG_NAMES.get(name, name))
        for name, value in values.items()
        if isinstance(value, np.ndarray)
    }
    group = _write(parent, str(number), columns)
    for name in values.keys() - columns.keys():
        if isinstance(values[name], str):
            FILE.set_texts(group, {name: values[name]})
        else:
            group.attrs[name] = float(values[name])


def _write(parent: h5py.Group, name: str, columns: Mapping[str, TableColumn]) -> h5py.Group:
    """Write columns to a new group; those of the axes come first."""
    group = parent.create_group(name)
    for key, column in sorted(columns.items(), key=lambda item: item[1].axes != (item[0],)):
        column.write(parent, f"{name}/{key}")
    return group


def _read(file: h5py.File) -> Identification:
    given = file.attrs
    values: dict[str, Any] = {name: json.loads(str(given[name])) for name in _AS_JSON}
    for name, kind in _AS_JSON.items():
        if not isinstance(values[name], kind):
            raise ValueError(f"{name} has another structure")
    values |= {name: str(given[name]) for name in _TEXTS} | {name: float(given[name]) for name in _NUMBERS}
    if values["verdict"] not in VERDICTS:
        raise ValueError(f"the verdict should be {listed(VERDICTS, 'or')}")
    values |= {name: tuple(map(str, values[name])) for name in ("combinations", "notes")}
    values["doubts"] = tuple(
        Doubt(str(place), str(text), (_number(statistic), _number(limit)))
        for place, text, statistic, limit in values["doubts"]
    )
    parameters = ResultTable.read(file["parameters"])
    estimates = _read_estimates(parameters, "parameter")
    values |= {"parameters": tuple(estimates), "covariance": parameters["covariance"]}
    values["estimates"] = estimates | _read_estimates(ResultTable.read(file["estimates"]), "estimate")
    values["residuals"] = tuple(_read_items(file, "residuals", Residuals))
    values["profiles"] = {profile.name: profile for profile in _read_items(file, "profiles", Profile)}
    values["next_experiment"] = _next_experiment(file["next_experiment"]) if "next_experiment" in file else None
    runs, derived = map(int, given["evaluations"])
    return Identification(**values, evaluations=(runs, derived))


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _read_estimates(table: ResultTable, axis: str) -> dict[str, Estimate]:
    estimates: dict[str, Estimate] = {}
    for row, name in enumerate(table[axis]):
        values: dict[str, Any] = {one.name: table[one.name].tolist()[row] for one in fields(Estimate)[1:]}
        estimates[name] = Estimate(name, **values | {"identifiable": bool(values["identifiable"])})
    return estimates


def _read_items(file: h5py.File, name: str, kind: type[_OF_ITEM]) -> list[_OF_ITEM]:
    """Return the items in the numbered groups of a group; none if there is no such group."""
    items, types = [], {"str": str, "float": float, "bool": bool}
    for key in sorted(file.get(name, ()), key=int):
        group = file[name][key]
        table = ResultTable.read(group)
        values: dict[str, Any] = {
            one.name: types[str(one.type)](group.attrs[one.name]) if one.type in types else table[one.name]
            for one in fields(kind)
        }
        items.append(kind(**values))
    return items


def _next_experiment(group: h5py.Group) -> NextExperiment:
    table = ResultTable.read(group)
    names = table["estimate"].tolist()
    rows = zip(table["candidate"].tolist(), table["half_width"].tolist(), strict=True)
    widths = {candidate: dict(zip(names, row, strict=True)) for candidate, row in rows}
    return NextExperiment(str(group.attrs["narrows"]), widths, str(group.attrs["best"]))
