"""Specs of persons whose joints are known, with data in Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit_biomech.inverse_dynamics.files.measured_table import table_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import TimeColumn
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec, load_inverse_spec
from mbdkit_biomech.persons.calibration import Segments, legs_of
from mbdkit_biomech.persons.landmarks import MarkerFile
from mbdkit_biomech.persons.person import Skeleton
from mbdkit_biomech.persons.person_sections import Subject
from tests.benchmarks.person_markers import CLUSTERS, Array, Walker, columns_of, in_laboratory

SUBJECT = {"mass": 75, "height": 1.8, "sex": "male"}
FUNCTIONAL = {f"{name}{leg}": "functional" for name in ("knee", "ankle") for leg in ("", "_left")}


def data_of(walker: Walker, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return columns (T, 3) as columns of a table."""
    return {"time": walker.time} | {f"{n}.{a}": x[:, k] for n, x in columns.items() for k, a in enumerate("xyz")}


def recorded(seed: int = 0, skin: float = 1.0, heading: float = 2.0, up: str = "z") -> dict[str, Array]:
    """Return the columns of markers and plates of a person who walks, in metres."""
    walker = Walker.of_example(2)
    markers = walker.markers(np.random.default_rng(seed), skin)
    return data_of(walker, columns_of(walker, markers, heading, up))


def person_spec(data: Mapping[str, Array] | None = None, *, legs: int = 2, **sections: Any) -> dict[str, Any]:
    """Return the spec of a person; `motion` adds keys to that section, other sections replace those of the spec."""
    motion = {"data": recorded() if data is None else data, "clusters": CLUSTERS, **sections.pop("motion", {})}
    motion = {"smooth": {"name": "butterworth", "cutoff": 8}, "errors": "none", **motion}
    model = {"name": "leg", "legs": legs, "root": "trunk"}
    return {"mbdkit": 1, "subject": SUBJECT, "model": model, "motion": motion, **sections}


def loaded(*args: Any, **sections: Any) -> InverseSpec:
    """Return the validated spec of a person."""
    return load_inverse_spec(person_spec(*args, **sections))


def marker_file(walker: Walker, markers: Mapping[str, Array], heading: float) -> MarkerFile:
    """Return a table of markers, (T, 3) as (forward, up, right), in a laboratory."""
    table = table_of(data_of(walker, {n: in_laboratory(x, heading) for n, x in markers.items()}), "motion.data")
    return MarkerFile.of(table, TimeColumn())


def skeleton_of(walker: Walker, markers: Mapping[str, Array], heading: float, **centers: Any) -> Skeleton:
    """Return the person of markers, (T, 3) as (forward, up, right), before its plates are assigned."""
    segments = Segments.of(CLUSTERS, legs_of(2), marker_file(walker, markers, heading), None)
    return Skeleton.of(Subject(**SUBJECT), segments, None, centers)


def trc_text(time: Array, markers: Mapping[str, Array]) -> str:
    """Return markers (T, 3) in metres as the text of a .trc file in millimetres."""
    count = len(markers)
    lines = ["PathFileType\t4\t(X/Y/Z)\tstatic.trc", "NumFrames\tNumMarkers\tUnits", f"{len(time)}\t{count}\tmm"]
    lines.append("Frame#\tTime\t" + "\t\t\t".join(markers))
    lines.append("\t\t" + "\t".join(f"{axis}{k}" for k in range(1, count + 1) for axis in "XYZ"))
    for row, at in enumerate(time):
        values = [1000 * value for own in markers.values() for value in own[row]]
        lines.append("\t".join([str(row + 1), f"{at:.5f}", *(f"{value:.2f}" for value in values)]))
    return "\n".join(lines) + "\n"
