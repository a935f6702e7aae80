"""Loading of specs of identifications, with their bases, and the JSON schema."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbdkit.plugin import RunSpec, SpecError, did_you_mean, listed, path_text
from mbdkit.plugin.seams import spec_loader, spec_schema
from mbdkit.plugin.specs import (
    Document,
    Registry,
    example_names,
    parameter_values,
    parse_key,
    put,
    read_source,
    schema_with_bases,
    variable_path,
)
from mbdkit.plugin.studies import base_document, document_of
from mbdkit_identify.identify_spec import Experiment, IdentifySpec


def load_identify_spec(source: object, assignments: Iterable[str] = (), **sections: object) -> IdentifySpec:
    """Load and validate the spec of an identification and its base.

    Parameters
    ----------
    source
        A file (YAML, TOML, JSON), ``"-"`` for standard input, the name of a packaged identification, a mapping, a
        `Document` that was already read, or an `IdentifySpec`. Names of files are relative to the folder of the spec
        or, without a file, to the working folder.
    assignments
        Assignments to keys of the spec, such as ``"starts=8"``, with values in YAML.
    sections
        Top-level keys of the spec; they replace those in `source`.

    Raises
    ------
    SpecError
        If the spec or its base is not valid, with the file, line and key path if known.
    """
    assignments = tuple(assignments)
    if isinstance(source, IdentifySpec):
        if not assignments and not sections:
            return source
        source = source._document or source.model_dump(exclude_unset=True)

    def packaged(name: str) -> tuple[Document, Path] | None:
        return (document := read_source(name), document.folder) if name in example_names("identify") else None

    document, folder = document_of(
        source, ("identification", "identifications"), packaged, lambda: example_names("identify")
    )
    document = Document(deepcopy(document.data), document.file, folder=document.folder) if sections else document
    document.data |= sections
    document.keywords = frozenset(sections)
    if "mbdkit_identify" not in document.data:
        for key, command in (("mbdkit_study", "study"), ("mbdkit_design", "design"), ("mbdkit", "run")):
            if key in document.data:
                message = f"this is the spec of a {command}; that of an identification begins with `mbdkit_identify: 1`"
                raise document.place(SpecError(message, key=key))
    with SpecError.place_by(document.place):
        for assignment in assignments:
            document.assign(assignment)
        spec = IdentifySpec(**document.data)
        spec._document = document
        spec._base = _base(spec, folder)
        _check_names(spec)
        for name, experiment in spec.experiments.items():
            base_of(spec, name, experiment)
    return spec


spec_loader(load_identify_spec)


def _base(spec: IdentifySpec, folder: Path) -> RunSpec:
    """Return the validated base, with the parameters at their start values."""
    document = base_document(spec.base, folder, "base", "identification")
    data = deepcopy(document.data)
    given: dict[str, tuple[tuple[str | int, ...], object]] = {
        path_text(("overrides", key)): (parse_key(key), value) for key, value in spec.overrides.items()
    }
    for name, one in spec.parameters.items():
        path = variable_path(name)
        is_of_run = path[0] != "parameters" or path[-1] in data.get("parameters", {})
        if one.start is not None and is_of_run:
            given[path_text(("parameters", name, "start"))] = path, one.start
    for where, (path, value) in given.items():
        with SpecError.rekey(where):
            put(data, path, value)
    for key in ("measures", "gradients", "check", "accept"):
        data.pop(key, None)
    if spec.kinematic:  # of these, only the start is used
        data = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 1.0}} | data
    try:
        base = RunSpec(**data)
        mechanism = base.mechanism()
    except SpecError as error:
        for where, (path, _) in given.items():
            if error.key == path_text(path):
                raise SpecError(error.message, key=where) from None
        raise error.located(prefix="base") from None
    if base.is_to_be_chosen:
        raise SpecError("an identification needs runs with equal steps: give `integrator` and `time.step`", key="base")
    base._document = Document(data, document.file, folder=document.folder)
    for name, experiment in spec.experiments.items():
        for key in experiment.inputs:
            if key not in mechanism.inputs:
                hint = did_you_mean(key, mechanism.inputs) or f"; it has {listed([*mechanism.inputs], 'and') or 'none'}"
                where = path_text(("experiments", name, "inputs", key))
                raise SpecError(f"the mechanism has no input '{key}'{hint}", key=where)
    return base


def base_of(spec: IdentifySpec, name: str, experiment: Experiment) -> RunSpec:
    """Return the base of an experiment.

    Raises
    ------
    SpecError
        If its overrides are not valid.
    """
    if not experiment.overrides:
        return spec.run_spec
    return overridden(spec.run_spec, data_of(spec.run_spec), experiment.overrides, ("experiments", name))


def data_of(spec: RunSpec | IdentifySpec) -> dict[str, Any]:
    """Return a copy of the data in the document of a spec."""
    assert spec._document is not None
    return deepcopy(spec._document.data)


def overridden(base: RunSpec, data: dict[str, Any], overrides: Mapping[str, object], place: tuple[str, ...]) -> RunSpec:
    """Return a base with other `data`, in which dotted keys are set.

    Raises
    ------
    SpecError
        If the overrides, which the spec has at `place`, are not valid.
    """
    for key, value in overrides.items():
        with SpecError.rekey(path_text((*place, "overrides", key))):
            put(data, parse_key(key), value)
    with SpecError.rekey(path_text((*place, "overrides"))):
        return spec_of_base(data, replace(base._document, data=data))  # type: ignore[type-var]


def spec_of_base(data: Mapping[str, object], document: Document | None) -> RunSpec:
    """Return the validated spec of a run of a base, whose errors are placed in a document."""
    base = RunSpec(**data)
    base.mechanism()
    base._document = document
    return base


def sensor_names(spec: IdentifySpec) -> set[str]:
    """Return the names of parameters that sensors use."""
    sensors = [*spec.sensors.values(), *(one for each in spec.experiments.values() for one in each.sensors.values())]
    values = [value for sensor in sensors for value in (sensor.gain, sensor.offset, sensor.delay)]
    return {value for value in values if isinstance(value, str)}


def _check_names(spec: IdentifySpec) -> None:
    """Raise SpecError for a parameter that neither the base nor a sensor has, or a sensor's unknown parameter."""
    base, of_sensors = spec.run_spec, sensor_names(spec)
    for name in sorted(of_sensors - spec.parameters.keys()):
        hint = did_you_mean(name, [*spec.parameters])
        raise SpecError(f"a sensor has the parameter '{name}', which is not among `parameters`{hint}", key="sensors")
    for name, one in spec.parameters.items():
        where = path_text(("parameters", name))
        known = name in base.parameters or variable_path(name)[0] != "parameters"
        if not known and name not in of_sensors:
            hint = did_you_mean(name, [*base.parameters])
            raise SpecError(f"neither the base nor a sensor has the parameter '{name}'{hint}", key=where)
        if known and name in base.parameters and isinstance(base.parameters[name], str):
            message = f"is the expression '{base.parameters[name]}' in the base; estimate the parameters in it"
            raise SpecError(message, key=where)
        if known and name not in base.parameters and one.start is None:
            number_of(base, name)
        if not known and one.start is None and one.bounds is None:
            raise SpecError("needs `start` or `bounds`, because the base has no value", key=where)
    own = {name: 1.0 for name in spec.parameters if name.isidentifier()}
    for name, text in spec.intervals.of.items():
        with SpecError.rekey(path_text(("intervals", "of", name))):
            parameter_values({**base.numbers, **own, name: text})
    for name, candidate in spec.candidates.items():
        observed = {quantity for one in spec.experiments.values() if one.role == "fit" for quantity in one.observed}
        for quantity in candidate.observed or ():
            if quantity not in observed:
                message = f"no experiment with the role fit observes '{quantity}', so that its noise is not known"
                raise SpecError(message, key=path_text(("candidates", name, "observed")))


