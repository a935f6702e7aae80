"""The criteria of mbdkit that examine the spec, the start and the end of a run.

They find values that are valid but probably unintended, such as angles in degrees, inertias in kg mm^2, or an initial
state in which joints are far from closed. `mbdkit.builtin_features` lists them; `CriterionItem` says what they take.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import path_text
from mbdkit.base.text import counted, did_you_mean, listed
from mbdkit.engine.assembly import AssembledState
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.mechanism.beams import written_key
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.improbable_bodies import improbable_bodies, improbable_inertias, improbable_people
from mbdkit.mechanism.improbable_values import (
    improbable_beams,
    improbable_frictions,
    improbable_lengths,
    improbable_preloads,
)
from mbdkit.mechanism.joint_base import FunctionJoint
from mbdkit.mechanism.joints import Driver, Joint
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.size import mechanism_size
from mbdkit.mechanism.values import Table
from mbdkit.methods.baumgarte_stability import stiff_baumgarte
from mbdkit.quantities.quantity import Quantity
from mbdkit.runs.angles_in_degrees import angles_in_degrees, motions_in_degrees
from mbdkit.runs.method_evidence import evidence_of
from mbdkit.runs.preparation import make_method
from mbdkit.runs.run_seams import end_criterion, spec_criterion, start_criterion
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.trust.criteria import rounding
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit.trust.finding import Finding

#: Share of the mechanism's size by which assembly may change the initial positions without a warning.
FAR = 0.1

TURNED = 0.5  #: Angle [rad] by which assembly may turn a body without a warning.

#: Share of a given velocity by which assembly may change it without a warning: more than the rounding of a value to
#: three digits, which is at most 0.005 of it.
CHANGED = 0.01

_EVIDENCE = "method-evidence"  #: Name of a criterion.

FEWEST_PER_PERIOD = 2  #: Smallest number of steps per period that resolves an oscillation.

#: Angle [rad] by which a stiff beam may turn in an implicit step; measured, see the page `beams`.
LONGEST_TURN = 0.2

#: Share of the duration of a table, without constant values at its end, that a run covers without a note.
COVERED = 0.5

#: A decrease of the dissipated energy up to this multiple of the largest energy balance may be an integration error.
REGAINED = 10.0


@spec_criterion
def unstable_baumgarte(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[str]:
    """Yield a warning if Baumgarte's terms are unstable with the step of a run."""
    if spec.stabilized.kind == "baumgarte":
        method, name = make_method(spec), spec.integrator_item.name
        yield from stiff_baumgarte(name, method, spec.claims, spec.stabilized, spec.time.step)


