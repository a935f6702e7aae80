"""Expands a study spec into its points, each with a validated run spec."""

from __future__ import annotations

import bisect
import copy
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import Path, parse_path, path_text, plain
from mbdkit.base.text import listed, shortened
from mbdkit.registry.manager import registry
from mbdkit.spec.formulation_choice import BY_ACCELERATIONS, choice_of
from mbdkit.spec.reading import parse_key, put
from mbdkit.spec.run_spec import RunSpec
from mbdkit_report import stated_units
from mbdkit_studies.points.sampled_values import rows_of, table_place, values_of
from mbdkit_studies.spec.made_items import MadeItems
from mbdkit_studies.spec.method_claims import METHOD, claims_of
from mbdkit_studies.spec.sample_section import unit_of
from mbdkit_studies.spec.study_spec import LARGEST_TABLE, Family, StudySpec
from mbdkit_studies.spec.value_sets import Value, expand, size

HOW = ("formulation", "stabilization")  #: Keys of a run spec that belong to a method.

#: Largest number of runs in a study that writes one file per run.
LARGEST_STUDY = 10_000

#: Largest total number of values that the axes of a study set, over all runs.
MOST_SETTINGS = 1_000_000

Label = int | float | str


@dataclass(frozen=True)
class Setting:
    """A key of the run spec that the study sets: its path, its value, and its location in the study spec."""

    path: Path
    value: Any
    place: Path


