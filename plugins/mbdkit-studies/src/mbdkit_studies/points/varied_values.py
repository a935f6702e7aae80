"""Notes on values that a study varies: masses without moments of inertia, exchanged parameters of normal distributions,
limits of truncated ones that are probably not meant as multiples of the scale, and starts that assembly changes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import suppress
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, path_text
from mbdkit.base.text import counted, listed
from mbdkit.base.units import read_quantity
from mbdkit.engine.consistent_start import Starts
from mbdkit.mechanism.parameters import names_in, parameter_values, parameters_in_use
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec.reading import parse_key
from mbdkit.spec.run_spec import RunSpec
from mbdkit_studies.points.planned_points import Grid, grids
from mbdkit_studies.spec.sample_section import frozen
from mbdkit_studies.spec.study_spec import StudySpec

#: Mean and standard deviation may be exchanged if the standard deviation exceeds this multiple of the mean.
WIDE = 3.0

#: Share of the range of an initial value by which assembly may change this range without a warning.
KEPT = 0.01

ROUNDING = 1e-9  #: Ranges of initial values below this share of the largest value count as rounding errors.

#: Keys of the initial values of a body.
KEYS = (("position", 0), ("position", 1), ("angle",), ("velocity", 0), ("velocity", 1), ("angular_velocity",))


def notes_on_varied_values(spec: StudySpec) -> Iterator[str]:
    """Yield a note for each mass of a body that a study varies while the moment of inertia of the body stays the same,
    for each normal distribution whose mean and standard deviation are probably exchanged, and for each truncated normal
    distribution whose limits are probably given as values.

    The mass may be varied itself or through parameters. Where it is varied itself, the note names the parameter to vary
    instead, if mass and inertia depend on one.
    """
    notes = (note for grid in grids(spec) for note in (*_of_masses(grid), *_of_distributions(spec, grid)))
    yield from dict.fromkeys(notes)


def _of_masses(grid: Grid) -> Iterator[str]:
    varied = _varied(grid)
    base = json.loads(grid.base_json)
    parameters: dict[str, Any] = base.get("parameters") or {}
    names = {str(path[1]) for path in varied if path[:1] == ("parameters",) and len(path) == 2}
    through: dict[tuple[str, ...], list[tuple[str, object]]] = {}  # bodies with their inertias, by varied parameters
    for name, body in (base["model"].get("bodies") or {}).items():
        place = ("model", "bodies", name)
        if body.get("inertia") is None or (*place, "inertia") in varied:
            continue
        if (*place, "mass") in varied:
            common = names_in(body.get("mass")) & parameters_in_use(parameters, [body["inertia"]])
            advice = "write both as expressions of one parameter, and vary this parameter"
            if len(common) == 1:
                advice = f"vary parameters.{min(common)} instead"
            yield (
                f"the runs vary {path_text((*place, 'mass'))}, but not the inertia of body '{name}', "
                f"{body['inertia']}; to change both, {advice}"
            )
        elif not _depends(body["inertia"], parameters, names):
            of_mass = tuple(one for one in sorted(names) if _depends(body.get("mass"), parameters, {one}))
            through.setdefault(of_mass, []).append((name, body["inertia"]))
    for of_mass, bodies in through.items():
        if of_mass:
            (name, inertia), *others = bodies
            keys = listed([path_text(("parameters", one)) for one in of_mass], "and")
            more = f" (and in the same way for {counted(len(others), 'other body', 'other bodies')})" if others else ""
            yield (
                f"the runs vary the mass of body '{name}' through {keys}, but not its inertia, {inertia}{more}; to "
                f"change both, write the inertia as an expression of the same parameters"
            )


def _depends(text: object, parameters: Mapping[str, object], names: Set[str]) -> bool:
    """Return whether a value depends on any of the named parameters, also through other parameters."""
    return bool(parameters_in_use(parameters, [text]) & names)


def _varied(grid: Grid) -> list[Path]:
    """Return the key paths that the axes and the table of a grid set, each once."""
    values = [(key, value) for axis in grid.axes for key, found in axis for value in found]
    keys = [one for key, value in values for one in (value.value if value.together else (key,))]
    return [parse_key(key) for key in dict.fromkeys([*keys, *grid.table])]


def _of_distributions(spec: StudySpec, grid: Grid) -> Iterator[str]:
    """Yield a note for each normal distribution whose standard deviation, but not its mean, is near the value of the
    base, and for each truncated one whose center is outside of its limits, but would be inside if the limits were
    values of the variable.
    """
    base = json.loads(grid.base_json)
    for key, given in ({} if spec.sample is None else spec.sample.variables).items():
        (kind,), place = given, path_text(("sample", "variables", key))
        if kind not in ("normal", "norm", "truncnorm"):
            continue
        distribution, value = frozen(given), _number(base, parse_key(key))
        mean, std = float(distribution.mean()), float(distribution.std())
        if kind == "truncnorm":
            (low, high), (a, b) = distribution.support(), distribution.args
            center, scale = (distribution.kwds.get(name, value) for name, value in (("loc", 0.0), ("scale", 1.0)))
            if a <= center <= b and not low <= center <= high:
                advised = ", ".join(f"{x:.6g}" for x in ((a - center) / scale, (b - center) / scale, center, scale))
                yield (
                    f"{place}: the drawn values are between {low:g} and {high:g}, although loc is {center:g}, because "
                    f"the limits of `truncnorm` are relative to loc, in units of scale; for values between {a:g} and "
                    f"{b:g}, write [{advised}]"
                )
        elif value is not None and std > WIDE * abs(mean) > 0.0 and abs(value - std) < abs(value - mean):
            yield (
                f"{place}: the standard deviation of {std:g} is much larger than the mean of {mean:g}, but near the "
                f"value {value:g} of the base; the parameters of `{kind}` are the mean and the standard deviation, in "
                f"this order"
            )


def _number(base: dict[str, Any], path: Path) -> float | None:
    """Return the number at a key of a base spec in SI units; None if there is none."""
    if path[:1] == ("parameters",) and len(path) == 2:
        return parameter_values(base.get("parameters") or {}).get(str(path[1]))
    found: Any = base
    with suppress(LookupError, TypeError, SpecError):
        for part in path:
            found = found[part]
        if isinstance(found, int | float):
            return float(found)
        quantity = read_quantity(found)
        return None if quantity is None else quantity[0]
    return None


def start_warnings_of_study(specs: Iterable[RunSpec]) -> list[str]:
    """Return a list with a warning if starts after assembly do not follow the initial values that runs vary.

    Otherwise, the list is empty.

    Parameters
    ----------
    specs
        Specs of some runs of the study, such as the first and the last.
    """
    free = [spec for spec in specs if spec.model_item.name == "mechanism"]
    if not free or any(set(spec.mechanism().bodies) != set(free[0].mechanism().bodies) for spec in free):
        return []
    given = np.array([_given(spec) for spec in free])
    if not np.any(np.ptp(given, axis=0)):
        return []
    starts, changes, kept, has_freedom = Starts(), [], [], True
    for spec, values in zip(free, given, strict=True):
        with suppress(SpecError):  # the run reports this error itself
            setup = RunSetup.of(spec, starts)
            start, compiled = setup.start, setup.workspace.mechanism
            has_freedom = compiled.coordinates > int(np.sum(compiled.topology.rows))
            changes.append(np.hstack([start.q.reshape(-1, 3), start.v.reshape(-1, 3)]) - values)
            kept.append(values)
    if len(kept) < 2:
        return []
    off, span = np.ptp(changes, axis=0), np.ptp(kept, axis=0)
    share = np.divide(off, span, out=np.zeros_like(off), where=span > ROUNDING * np.max(np.abs(kept)))
    body, column = np.unravel_index(int(np.argmax(share)), share.shape)
    if not share[body, column] > KEPT:
        return []
    values, moves = (np.array(some)[:, body, column] for some in (kept, changes))
    ends = [int(np.argmin(values)), int(np.argmax(values))]
    (a, b), moved = values[ends], (values + moves)[ends]
    key = path_text(("model", "bodies", list(free[0].mechanism().bodies)[body], *KEYS[column]))
    linked = "the joints connect it with other initial values; vary all that belong together, by one parameter"
    fixed = "joints and drivers leave the mechanism no freedom; vary its dimensions or the motions of its drivers"
    text = (
        f"the runs vary {key} from {a:.4g} to {b:.4g}, but the start after assembly from {moved[0]:.4g} to "
        f"{moved[1]:.4g}, because {linked if has_freedom else fixed}"
    )
    return [text]


def _given(spec: RunSpec) -> np.ndarray:
    """Return the given initial coordinates and velocities of all bodies, (B, 6)."""
    bodies = spec.mechanism().bodies.values()
    return np.array([(*body.position, body.angle, *body.velocity, body.angular_velocity) for body in bodies])
