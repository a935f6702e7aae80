"""Warnings about values of a spec that are valid but probably unintended, such as angles in degrees, inertias in
kg mm^2 or an initial state in which joints are far from closed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import numpy as np
from pydantic import BaseModel

from mbdkit.base.plain_data import Path, path_text
from mbdkit.base.strict_model import description
from mbdkit.base.text import counted, did_you_mean, listed
from mbdkit.engine.assembly import AssembledState
from mbdkit.mechanism.beams import written_key
from mbdkit.mechanism.improbable_values import (
    improbable_beams,
    improbable_frictions,
    improbable_inertias,
    improbable_lengths,
    rolling_point_masses,
)
from mbdkit.mechanism.joints import Driver
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import evaluate, names_in, parameters_in_use
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.mechanism.size import mechanism_size
from mbdkit.mechanism.values import Table
from mbdkit.muscles.acting_muscles import acting_muscles
from mbdkit.spec import RunSpec
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.trust.criteria import rounding
from mbdkit.trust.energy_record import EnergyRecord

FAR = 0.1
"""Share of the mechanism's size by which assembly may change the initial positions without a warning."""

CHANGED = 0.01
"""Share of a given velocity by which assembly may change it without a warning: more than the rounding of a value to
three digits, which is at most 0.005 of it.
"""

DIGITS = 3
"""Angles above one turn that are computed from parameters are assumed to be degrees if they have at most this many
decimals; radians rarely have so few. Angles given as numbers may have any number of decimals.
"""

TABLE_DIGITS = 1
"""As `DIGITS`, for all values of a table, one of which is above one turn."""

FEWEST_PER_PERIOD = 2
"""Smallest number of steps per period that resolves an oscillation."""

LONGEST_TURN = 0.2
"""Angle [rad] by which a stiff beam may turn in an implicit step; measured, see the page `beams`."""

REGAINED = 10.0
"""A decrease of the dissipated energy up to this multiple of the largest energy balance may be an integration error."""

_SLIP = re.compile(r"contacts(\.\w+|\[[^\]]+\])\.slip")
_ANGLE = re.compile(r"\[(m or )?rad\]")


def spec_warnings(spec: RunSpec) -> tuple[str, ...]:
    """Return the warnings of the model, and those about effects that it lacks, unresolved beams, unused parameters,
    improbable values, long steps, excitations and events.
    """
    found = (*_known(spec), *_left_out(spec), *_improbable(spec), *_long_step(spec), *_excitations(spec))
    return (*found, *_slip_events(spec))


def mechanism_warnings(spec: RunSpec) -> tuple[str, ...]:
    """Return the warnings that also apply without a run: those of the model, and those about effects that it lacks,
    unused parameters and improbable values.
    """
    return (*spec.mechanism().warnings, *_left_out(spec), *_unused_parameters(spec), *_improbable(spec))


def start_warnings(spec: RunSpec, start: AssembledState) -> tuple[str, ...]:
    """Return warnings if assembly moved the start by more than a tenth of the mechanism's size, or changed a velocity
    that the spec gives by more than 1 % of it.

    Parameters
    ----------
    start
        The initial state after assembly.
    """
    if not start.changed:
        return ()
    return (*_moved_start(spec.mechanism(), start), *_changed_velocities(spec.mechanism(), start))


def _moved_start(mechanism: Mechanism, start: AssembledState) -> Iterator[str]:
    points: dict[str, set[tuple[float, float]]] = {name: {(0.0, 0.0)} for name in mechanism.bodies}
    for joint in mechanism.joints.values():
        for _, name, point in joint.attachments():
            points.get(name, set()).add(point)
    moved, name = 0.0, ""
    for (body, given), (x, y, angle) in zip(mechanism.bodies.items(), start.q.tolist(), strict=True):
        now = given.model_copy(update={"position": (x, y), "angle": angle})
        for point in points[body]:
            distance = math.dist(given.to_global(point), now.to_global(point))
            moved, name = max((moved, name), (distance, body))
    size = mechanism_size(mechanism, start.q)
    if moved > FAR * size:
        yield (
            f"assembly moves a point of {name} by {moved:.3g} m at the start, more than a tenth of the mechanism's "
            f"size of {size:.3g} m; check the positions and angles at {_key(mechanism, name)} and its neighbours, "
            f"because the mechanism may have been assembled in an unintended configuration (`mbdkit validate` lists "
            f"all changes)"
        )