@dataclass(frozen=True)
class Grid:
    """A family of a study, completed with the defaults from the top level of the study.

    Parameters
    ----------
    axes
        The keys of each axis, each with its values.
    reference
        Settings of the reference runs, in addition to those of the points; None without references.
    table
        (N,) values by dotted key that distinguish the N runs for each combination of axis values: the values of a
        sample, or a table of members. Empty in other studies.
    """

    name: str
    base: Mapping[str, Any]
    base_place: Path
    overrides: tuple[Setting, ...]
    axes: tuple[tuple[tuple[str, tuple[Value, ...]], ...], ...]
    axes_place: Path
    reference: tuple[Setting, ...] | None
    reference_place: Path
    repeats: int

    table: Mapping[str, np.ndarray] = field(default_factory=dict)
    table_place: Path = ()
    #: SI units of those variables of the sample whose distributions have units.
    sample_units: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def base_json(self) -> str:
        """The spec that all points share, before the values of each point are set, as JSON."""
        data = {"mbdkit": 1, **copy.deepcopy(dict(self.base))}
        for override in self.overrides:
            put(data, override.path, copy.deepcopy(override.value))
        return json.dumps(plain(data), separators=(",", ":"), ensure_ascii=False)

    def with_units(self) -> list[Setting]:
        """Return settings that check units: for each key and each unit of its values, one of these values as text with
        the unit.
        """
        settings: dict[tuple[str, str], Setting] = {}
        for number, axis in enumerate(self.axes):
            for key, values in axis:
                place = (*self.axes_place, number, key)
                settings |= {
                    (key, one.unit): Setting(parse_key(key), f"{one.value!r} {one.unit}", (*place, *one.place))
                    for one in reversed(values)
                    if one.unit
                }
        for key, unit in self.sample_units.items():
            value = float(self.table[key][0])
            settings[key, unit] = Setting(parse_key(key), f"{value!r} {unit}", (*self.table_place, key))
        return list(settings.values())

    @cached_property
    def stated_units(self) -> dict[str, str]:
        """SI units by dotted key: those of parameters of the base, and of values of the study that have a unit."""
        units = stated_units(json.loads(self.base_json)) | dict(self.sample_units)
        units |= {key: value.unit for axis in self.axes for key, values in axis for value in values if value.unit}
        return {key: unit.removesuffix("1") for key, unit in units.items()}

    @property
    def count(self) -> int:
        """Number of points."""
        return self.rows * math.prod(self.shape)

    @property
    def rows(self) -> int:
        """Number of rows of the table, and of points for each combination of axis values; 1 without a table."""
        return len(next(iter(self.table.values()))) if self.table else 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each axis."""
        return tuple(len(axis[0][1]) for axis in self.axes)

    def point(self, index: int) -> tuple[dict[str, Label], list[Setting], str]:
        """Return the labels and settings of the point with this index, from 0, and the name of a missing distribution.

        The name is empty if no distribution is missing. The row of the table varies fastest, then the last axis.
        """
        labels: dict[str, Label] = {}
        settings: list[Setting] = []
        lacking = ""
        combination, row = divmod(index, self.rows)
        choices = _choices(combination, self.shape)
        for number, (axis, choice) in enumerate(zip(self.axes, choices, strict=True)):
            for key, values in axis:
                value = values[choice]
                labels[key] = value.label
                place = (*self.axes_place, number, key, *value.place)
                settings += (
                    _settings(value.value, place) if value.together else [Setting(parse_key(key), value.value, place)]
                )
                if value.if_installed and not registry().has_distribution(value.if_installed):
                    lacking = lacking or value.if_installed
        for key, column in self.table.items():
            labels[key] = column[row] if column.dtype == object else column[row].item()
            place = self.table_place if self.table_place == ("members",) else (*self.table_place, key)
            settings.append(Setting(parse_key(key), labels[key], place))
        return labels, settings, lacking

    def labels(self) -> dict[str, np.ndarray]:
        """Return the labels of all points on each axis, by dotted key: numbers, or an object array."""
        columns = {}
        places = _choices(np.arange(self.count) // self.rows, self.shape)
        for axis, choices in zip(self.axes, places, strict=True):
            for key, values in axis:
                labels = [value.label for value in values]
                is_text = any(isinstance(label, str) for label in labels)
                columns[key] = np.array(labels, object if is_text else None)[choices]
        return columns | {key: np.tile(column, math.prod(self.shape)) for key, column in self.table.items()}


def _choices(combination: Any, shape: tuple[int, ...]) -> list[Any]:
    """Return the index of the value on each axis, for the number of a combination or for an array of such numbers.

    The last axis varies fastest. (`numpy.unravel_index` allows only 64 axes.)
    """
    places = []
    for count in reversed(shape):
        combination, choice = np.divmod(combination, count)
        places.append(choice)
    return places[::-1]


def grids(spec: StudySpec) -> tuple[Grid, ...]:
    """Return the families of a study; a study without families has a single one with an empty name.

    Parameters
    ----------
    spec
        The study spec with its bases resolved.

    Raises
    ------
    SpecError
        If there are too many points, if the axes list too many values, or if the table of values is invalid.
    """
    _check_size(spec)
    made = [_grid(spec, name, family, ("families", name)) for name, family in spec.families.items()]
    made = made or [_grid(spec, "", Family(axes=spec.axes), ())]
    table = values_of(spec)
    variables = {} if spec.sample is None else spec.sample.variables
    units = {key: unit.si for key, given in variables.items() if (unit := unit_of(given)) is not None}
    units |= {key: one.unit for key, one in zip(table, spec.tolerances.values(), strict=False) if one.unit}
    return tuple(replace(grid, table=table, table_place=table_place(spec), sample_units=units) for grid in made)


def number_of_points(spec: StudySpec) -> int:
    """Return the number of points of a study, without creating them."""
    return sum(count for count, _ in _families(spec))


def _families(spec: StudySpec) -> list[tuple[int, Sequence[Mapping[str, Any]]]]:
    """Return the number of points and the axes of each family."""
    rows = rows_of(spec)
    return [(rows * math.prod(size(next(iter(axis.values()))) for axis in axes), axes) for axes in _axes(spec)]


def _check_size(spec: StudySpec) -> None:
    """Check the number of points and the number of values on the axes, before any point is created."""
    families = _families(spec)
    runs = sum(count for count, _ in families)
    is_in_files = spec.store == "files" or bool(spec.needs_files)
    key = next((one for one in ("sample", "tolerances", "members", "families") if getattr(spec, one)), "axes")
    if runs > LARGEST_TABLE or (runs > LARGEST_STUDY and is_in_files):
        number = runs if runs < 10**12 else "too many"
        most = f"{LARGEST_STUDY} with a file for each" if runs <= LARGEST_TABLE else f"{LARGEST_TABLE}"
        raise spec.placed(SpecError(f"makes {number} runs; a study has at most {most}", key=key))
    values = sum(size(values) for axes in _axes(spec) for axis in axes for values in axis.values())
    if values > MOST_SETTINGS:
        message = f"lists {values} values; the axes of a study list at most {MOST_SETTINGS}"
        raise spec.placed(SpecError(message, key=key))
    if is_in_files and sum(count * sum(map(len, axes)) for count, axes in families) > MOST_SETTINGS:
        message = f"sets more than {MOST_SETTINGS} values in {runs} runs, the limit for a study with a file for each"
        raise spec.placed(SpecError(message, key=key))


def _axes(spec: StudySpec) -> list[Sequence[Mapping[str, Any]]]:
    """Return the axes of each family."""
    return [family.axes for family in spec.families.values()] or [spec.axes]


def _grid(spec: StudySpec, name: str, family: Family, place: Path) -> Grid:
    base, base_place = (spec.base, ()) if family.base is None else (family.base, place)
    assert isinstance(base, Mapping)
    reference, where = (spec.reference, ()) if family.reference is None else (family.reference, place)
    return Grid(
        name,
        base,
        (*base_place, "base"),
        (*_settings(spec.overrides, ("overrides",)), *_settings(family.overrides, (*place, "overrides"))),
        tuple(tuple((key, expand(values)) for key, values in axis.items()) for axis in family.axes),
        (*place, "axes"),
        None if reference == "none" else _settings(reference, (*where, "reference")),
        (*where, "reference"),
        spec.repeats if family.repeats is None else family.repeats,
    )


def _settings(keys: Mapping[str, object], place: Path) -> tuple[Setting, ...]:
    return tuple(Setting(parse_key(key), value, (*place, key)) for key, value in keys.items())


def sets_method(settings: Iterable[Setting]) -> bool:
    """Return whether settings choose another method."""
    return any(setting.path in ((METHOD,), (METHOD, "name")) for setting in settings)


def _first_formulation(integrator: object) -> dict[str, Any]:
    """Return the first formulation that a method claims, as a key of a run spec, if it does not claim the default one.
    Wrong methods are reported when the run spec is validated.
    """
    with suppress(MbdkitError, ValidationError):
        names = claims_of(integrator).formulations
        return {} if BY_ACCELERATIONS in names else {"formulation": choice_of(names[0])}
    return {}


@dataclass(frozen=True)
class PlannedPoint:
    """One point of a study: its coordinates on the axes, and the parts from which its run spec is built.

    Parameters
    ----------
    number
        Number of the point in the study, from 1.
    axes
        Label of the point's value on each axis, by dotted key.
    study, grid, settings
        Study spec, family and settings from which the run spec is built.
    lacking
        Name of a required distribution that is not installed, in which case the run is left out; empty otherwise.
    """

    number: int
    axes: Mapping[str, Label]
    study: StudySpec
    grid: Grid
    settings: tuple[Setting, ...]
    lacking: str = ""

    @property
    def family(self) -> str:
        """Name of the family of the point; empty in a study without families."""
        return self.grid.name

    @cached_property
    def spec(self) -> RunSpec:
        """The run spec; it is validated, and its mechanism is built.

        Raises
        ------
        SpecError
            If the spec is invalid; the error names the location in the study that causes it.
        """
        return self._checked((*self.grid.overrides, *self.settings), f"run {self.number}")

    @cached_property
    def reference(self) -> RunSpec | None:
        """The spec of the reference run against which errors are computed; None if there is none.

        Raises
        ------
        SpecError
            If the spec is invalid, covers another time than the run, or has other bodies; the error names the location
            in the study that causes it.
        """
        if self.grid.reference is None:
            return None
        which = f"the reference of run {self.number}"
        made = self._checked((*self.grid.overrides, *self._settings_of_reference, *self.grid.reference), which)
        mine, other = ((spec.time.start, spec.time.final) for spec in (self.spec, made))
        if any(abs(a - b) > 1e-9 * (mine[1] - mine[0]) for a, b in zip(mine, other, strict=True)):
            message = (
                f"{which} goes from {other[0]:g} s to {other[1]:g} s, the run from {mine[0]:g} s to {mine[1]:g} s; "
                "both should cover the same time"
            )
            raise self._placed(SpecError(message), self.grid.reference_place)
        if made.model != self.spec.model:
            bodies = [list(spec.mechanism().bodies) for spec in (self.spec, made)]
            if bodies[0] != bodies[1]:
                mine_listed, other_listed = (listed(names[:6]) + ", ..." * (len(names) > 6) for names in bodies)
                message = f"{which} has the bodies {other_listed}, the run has {mine_listed}; both should have the same"
                raise self._placed(SpecError(message), self.grid.reference_place)
        return made

    @property
    def _settings_of_reference(self) -> tuple[Setting, ...]:
        """The settings that the reference run shares. A reference with a method of its own does not share those that a
        value sets together with the method of the run.
        """
        own = {setting.place[:-1] for setting in self.settings if setting.path == (METHOD,)}
        if not sets_method(self.grid.reference or ()):
            own = set()
        return tuple(one for one in self.settings if one.path[0] not in HOW or one.place[:-1] not in own)

    @cached_property
    def run_id(self) -> str:
        """Identifier of the run; equal run specs have equal identifiers."""
        return self.spec.run_id()

    @cached_property
    def reference_id(self) -> str:
        """Identifier of the reference run; empty if there is none."""
        return "" if self.reference is None else self.reference.run_id()

    def check(self, setting: Setting) -> None:
        """Raise SpecError if the run spec is not valid with an additional setting."""
        self._checked((*self.grid.overrides, *self.settings, setting), f"run {self.number}")

    def _checked(self, settings: tuple[Setting, ...], which: str) -> RunSpec:
        data = {"mbdkit": 1, **copy.deepcopy(dict(self.grid.base))}
        label = shortened(point_label(self.axes))
        where = f" (in {which}{': ' if label else ''}{label})"
        for setting in settings:
            try:
                put(data, setting.path, copy.deepcopy(setting.value))
            except SpecError as error:
                raise self._placed(SpecError(error.message + where), setting.place) from None
        if sets_method(self.settings) and "formulation" not in data:
            data |= _first_formulation(data[METHOD])
        try:
            spec = RunSpec(**data)
            spec.mechanism()
        except SpecError as error:
            document = self.study._document
            given = {} if document is None else document.overridden
            place, exact = _origin(parse_path(error.key), settings, self.grid, given)
            key = "" if exact else f"{error.key}: "
            raise self._placed(SpecError(f"{key}{error.message}{where}"), place) from None
        return spec

    def _placed(self, error: SpecError, place: Path) -> SpecError:
        """Return an error with file and line in the study, or in the file of the base spec."""
        return self.study.placed(error.located(prefix=path_text(place)))


def _origin(path: Path, settings: tuple[Setting, ...], grid: Grid, given: Mapping[Path, str]) -> tuple[Path, bool]:
    """Return the location in the study at which a key of the run spec is set.

    Also return whether this is the location of the key itself; otherwise, it is that of a key below, of which those
    that are `given` on the command line come first.
    """
    if above := [setting for setting in settings if path[: len(setting.path)] == setting.path]:
        last = max(enumerate(above), key=lambda item: (len(item[1].path), item[0]))[1]
        return (*last.place, *path[len(last.path) :]), True
    if below := [setting for setting in settings if setting.path[: len(path)] == path]:
        return next((one.place for one in below if one.place in given), below[-1].place), False
    return (*grid.base_place, *path), True


class PlannedPoints(MadeItems[PlannedPoint]):
    """All points of a study, each created on access; the first `LARGEST_STUDY` are kept, with specs that are built.

    Parameters
    ----------
    spec
        The study spec with its bases resolved.

    Raises
    ------
    SpecError
        If there are too many points, or if the unit of a value does not suit its key.
    """

    def __init__(self, spec: StudySpec):
        self.study = spec
        self.grids = grids(spec)
        self._ends = np.cumsum([grid.count for grid in self.grids]).tolist()
        super().__init__(int(self._ends[-1]), self._point, LARGEST_STUDY)
        for end, grid in zip(self._ends, self.grids, strict=True):
            for setting in grid.with_units():
                self[end - grid.count].check(setting)

    def _point(self, place: int) -> PlannedPoint:
        number = bisect.bisect_right(self._ends, place)
        grid = self.grids[number]
        labels, settings, lacking = grid.point(place - (self._ends[number] - grid.count))
        return PlannedPoint(place + 1, labels, self.study, grid, tuple(settings), lacking)

    def table(self) -> dict[str, np.ndarray] | None:
        """Return the values that distinguish the points by dotted key, (N,), if a table has all of them; else None."""
        only = self.grids[0]
        if len(self.grids) > 1 or only.axes or not only.table:
            return None
        return {path_text(parse_key(key)): column for key, column in only.table.items()}

    def labels(self) -> dict[str, np.ndarray]:
        """Return the labels of all points on each axis by dotted key, (N,); nan or None for points that lack the
        axis.
        """
        parts = [grid.labels() for grid in self.grids]
        labels = {}
        for key in dict.fromkeys(key for part in parts for key in part):
            columns = [part.get(key) for part in parts]
            is_text = any(column is not None and column.dtype == object for column in columns)
            types = [float if column is None else column.dtype for column in columns]
            dtype = object if is_text else np.result_type(*types)
            filled = [
                np.full(grid.count, None if is_text else np.nan, dtype) if column is None else column.astype(dtype)
                for grid, column in zip(self.grids, columns, strict=True)
            ]
            labels[key] = np.concatenate(filled)
        return labels

    def families(self) -> np.ndarray:
        """Return the name of the family of each point, (N,) objects."""
        return np.repeat(np.array([grid.name for grid in self.grids], object), [grid.count for grid in self.grids])


def distinct_runs(points: Iterable[PlannedPoint]) -> Iterator[tuple[str, RunSpec]]:
    """Yield a name for error messages, and the spec, of each distinct run of a study, including reference runs."""
    seen: set[str] = set()
    for point in points:
        if point.lacking:
            continue
        for name, run_id, spec in (
            (f"run {point.number}", point.run_id, point.spec),
            (f"the reference of run {point.number}", point.reference_id, point.reference),
        ):
            if spec is not None and run_id not in seen:
                seen.add(run_id)
                yield name, spec


def point_label(axes: Mapping[str, Label]) -> str:
    """Return the axis labels of a point as one line, for example ``gauss, stages 2; time.step 0.01``."""
    return "; ".join(
        str(value) if key in ("model", "integrator") else f"{key} {value:g}" if isinstance(value, float) else
        f"{key} {value}" for key, value in axes.items()
    )  # fmt: skip
