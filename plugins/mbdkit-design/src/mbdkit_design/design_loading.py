"""Loading of design specs, with their scenarios, and the JSON schema."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, cast

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, copied, parse_path, path_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.catalogue import Registry
from mbdkit.spec.loading import example_names, read_source
from mbdkit.spec.reading import Document, parse_key, put, variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.schema import schema_with_bases
from mbdkit.spec.spec_kinds import kind_of, refused, spec_loader, spec_schema
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_design.design_spec import ChosenTable, DesignSpec, Scenario, TableVariable
from mbdkit_design.gains import table_units
from mbdkit_report import stated_units
from mbdkit_studies import base_document, document_of


def load_design_spec(source: object, assignments: Iterable[str] = (), **sections: object) -> DesignSpec:
    """Load and validate a design spec and the specs of its scenarios, and return the design spec.

    Parameters
    ----------
    source
        A file (YAML, TOML, JSON), ``"-"`` for standard input, the name of a packaged design, a mapping, a
        `Document` that was already read, or a `DesignSpec`. A file named as `base` is relative to the folder of the
        design file or, without such a file, to the working folder.
    assignments
        Assignments to keys of the design spec, such as ``"optimizer.starts=8"``, with values in YAML.
    sections
        Top-level keys of the spec; they replace those in `source`.

    Raises
    ------
    SpecError
        If the spec is not valid, with the file, line and key path if known.
    """
    assignments = tuple(assignments)
    if isinstance(source, DesignSpec) and source.specs and not assignments and not sections:
        return source
    document, folder = _document(source)
    document.data |= sections
    document.keywords = frozenset(sections)
    if error := refused(document.data, "design"):
        raise document.place(error)
    with SpecError.place_by(document.place):
        for assignment in assignments:
            document.assign(assignment)
        spec = DesignSpec(**document.data)
        spec._document = document
        spec._specs = _scenario_specs(spec, folder, {})
        for name, settings in spec.compare.items():
            changes = {path_text(("compare", name, key)): (parse_key(key), value) for key, value in settings.items()}
            spec._compared_specs[name] = _scenario_specs(spec, folder, changes)
    return spec


spec_loader(load_design_spec)


def _document(source: object) -> tuple[Document, FilePath]:
    """Return the document of a design, and the folder to which file names in it are relative."""
    if isinstance(source, DesignSpec):
        source = source.model_dump(exclude_unset=True)

    def packaged(name: str) -> tuple[Document, FilePath] | None:
        return (read_source(name), FilePath()) if name in example_names("design") else None

    return document_of(source, ("design", "designs"), packaged, lambda: example_names("design"))


#: Settings of a base: key path and value of each, by the key of the design that states it.
Given = dict[str, tuple[Path, object]]


def _scenario_specs(design: DesignSpec, folder: FilePath, changes: Given) -> dict[str, RunSpec | InverseSpec]:
    """Return the specs of all scenarios by name; see `_scenario_spec`."""
    return {name: _scenario_spec(design, name, one, folder, changes) for name, one in design.situations.items()}


def _scenario_spec(
    design: DesignSpec, name: str, scenario: Scenario, folder: FilePath, changes: Given
) -> RunSpec | InverseSpec:
    """Return the spec of a scenario, whose measures are the goals and limits, with the variables at their start values.

    Parameters
    ----------
    changes
        Settings that are applied last.
    """
    own = scenario.base is not None
    base, place = (scenario.base, ("scenarios", name, "base")) if own else (design.base, ("base",))
    assert base is not None
    document = base_document(base, folder, path_text(place), "design")
    data = copied(document.data)
    given: Given = {path_text(("overrides", key)): (parse_key(key), value) for key, value in design.overrides.items()}
    for key, value in scenario.overrides.items():
        given[path_text(("scenarios", name, "overrides", key))] = (parse_key(key), value)
    _put_all(data, given)
    chosen: Given = {}
    units = stated_units(data)
    for key, variable in design.variables.items():
        _check_variable(key, data)
        where = path_text(("variables", key))
        if isinstance(variable, TableVariable):
            with SpecError.locate(where):
                table = _table_of(design, key, variable, data)
            values: list[float | str] = table.start.tolist()
            if table.is_closed:
                parameter = variable_path(table.keys[0])
                chosen[path_text(("variables", key, "start"))] = (parameter, values[0])
                values[0] = values[-1] = str(parameter[1])
            chosen[where] = (variable_path(key), [table.at.tolist(), values])
            continue
        variable.take_unit(units.get(path_text(variable_path(key)), ""))
        chosen[where] = (variable_path(key), variable.written)
    chosen |= changes
    _put_all(data, chosen)
    given |= chosen
    data["measures"] = {
        measure.name: {"value": measure.expression} | ({"unit": measure.unit} if measure.unit else {})
        for measure in design.defined_measures()
    }
    with SpecError.place_by(lambda error: _located(error, given, document, path_text(place))):
        spec = spec_class(data)(**data)
        spec.mechanism()
    for key, table in design.tables.items():
        if not table.units[1]:
            units_of = table_units(key, spec)
            with SpecError.locate(path_text(("variables", key))):
                table.variable.check_units(*reversed(units_of))
            design._tables[key] = replace(table, units=units_of)
    own_file = document.file or (design._document.file if design._document is not None else "")
    spec._document = Document(data, own_file, folder=document.folder)
    return spec


def _table_of(design: DesignSpec, key: str, variable: TableVariable, data: Mapping[str, Any]) -> ChosenTable:
    """Return the arguments and start values of a table of a base that is a variable, after noting them in the design.

    One parameter sets both ends of a periodic table.
    """
    from scipy.interpolate import CubicSpline

    *above, last = variable_path(key)
    holder: Any = data
    for part in above:
        holder = holder[part] if isinstance(holder, Mapping) and part in holder else {}
    is_law = len(above) == 3 and above[1] == "forces" and isinstance(holder, Mapping) and holder.get("law") == "table"
    is_profile = len(above) == 4 and above[1] == "joints" and above[3] == "profile" and isinstance(holder, Mapping)
    if last != "table" or not (is_law or is_profile):
        raise SpecError(
            "only tables have `points`: those of laws `table`, such as model.forces.spring.table, and those of "
            "profiles of cams, such as model.joints.cam.profile.table"
        )
    table, parameters = holder.get("table"), data.get("parameters") or {}
    try:
        at, values = np.array([[parameters.get(x, x) for x in column] for column in table], dtype=float)
        evenly = np.linspace(at[0], at[-1], variable.points)
        if not (np.all(np.diff(at) > 0.0) and np.all(np.isfinite(values))):
            raise ValueError
    except (TypeError, ValueError, IndexError):
        message = "the table of the base should be two columns of numbers, of which the first one increases"
        raise SpecError(message) from None
    ends, span = str(holder.get("ends")), at[-1] - at[0]
    if ends == "periodic" and values[0] != values[-1]:
        raise SpecError(f"a periodic table begins and ends at one value, not {values[0]:g} and {values[-1]:g}")
    kind = ends if ends in ("periodic", "natural") else "not-a-knot"
    start = CubicSpline(at, values, bc_type=kind)(evenly)  # as runs read it
    least = 0.0 if variable.slope is None else max(variable.slope[0], -variable.slope[1])
    if least * span > variable.bounds[1] - variable.bounds[0]:
        raise SpecError(f"no table within the bounds has such slopes over a length of {span:g}", key="slope")
    if variable.start is not None:
        given = np.atleast_1d(variable.start)
        start = np.interp(evenly, np.linspace(at[0], at[-1], len(given)), given)
    elif wrong := [x for x in start.tolist() if not variable.bounds[0] <= x <= variable.bounds[1]]:
        raise SpecError(f"the table of the base has the value {wrong[0]:g} outside; give `start`", key="bounds")
    keys = [f"{key}.1.{index}" for index in range(variable.points)]
    if ends == "periodic":
        if variable.start is None:
            start[-1] = start[0]
        elif start[0] != start[-1]:
            message = f"a periodic table begins and ends at one value, not {start[0]:g} and {start[-1]:g}"
            raise SpecError(message, key="start")
        own = re.sub(r"\W", "_", f"parameters.ends_of_{above[2]}").replace("parameters_", "parameters.", 1)
        taken = {f"parameters.{name}" for name in parameters}
        taken |= {other.keys[0] for name, other in design._tables.items() if name != key}
        while own in taken:
            own += "_"
        keys[0] = keys[-1] = own
    known = design._tables.setdefault(key, ChosenTable(variable, tuple(keys), evenly, start, ("", "")))
    if not np.array_equal(known.at, evenly):
        raise SpecError(
            f"the tables of the scenarios have different arguments, {known.at[0]:g} to {known.at[-1]:g} and {at[0]:g} "
            f"to {at[-1]:g}"
        )
    if known.keys != tuple(keys) or not np.allclose(known.start, start, rtol=1e-12, atol=0.0):
        raise SpecError("the scenarios have different tables, of which one has to be chosen; give `start`", key="start")
    return known


def spec_class(data: Mapping[str, object]) -> type[RunSpec] | type[InverseSpec]:
    """Return the class of the spec of a scenario, given as plain data; other kinds are refused as run specs."""
    kind = kind_of(data)
    if kind.model is None or kind.run_kind not in ("forward", "inverse"):
        return RunSpec
    return cast("type[RunSpec] | type[InverseSpec]", kind.model())


def _put_all(data: dict[str, object], given: Given) -> None:
    """Set values in a base."""
    for where, (path, value) in given.items():
        with SpecError.rekey(where):
            put(data, path, value)


def _check_variable(name: str, data: Mapping[str, object]) -> None:
    """Raise SpecError if a variable is neither a parameter of the base nor a key below an element of the base."""
    path, place = variable_path(name), dict(data)  # type: Path, object
    for depth, part in enumerate(path):
        if not isinstance(place, Mapping):
            return  # a list, or a mistake that `put` or the validation of the base reports
        if part in place:
            place = place[part]
            continue
        if path[0] != "parameters" and all(str(index).isdigit() for index in path[depth + 1 :]):
            return  # an option, or an item of one, that the base does not set; validation of the spec checks the name
        known = [str(key) for key in place]
        hint = did_you_mean(str(part), known) or (f"; there are {listed(known)}" if known else "")
        what = f"parameter '{part}'" if path[0] == "parameters" else f"'{path_text(path[: depth + 1])}'"
        inner = "" if depth == len(path) - 1 or hint.startswith(" (") else "; if it has a default, set it in the base"
        raise SpecError(f"the base has no {what}{hint}{inner}", key=path_text(("variables", name)))


def _located(error: SpecError, given: Given, document: Document, place: str) -> SpecError:
    """Return an error in the spec of a scenario, located at the key of the design that set the wrong value, or else in
    the base.
    """
    path = parse_path(error.key)
    for where, (key, _) in given.items():
        if path[: len(key)] == key or (path == key[:-1] and str(key[-1]).isdigit()):  # an item of an unknown list
            return SpecError(f"{error.key}: {error.message}", key=where)
    return document.place(error) if os.path.basename(document.file) else error.located(prefix=place)


@spec_schema
def design_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the design spec; its bases are run specs and specs of inverse dynamics.

    Parameters
    ----------
    installed
        Registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    bases, with_units = {"RunBase": "run", "InverseBase": "inverse"}, {"Variable", "TableVariable", "Limit"}
    return schema_with_bases(DesignSpec, bases, installed, holder="Scenario", units=with_units)