def _changed_velocities(mechanism: Mechanism, start: AssembledState) -> Iterator[str]:
    changes = []
    for (name, body), (vx, vy, rate) in zip(mechanism.bodies.items(), start.v.tolist(), strict=True):
        for what, unit, given, now in (
            ("velocity", "m/s", body.velocity, (vx, vy)),
            ("angular velocity", "rad/s", (body.angular_velocity,), (rate,)),
        ):
            size = math.hypot(*given)
            if size > 0.0 and (change := math.dist(given, now) / size) > CHANGED:
                texts = [", ".join(f"{x:.4g}" for x in values) for values in (given, now)]
                texts = texts if len(given) == 1 else [f"({text})" for text in texts]
                changes.append((change, name, f"the {what} of {name} from {texts[0]} to {texts[1]} {unit}"))
    if changes:
        _, name, largest = max(changes)
        others = f", and {counted(len(changes) - 1, 'other velocity', 'other velocities')}" if len(changes) > 1 else ""
        yield (
            f"assembly changes {largest} at the start{others}, because the velocities of the bodies do not satisfy "
            f"the joints; check those at {_key(mechanism, name)} and its neighbours: velocities that are not given "
            f"are zero"
        )


def _key(mechanism: Mechanism, body: str) -> str:
    return written_key(mechanism.beams, "bodies", body) if mechanism.name == "mechanism" else "model"


def doubts(spec: RunSpec, warnings: Sequence[str]) -> tuple[str, ...]:
    """Return those warnings of a run that question its result.

    Excluded are warnings about intended limits of model and step, about unused parameters, and those that the spec
    accepts.
    """
    known: tuple[str, ...] = (*_known(spec), *accepted_doubts(spec)) if warnings else ()
    return tuple(warning for warning in warnings if warning not in known)


def accepted_doubts(spec: RunSpec) -> tuple[str, ...]:
    """Return the warnings that question the result, but are accepted by the spec."""
    return _left_out(spec) if "left-out" in spec.accept else ()


def _left_out(spec: RunSpec) -> tuple[str, ...]:
    """Return warnings about effects that the mechanism lacks, which begin with the name of their criterion."""
    return tuple(f"left-out: {sentence}" for sentence in spec.mechanism().left_out)


def _known(spec: RunSpec) -> tuple[str, ...]:
    """Return the warnings that do not question the result."""
    return (*spec.mechanism().warnings, *_unresolved_beams(spec), *_unused_parameters(spec))


def passivity_warnings(mechanism: Mechanism, energies: EnergyRecord) -> tuple[str, ...]:
    """Return a warning about passive force laws if the dissipated energy of a run has decreased."""
    least = max(REGAINED * energies.balance, rounding(energies.energy))
    laws = [
        f"{force.law_id} of force '{name}'"
        for name, force in mechanism.forces.items()
        if isinstance(force, Law) and force.force_law.passive
    ]
    if not laws or not energies.regained > least:
        return ()
    which = f"one of the laws {listed(laws, 'and')}" if len(laws) > 1 else f"the law {laws[0]}"
    sentence = (
        f"the dissipated energy decreases by up to {energies.regained:.3g} J, because {which} supplies energy although "
        f"it is declared passive; correct its options, or declare it without `passive`, so that its power counts as "
        f"work"
    )
    return (sentence,)


def _improbable(spec: RunSpec) -> Iterator[str]:
    """Yield warnings about values that are valid but improbable, most of them because of another unit."""
    yield from angles_in_degrees(spec)
    yield from tables_in_degrees(spec)
    yield from improbable_inertias(spec.mechanism())
    yield from improbable_frictions(spec.mechanism())
    yield from rolling_point_masses(spec.mechanism())
    yield from improbable_beams(spec.mechanism())
    yield from improbable_lengths(spec.mechanism())