@spec_criterion
def model_notes(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[str]:
    """Yield what the model says about its mechanism, and a remark on gravity that points up."""
    yield from spec.mechanism().warnings
    x, y = spec.mechanism().gravity
    if x == 0.0 and y > 0.0:
        yield f"gravity [0, {y:g}] points up, because y does; bodies fall with [0, -{y:g}]"


@spec_criterion
def left_out(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a doubt about each effect that the file of a model describes, but the mechanism lacks."""
    mechanism = spec.mechanism()
    for sentence in (*mechanism.left_out, *mechanism.left_out_of_runs):
        yield Finding("left-out", "doubtful", sentence, "model")


@start_criterion
def moved_start(spec: RunSpec, start: AssembledState) -> Iterator[str]:
    """Yield a warning if assembly moves a point by more than a tenth of the mechanism's size, or turns a body far."""
    if not start.changed:
        return
    mechanism = spec.mechanism()
    points: dict[str, set[tuple[float, float]]] = {name: {(0.0, 0.0)} for name in mechanism.bodies}
    for joint in mechanism.joints.values():
        for _, name, point in joint.attachments():
            points.get(name, set()).add(point)
    moved, name, turn, turned = 0.0, "", 0.0, ""
    for (body, given), (x, y, angle) in zip(mechanism.bodies.items(), start.q.tolist(), strict=True):
        turn, turned = max((turn, turned), (abs(angle - given.angle), body))
        now = given.model_copy(update={"position": (x, y), "angle": angle})
        for point in points[body]:
            distance = math.dist(given.to_global(point), now.to_global(point))
            moved, name = max((moved, name), (distance, body))
    size, what = mechanism_size(mechanism, start.q), ""
    if moved > FAR * size:
        what = f"moves a point of {name} by {moved:.3g} m at the start, more than a tenth of the mechanism's size of "
        what += f"{size:.3g} m; check the positions and angles at {_key(mechanism, name)} and its neighbours"
    elif turn > TURNED:
        what = f"turns {turned} by {turn:.3g} rad at the start; check the angle at {_key(mechanism, turned)}, those of "
        what += "its neighbours, and the motions of drivers, which give angles with their whole turns"
    if what:
        yield (
            f"assembly {what}, because the mechanism may have been assembled in an unintended configuration (`mbdkit "
            f"validate` lists all changes){_accepted('moved-start')}"
        )


@start_criterion
def changed_velocities(spec: RunSpec, start: AssembledState) -> Iterator[str]:
    """Yield a warning if assembly changes a velocity that the spec gives by more than 1 % of it."""
    if not start.changed:
        return
    mechanism = spec.mechanism()
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
            f"are zero{_accepted('changed-velocities')}"
        )


def _accepted(criterion: str) -> str:
    return (
        f"; if this is intended, `mbdkit validate SPEC --assembled FILE` writes the spec with the initial values after "
        f"assembly, or write `accept: [{criterion}]`"
    )


def _key(mechanism: Mechanism, body: str) -> str:
    return written_key(mechanism.beams, "bodies", body) if mechanism.name == "mechanism" else "model"


@end_criterion
def passive_laws(spec: RunSpec, energies: EnergyRecord) -> Iterator[str]:
    """Yield a warning about passive force laws if the dissipated energy of a run has decreased."""
    least = max(REGAINED * energies.balance, rounding(energies.energy))
    laws = [
        f"{force.law_id} of force '{name}'"
        for name, force in spec.mechanism().forces.items()
        if isinstance(force, Law) and force.force_law.passive
    ]
    if not laws or not energies.regained > least:
        return
    which = f"one of the laws {listed(laws, 'and')}" if len(laws) > 1 else f"the law {laws[0]}"
    yield (
        f"the dissipated energy decreases by up to {energies.regained:.3g} J, because {which} supplies energy although "
        f"it is declared passive; correct its options, or declare it without `passive`, so that its power counts as "
        f"work"
    )


@spec_criterion
def degrees(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[str]:
    """Yield warnings about angles that are probably in degrees."""
    yield from angles_in_degrees(spec)
    yield from motions_in_degrees(spec)


@spec_criterion
def improbable_values(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield doubts about masses and friction that are valid but improbable, most of them because of another unit."""
    mechanism = spec.mechanism()
    yield from _improbable("inertias", improbable_inertias(mechanism))
    yield from _improbable("frictions", improbable_frictions(mechanism))


@spec_criterion
def improbable_sizes(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield doubts about sizes that are valid but improbable, most of them because of another unit."""
    mechanism = spec.mechanism()
    yield from _improbable("beams", improbable_beams(mechanism))
    yield from _improbable("lengths", improbable_lengths(mechanism))
    yield from _improbable("preloads", improbable_preloads(mechanism))
    yield from _improbable("bodies", improbable_bodies(mechanism))
    yield from _improbable("people", improbable_people(spec.model))


def _improbable(what: str, sentences: Iterable[str]) -> Iterator[Finding]:
    for sentence in sentences:
        yield Finding(f"improbable-{what}", "doubtful", sentence, "model", is_named=False)


@spec_criterion
def long_step(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a doubt if the step is longer than the run."""
    length = spec.time.final - spec.time.start
    if spec.time.step is not None and spec.time.step > length * (1.0 + 1e-9):
        sentence = (
            f"the step of {spec.time.step:g} s at time.step is longer than the run of {length:g} s; the run takes a "
            f"single, shorter step"
        )
        yield Finding("long-step", "doubtful", sentence, "time.step", is_named=False)


@spec_criterion
def unresolved_beams(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[str]:
    """Yield a warning for each beam whose oscillations are not resolved by the fixed steps of an implicit method."""
    step, beams, claims = spec.time.step, spec.mechanism().beams, spec.claims
    if not beams or step is None:
        return
    # Step-size control resolves them, and explicit methods fail visibly.
    if claims.adaptive or "tangents" not in claims.needs:
        return
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


@spec_criterion
def unused_parameters(spec: RunSpec, measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a note for each parameter that no expression of a spec uses."""
    used = spec.used_parameters(measures) if spec.parameters else set()
    for name in spec.parameters:
        if name not in used:
            hint = did_you_mean(name, [other for other in spec.parameters if other != name])
            sentence = f"the parameter at parameters.{name} is not used{hint}"
            yield Finding("unused-parameters", None, sentence, f"parameters.{name}", is_named=False)


@spec_criterion
def method_evidence(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a doubt about a method of another distribution that failed its checks or has changed since, and a remark on
    one that was never verified.
    """
    if spec.choose == "method" or (item := spec.integrator_item).origin.distribution == MBDKIT:
        return
    word, why, _ = evidence_of(item, spec.integrator)
    if word == "verified" or (word == "never" and _EVIDENCE in spec.accept):
        return
    what = {"never": "was never verified", "failed": "failed its checks"}.get(word, "has changed since it was checked")
    remedy = f"`mbdkit plugins verify {item.id} --record` checks it, and `accept: [{_EVIDENCE}]` accepts it"
    sentence = f"the method {item.id} {what}: {why}; {remedy}"
    yield Finding(_EVIDENCE, None if word == "never" else "doubtful", sentence, "integrator")


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
