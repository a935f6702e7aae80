"""Warnings about angles and motions in radians that are probably meant in degrees."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import numpy as np
from pydantic import BaseModel

from mbdkit.base.plain_data import Path, path_text
from mbdkit.base.strict_model import description
from mbdkit.base.text import listed
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program, execute
from mbdkit.mechanism.joints import Driver
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.motion_corners import jet_of
from mbdkit.mechanism.parameter_units import outside_pure_functions
from mbdkit.mechanism.parameters import RESERVED, evaluate, names_in, parameters_in_use
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.mechanism.values import Table
from mbdkit.spec import RunSpec
from mbdkit.spec.model_spec import ModelSpec

#: Angles above one turn that are computed from parameters are assumed to be degrees if they have at most this many
#: decimals; radians rarely have so few. Angles given as numbers may have any number of decimals.
DIGITS = 3

TABLE_DIGITS = 1  #: As `DIGITS`, for all values of a table, one of which is above one turn.

#: Numbers of times and of values of sines and cosines for the swing of an oscillation, and of times for positions at
#: rest.
TIMES, PHASES, SAMPLES = 20, 32, 1000

#: The golden angle [rad]: its multiples are spread evenly over a turn.
GOLDEN = math.pi * (3.0 - math.sqrt(5.0))

AT_REST = 1e-9  #: A motion is at rest if its rate is at most this share of its largest rate.

#: Rotations from rest to rest by a larger number of radians are not taken for degrees; they may be those of a motor.
MOST_DEGREES = 360.0

RATE = 45.0  #: Multiples of this rate [rad/s], as in ``90*t``, are taken for degrees per second.

_ANGLE = re.compile(r"\[(m or )?rad\]")


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
        if isinstance(angle, str) and not names_in(angle) <= RESERVED:
            continue  # a function of variables, such as the equation of a coupling
        value = evaluate(angle, {}) if isinstance(angle, str) else float(angle)
        is_number = written is None or isinstance(spec.parameters.get(written), int | float)
        if not looks_like_degrees(value):
            continue
        if is_number or round(value, DIGITS) == value:
            origin = f" (from {listed((f'parameters.{name}' for name in used), 'and')})" if used else ""
            degrees = written or f"{value:.16g}"
            yield (
                f"the angle of {value:g} rad at {path_text(path)}{origin} is more than a full rotation; if degrees "
                f"are intended, write degrees({degrees}), otherwise an expression such as {value / math.pi:.6g}*pi"
            )


def looks_like_degrees(angle: float) -> bool:
    """Return whether an angle in radians is above one turn, and not a whole number of degrees that a script converted
    to radians.
    """
    return abs(angle) > 2.0 * math.pi and not _is_whole(math.degrees(angle))


def _is_whole(value: float) -> bool:
    """Return whether a number is an integer, up to the rounding errors of a conversion of units."""
    return math.isinf(value) or abs(value - round(value)) <= 1e-14 * abs(value)


def _is_length(spec: ModelSpec, path: Path) -> bool:
    """Return whether a path is that of the offset of a named coordinate that is a length."""
    if path[1] != "coordinates" or path[-1] != "offset":
        return False
    mechanism, name = spec.mechanism(), str(path[2])
    return name in mechanism.coordinates and QuantityNames(mechanism).coordinate(name).unit == "m"


def motions_in_degrees(spec: RunSpec) -> Iterator[str]:
    """Yield a warning for each driver of an angle whose table or expression in radians is probably meant in degrees."""
    for name, driver in spec.mechanism().joints.items():
        if not isinstance(driver, Driver) or driver.coordinate != "angle":
            continue
        if isinstance(driver.motion, Table):
            yield from _column_in_degrees(f"the table of driver '{name}'", driver.motion.table[1])
        elif isinstance(driver.motion, str):
            written = spec.written.get(("model", "joints", name, "motion"), driver.motion)
            swing = _swing(driver.motion, spec.time.start, spec.time.final, rates=written == driver.motion)
            if swing > 0.0 and not _is_in_radians(written, spec.parameters):
                yield (
                    f"the motion of driver '{name}', {written}, turns by {swing:.4g} rad, which is more than a full "
                    f"rotation; if its angles are in degrees, write them as in degrees(45), otherwise as multiples of "
                    f"pi, as in 14.3*pi"
                )


def _swing(motion: str, start: float, end: float, *, rates: bool) -> float:
    """Return the angle by which a motion oscillates, or turns from rest to rest, if it is more than a full rotation
    and improbable in radians; otherwise 0.

    Rotations from rest to rest, or at a constant rate, may be those of a motor. They are improbable only up to
    `MOST_DEGREES` with few decimals, or if the rate is a multiple of `RATE` and `rates` are looked at: names of
    parameters may say that they are those of a motor.
    """
    oscillation = _oscillation(Expression.parse(motion).program, np.linspace(start, end, TIMES))
    if 2.0 * math.pi < oscillation < math.inf and not _is_whole(math.degrees(oscillation)):
        return oscillation
    jet = jet_of(motion, np.linspace(start, end, SAMPLES))
    rate = float(jet.rate[0])
    if (
        rates
        and rate
        and np.ptp(jet.rate) == 0.0
        and rate % RATE == 0.0
        and (turned := abs(rate) * (end - start)) > 2.0 * math.pi
    ):
        return turned
    rests = jet.value[np.abs(jet.rate) <= AT_REST * np.max(np.abs(jet.rate))]
    turned = float(np.max(np.abs(np.diff(rests)), initial=0.0))
    is_round = abs(turned - round(turned, TABLE_DIGITS)) <= AT_REST * turned
    return turned if 2.0 * math.pi < turned <= MOST_DEGREES and is_round else 0.0


def _oscillation(program: Program, times: np.ndarray) -> float:
    """Return the largest swing of a motion at any of the `times` (T,) if the sines and cosines of the time in it had
    any values between -1 and 1, whatever their frequencies.
    """
    phases = np.arange(float(PHASES))
    waves = 0

    def step(name: str, number: float, *operands: np.ndarray) -> np.ndarray:
        nonlocal waves
        if name in ("sin", "cos"):
            waves += 1  # the first two values of all waves are -1 and 1
            return np.where(phases < 2, 2.0 * phases - 1.0, np.cos(GOLDEN * waves * phases))
        if not operands:
            return times[:, None] if name == "t" else np.array(number)
        return operands[0] ** int(number) if name == "powi" else OPERATIONS[name].array(*operands)

    with np.errstate(all="ignore"):
        values = np.broadcast_to(execute(program, step), (len(times), PHASES))
        return float(np.max(np.ptp(values, axis=1)))


def _is_in_radians(written: str, parameters: Mapping[str, float | str]) -> bool:
    """Return whether ``pi`` or ``degrees`` shows that an expression is in radians.

    They may also be in the expressions of its parameters, but not in arguments of functions such as ``sin``.
    """
    nodes = outside_pure_functions(ast.parse(written.strip(), mode="eval"))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    used = parameters_in_use(parameters, names)
    return not {"pi", "degrees"}.isdisjoint(names.union(*(names_in(parameters[name]) for name in used)))


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
        elif any(type(angle) is not float for angle in value) or (
            is_angle and any(abs(angle) > 2.0 * math.pi for angle in value)
        ):
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


@lru_cache(maxsize=256)
def _fields(model: type[BaseModel]) -> tuple[tuple[str, bool], ...]:
    return tuple((name, _ANGLE.search(description(model, name)) is not None) for name in model.model_fields)