def angles_in_degrees(spec: ModelSpec) -> Iterator[str]:
    """Yield a warning for each angle of the model above one turn that is probably meant in degrees.

    Whole numbers of degrees, converted to radians by a script, and expressions are assumed to be meant in radians.
    """
    for path, angle in _angles(spec.model, ("model",)):
        if not isinstance(angle, _SCALARS):
            yield from _column_in_degrees(f"the column of angles at {path_text(path)}", angle)
            continue
        if not isinstance(angle, str) and abs(angle) <= 2.0 * math.pi:
            continue
        written = spec.written.get(path)
        used = [name for name in spec.parameters if name in names_in(written)]
        if _is_length(spec, path):
            continue
        if "t" in names_in(written) or (not used and (written is not None or isinstance(angle, str))):
            continue  # functions of time and expressions of numbers are assumed to be in radians
        value = evaluate(angle, {}) if isinstance(angle, str) else float(angle)
        is_number = written is None or isinstance(spec.parameters.get(written), int | float)
        if abs(value) <= 2.0 * math.pi or _is_whole(math.degrees(value)):
            continue
        if is_number or round(value, DIGITS) == value:
            origin = f" (from {listed((f'parameters.{name}' for name in used), 'and')})" if used else ""
            degrees = written or f"{value:.16g}"
            yield (
                f"the angle of {value:g} rad at {path_text(path)}{origin} is more than a full rotation; if degrees "
                f"are intended, write degrees({degrees}), otherwise an expression such as {value / math.pi:.6g}*pi"
            )


def _is_whole(value: float) -> bool:
    """Return whether a number is an integer, up to the rounding errors of a conversion of units."""
    return abs(value - round(value)) <= 1e-14 * abs(value)


def _is_length(spec: ModelSpec, path: Path) -> bool:
    """Return whether a path is that of the offset of a named coordinate that is a length."""
    if path[1] != "coordinates" or path[-1] != "offset":
        return False
    mechanism, name = spec.mechanism(), str(path[2])
    return name in mechanism.coordinates and QuantityNames(mechanism).coordinate(name).unit == "m"


def tables_in_degrees(spec: RunSpec) -> Iterator[str]:
    """Yield a warning for each driver of an angle whose table of radians is probably meant in degrees."""
    for name, driver in spec.mechanism().joints.items():
        if not isinstance(driver, Driver) or driver.coordinate != "angle" or not isinstance(driver.motion, Table):
            continue
        yield from _column_in_degrees(f"the table of driver '{name}'", driver.motion.table[1])


def _column_in_degrees(what: str, angles: Sequence[float]) -> Iterator[str]:
    """Yield a warning if a column of a table in radians is probably meant in degrees; `what` names the column."""
    values = np.array(angles)
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest > 2.0 * math.pi and np.array_equal(np.round(values, TABLE_DIGITS), values):
        yield (
            f"{what} reaches {largest:g} rad, which is more than a full rotation; if degrees are intended, convert its "
            f"values to radians, otherwise give them with more decimals"
        )


_SCALARS = (int, float, str)


def _angles(
    value: object, path: Path, *, is_angle: bool = False
) -> Iterator[tuple[Path, float | str | Sequence[float]]]:
    """Yield the key path and the number or text of each option of a model that is an angle in radians.

    Of a table with two columns, only the first contains angles; it is yielded as a whole. Lists of angles of at most
    one turn are left out.
    """
    if isinstance(value, _SCALARS):  # compared first, because tests for abstract classes are slow
        if is_angle:
            yield path, value
    elif isinstance(value, list | tuple):
        if is_angle and len(value) == 2 and all(isinstance(column, list | tuple) for column in value):
            yield (*path, 0), value[0]
        elif not _is_flat(value) or (is_angle and any(abs(one) > 2.0 * math.pi for one in value)):
            for index, item in enumerate(value):
                yield from _angles(item, (*path, index), is_angle=is_angle)
    elif isinstance(value, BaseModel):
        is_length = (isinstance(value, Driver) and value.coordinate != "angle") or (
            isinstance(value, Law) and value.pathway.length_unit != "rad"
        )
        for name, is_angular in _fields(type(value)):
            item = getattr(value, name)
            if not is_angular and (item is None or isinstance(item, _SCALARS)):
                continue
            in_radians = is_angular and not is_length
            yield from _angles(item, (*path, name), is_angle=in_radians)
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _angles(item, (*path, name), is_angle=is_angle)