def number_of(base: RunSpec, name: str) -> float:
    """Return the number of the base with this key; raise SpecError if there is none."""
    holder: object = base.model_dump()
    for part in variable_path(name):
        try:
            holder = holder[int(part) if isinstance(holder, list | tuple) else part]  # type: ignore[index]
        except (LookupError, TypeError, ValueError):
            known = [str(key) for key in holder] if isinstance(holder, dict) else []
            message = f"the base has no '{name}'{did_you_mean(str(part), known)}"
            raise SpecError(message, key=path_text(("parameters", name))) from None
    if not isinstance(holder, int | float):
        raise SpecError(f"'{name}' is not a number in the base", key=path_text(("parameters", name)))
    return float(holder)


@spec_schema
def identify_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the spec of an identification, whose base is a run spec.

    Parameters
    ----------
    installed
        Registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    schema = schema_with_bases(IdentifySpec, {"RunBase": "run"}, installed, units=set())
    definitions = schema["$defs"]
    columns = {"Experiment": ("observed", "inputs", "time"), "Signal": ("time",), "Measured": ("time",)}
    for section, key in ((section, key) for section, keys in columns.items() for key in keys):
        properties = definitions[section]["properties"]  # the heading of a column stands for its section
        holder, name = (properties[key], "additionalProperties") if key in ("observed", "inputs") else (properties, key)
        holder[name] = {"anyOf": [{"type": "string"}, holder[name]]}
    return schema
