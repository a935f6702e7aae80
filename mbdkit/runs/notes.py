"""Notes on a spec that do not question its results: runs that end long before their tables, and zero reactions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import path_text
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.joint_base import FunctionJoint
from mbdkit.mechanism.joints import Driver, Joint
from mbdkit.mechanism.values import Table
from mbdkit.quantities.quantity import Quantity
from mbdkit.runs.run_seams import spec_criterion
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.trust.finding import Finding

#: Share of the duration of a table, without constant values at its end, that a run covers without a note.
COVERED = 0.5


@spec_criterion
def short_runs(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a note for each table of a motion, load or excitation that changes long after the end of the run."""
    start, end = spec.span
    for key, motion in spec.mechanism().motions():
        if not isinstance(motion, Table):
            continue
        times, values = motion.table
        last = times[max((row for row in range(1, len(times)) if values[row] != values[row - 1]), default=0)]
        if end - start < COVERED * (last - times[0]):
            sentence = (
                f"the table at {key} changes from {times[0]:g} s to {last:g} s, but the run goes from {start:g} s to "
                f"{end:g} s, less than half of it; if the whole table is intended, set time.end to {last:g}"
            )
            yield Finding("short-runs", None, sentence, key, is_named=False)


@spec_criterion
def zero_reactions_of_run(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[str]:
    """Yield a note for each reaction in the measures of a run that is always zero."""
    return zero_reactions(spec, spec.defined_measures())


def zero_reactions(spec: RunSpec, measures: Iterable[DefinedMeasure]) -> Iterator[str]:
    """Yield a note for each reaction in the measures of a run that is always zero, because the joint cannot transmit
    it.
    """
    for measure in measures:
        if ".torque" not in measure.expression and ".force" not in measure.expression:
            continue  # before the expression is parsed
        with suppress(SpecError):  # an invalid measure is refused elsewhere
            parsed = MeasureExpression.parse(measure.expression, spec, measure.unit)
            yield from zero_reactions_in(spec, path_text(measure.place), parsed)


def zero_reactions_in(spec: RunSpec, where: str, expression: MeasureExpression) -> Iterator[str]:
    """Yield a note for each reaction in an expression, which is at `where`, that is always zero."""
    joints = spec.mechanism().joints
    for quantity in dict.fromkeys(expression.quantities):
        if quantity.kind == "joints" and (why := _not_transmitted(joints[quantity.name], quantity)):
            yield f"{quantity} in {where} is always zero, because {why}"


def _not_transmitted(joint: Joint, reaction: Quantity) -> str:
    """Return why a joint cannot transmit a reaction; empty if it can, and for other quantities."""
    if isinstance(joint, FunctionJoint):  # its force and torque follow from the derivatives of its functions
        return ""
    kind = f"a {joint.type} joint" if not isinstance(joint, Driver) else f"a driver of {joint.coordinate}"
    if reaction.attribute == "torque" and "rad" not in joint.units and getattr(joint, "center", None) is None:
        has_friction = getattr(joint, "friction", None) is not None
        friction = f"; the torque of its friction is joints.{reaction.name}.friction" if has_friction else ""
        return f"{kind} transmits no torque{friction}"
    if not reaction.attribute.startswith("force"):
        return ""
    if "m" not in joint.units:
        return f"{kind} transmits no force"
    in_first = reaction.attribute.startswith("force_first_") or joint.bodies[0] == GROUND
    if joint.travel is None or not in_first or not reaction.attribute.endswith(("_x", "_y")):
        return ""
    x, y = joint.travel[4:]
    along, across = (x, y) if reaction.attribute.endswith("x") else (y, x)
    if isinstance(joint, Driver):
        return f"{kind} transmits a force along this axis only" if along == 0.0 else ""
    return f"{kind} transmits no force along its axis" if across == 0.0 else ""
