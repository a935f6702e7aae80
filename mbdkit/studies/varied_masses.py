"""Notes on studies that vary the mass of a body, but not its moment of inertia."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from mbdkit.base.plain_data import Path, path_text
from mbdkit.mechanism.parameters import names_in, parameters_in_use
from mbdkit.spec.reading import parse_key
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.planned_points import Grid, grids


def varied_masses(spec: StudySpec) -> Iterator[str]:
    """Yield a note for each mass of a body that a study varies while the moment of inertia of the body stays the same.

    An inertia that is an expression of parameters stays the same, too. The note names the parameter to vary instead, if
    mass and inertia depend on one.
    """
    found = dict.fromkeys(note for grid in grids(spec) for note in _of_grid(grid))
    yield from found


def _of_grid(grid: Grid) -> Iterator[str]:
    varied = _varied(grid)
    for path in varied:
        if path[:2] != ("model", "bodies") or path[3:] != ("mass",) or (*path[:3], "inertia") in varied:
            continue
        base = json.loads(grid.base_json)
        body = base["model"].get("bodies", {}).get(path[2], {})
        mass, inertia = body.get("mass"), body.get("inertia")
        if inertia is None:
            continue
        parameters: dict[str, Any] = base.get("parameters") or {}
        common = names_in(mass) & parameters_in_use(parameters, [inertia])
        advice = (
            f"vary parameters.{min(common)} instead"
            if len(common) == 1
            else "write both as expressions of one parameter, and vary this parameter"
        )
        yield (
            f"the runs vary {path_text(path)}, but not the inertia of body '{path[2]}', {inertia}; to change both, "
            f"{advice}"
        )


def _varied(grid: Grid) -> list[Path]:
    """Return the key paths that the axes and the table of a grid set, each once."""
    values = [(key, value) for axis in grid.axes for key, found in axis for value in found]
    keys = [one for key, value in values for one in (value.value if value.together else (key,))]
    return [parse_key(key) for key in dict.fromkeys([*keys, *grid.table])]