def _is_flat(values: Sequence[object]) -> bool:
    """Return whether a sequence consists of floats."""
    return all(type(value) is float for value in values)


@lru_cache(maxsize=256)
def _fields(model: type[BaseModel]) -> tuple[tuple[str, bool], ...]:
    """Return the names of the fields of a model, and whether their unit is the radian."""
    return tuple((name, _ANGLE.search(description(model, name)) is not None) for name in model.model_fields)


def _long_step(spec: RunSpec) -> Iterator[str]:
    length = spec.time.final - spec.time.start
    if spec.time.step is not None and spec.time.step > length * (1.0 + 1e-9):
        yield (
            f"the step of {spec.time.step:g} s at time.step is longer than the run of {length:g} s; the run takes a "
            f"single, shorter step"
        )


def _excitations(spec: RunSpec) -> Iterator[str]:
    """Yield a warning for each muscle whose excitation leaves the range 0 to 1 as a function of time."""
    for name, muscle in acting_muscles(spec.mechanism()).items():
        if (outside := muscle.excitation_outside(spec.time.start, spec.time.final)) is not None:
            time, value = outside
            reached = f"{value:.3g} at t = {time:.6g} s"
            yield f"the excitation of muscle '{name}' is {reached}; it should stay between 0 and 1"


def _slip_events(spec: RunSpec) -> Iterator[str]:
    """Yield a warning for each event that is the zero crossing of the slip of a contact."""
    for name, event in spec.events.items():
        if (slip := _SLIP.fullmatch(event.when.strip())) is not None:
            yield (
                f"event '{name}' watches the sign of {slip[0]}, which is zero except for rounding errors while the "
                f"contact sticks or rolls; to find the begin or end of slip, watch abs({slip[0]}) - 1e-6 with rigid "
                "contacts, or subtract the transition speed with compliant ones"
            )


def _unresolved_beams(spec: RunSpec) -> Iterator[str]:
    """Yield a warning for each beam whose oscillations are not resolved by the fixed steps of an implicit method."""
    step, beams = spec.time.step, spec.mechanism().beams
    if not beams or step is None:
        return
    claims = spec.claims
    if claims.adaptive or "tangents" not in claims.needs:
        return  # step-size control resolves them, and explicit methods fail visibly
    fate = "keeps the energy of faster motions, but not their frequencies" if claims.symmetric else "damps faster ones"
    for name, beam in beams.items():
        fastest, slowest = beam.highest_frequency, 2.0 * math.pi / (FEWEST_PER_PERIOD * step)
        if fastest > slowest:
            yield (
                f"the elements of beam '{name}' oscillate at up to {fastest:.3g} rad/s, but the step of {step:g} s "
                f"resolves motions below {slowest:.3g} rad/s only; {spec.integrator_item.name} {fate}"
            )


def step_advice(spec: RunSpec, code: str) -> str:
    """Return sentences that attribute the failure of a step to the beams or the dry friction of the mechanism; empty if
    neither applies.
    """
    step, mechanism = spec.time.step, spec.mechanism()
    if code != "newton-failed" or step is None:
        return ""
    advice = ""
    if mechanism.beams:
        advice += (
            f" Stiff beams may turn by at most about {LONGEST_TURN:g} rad in an implicit step; with the step of this "
            f"run, this is a rate of {LONGEST_TURN / step:.3g} rad/s (see `mbdkit guide beams`)."
        )
    if any(getattr(joint, "friction", None) is not None for joint in mechanism.joints.values()):
        advice += (
            " If a joint with friction comes to rest in this step, use an implicit method with `adaptive: true`, or a "
            "larger `transition_speed`."
        )
    return advice


def _unused_parameters(spec: RunSpec) -> Iterator[str]:
    if not spec.parameters:
        return
    used = parameters_in_use(spec.parameters, [*spec.written.values(), *spec.expressions_outside_model])
    for name in spec.parameters:
        if name not in used:
            hint = did_you_mean(name, [other for other in spec.parameters if other != name])
            yield f"the parameter at parameters.{name} is not used{hint}"
