"""From a spec of inverse dynamics of a person to one with the motion of a model, its loads and its measured lengths."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.measured import source_table
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_biomech.persons.calibration import Segments, legs_of
from mbdkit_biomech.persons.landmarks import MarkerFile
from mbdkit_biomech.persons.person import Person, Skeleton
from mbdkit_biomech.persons.person_sections import OF_PERSONS
from mbdkit_biomech.persons.plate_contacts import PlateResult, plate_numbers, plates_under_feet
from mbdkit_biomech.persons.scaled_model import leg_options, scaled_model

#: Names of the loads of feet if a spec has no loads, but the file has force plates.
LOADS = {"foot": "ground", "foot_left": "ground_left"}


def person_of_spec(spec: InverseSpec) -> tuple[Person, InverseSpec]:
    """Return the person of a spec with `subject`, and the spec of the motion of the scaled model without it; raise
    SpecError with the key if a file or a marker is missing, or markers do not determine the person.
    """
    subject, motion = spec.subject, spec.motion
    assert subject is not None
    model = leg_options(spec.model)
    with spec.recording_files():
        table = source_table(motion, spec.folder, "motion")
        assert table is not None
        file, static = MarkerFile.of(table, motion.time), None
        if motion.static is not None:
            static = MarkerFile.of(read_table(spec.folder / motion.static, "motion.static"), motion.time)
    segments = replace(Segments.of(motion.clusters, legs_of(model.legs), file, static), belt=motion.belt)
    plane = motion.plane if motion.plane != "fit" else None
    skeleton = Skeleton.of(subject, segments, plane, motion.centers or {})
    person = skeleton.person(_plates(spec, file, skeleton))
    return person, _expanded(spec, person)


def _plates(spec: InverseSpec, file: MarkerFile, skeleton: Skeleton) -> PlateResult:
    asked: dict[str, tuple[str, Sequence[int]]] = {
        name: (load.body, load.plates) for name, load in spec.loads.items() if load.plates is not None
    }
    numbers, feet, every = plate_numbers(file), skeleton.feet(), bool(spec.loads)
    if not every and numbers:
        asked = {LOADS[body]: (body, numbers) for body in feet}
    if not asked:
        return PlateResult()
    smooth, belt = spec.motion.smooth, spec.motion.belt
    return plates_under_feet(file, skeleton.plane, feet, asked, smooth, every=every, belt=belt)


def _expanded(spec: InverseSpec, person: Person) -> InverseSpec:
    data = json.loads(spec.canonical_json())
    del data["subject"]
    for key in ("uncertainty", "frontal", "emg"):
        data.pop(key, None)
    lengths = {name: length.value for name, length in person.lengths.items()}
    data["model"] = scaled_model(spec, person.subject, lengths)
    source = {key: data["motion"][key] for key in ("file", "data") if key in data["motion"]}
    time = data["motion"]["time"]
    motion = {key: one for key, one in data["motion"].items() if key not in (*OF_PERSONS, "file", "time")}
    columns = {name: {"column": name} for name in person.columns}
    motion |= {"data": _gapped({"time": person.time, **person.columns}), "columns": columns}
    loads = {}
    for name, load in data.get("loads", {}).items():
        if "plates" not in load and load.get("file") is None and load.get("data") is None:
            load = {**load, **source, "time": load.get("time", time)}
        loads[name] = load
    for name, own in person.plates.loads.items():
        (fx, fy), (px, py) = own.force.T, own.point.T
        values = {"time": person.time, "fx": fx, "fy": fy, "px": px, "py": py, "torque": own.torque}
        given = {key: one for key, one in loads.get(name, {}).items() if key != "plates"}
        body = {load: foot for foot, load in LOADS.items()}.get(name)
        force = {"force": ["fx", "fy"], "point": ["px", "py"], "torque": "torque", "data": _gapped(values)}
        loads[name] = {"body": body, **given, "kind": "plate", **force}
    if not data.get("actuators"):
        legs = legs_of(leg_options(spec.model).legs)
        flexions = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion")
        data["actuators"] = {f"{name}{leg}": {} for leg in legs for name in flexions}
    expanded = type(spec)(**data | {"motion": motion, "loads": loads})
    expanded._document = spec._document
    return expanded


def _gapped(columns: Mapping[str, np.ndarray]) -> dict[str, list[float | None]]:
    """Return columns as lists, with None in gaps."""
    return {name: [None if np.isnan(one) else one for one in values.tolist()] for name, values in columns.items()}
