"""Warnings about values of a spec that are valid but probably unintended, such as angles in degrees, inertias in
kg mm^2 or an initial state in which joints are far from closed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

from mbdkit.base.text import counted, did_you_mean, listed
from mbdkit.engine.assembly import AssembledState
from mbdkit.mechanism.beams import written_key
from mbdkit.mechanism.improbable_bodies import improbable_bodies, improbable_inertias, improbable_people
from mbdkit.mechanism.improbable_values import (
    improbable_beams,
    improbable_frictions,
    improbable_lengths,
    rolling_point_masses,
)
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import parameters_in_use
from mbdkit.mechanism.size import mechanism_size
from mbdkit.muscles.acting_muscles import acting_muscles
from mbdkit.runs.angles_in_degrees import angles_in_degrees, motions_in_degrees
from mbdkit.runs.notes import short_runs, zero_reactions
from mbdkit.spec import RunSpec
from mbdkit.trust.criteria import rounding
from mbdkit.trust.energy_record import EnergyRecord

FAR = 0.1
"""Share of the mechanism's size by which assembly may change the initial positions without a warning."""

CHANGED = 0.01
"""Share of a given velocity by which assembly may change it without a warning: more than the rounding of a value to
three digits, which is at most 0.005 of it.
"""

FEWEST_PER_PERIOD = 2
"""Smallest number of steps per period that resolves an oscillation."""

LONGEST_TURN = 0.2
"""Angle [rad] by which a stiff beam may turn in an implicit step; measured, see the page `beams`."""

REGAINED = 10.0
"""A decrease of the dissipated energy up to this multiple of the largest energy balance may be an integration error."""

_SLIP = re.compile(r"contacts(\.\w+|\[[^\]]+\])\.slip")


def spec_warnings(spec: RunSpec, measures: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the warnings of the model, and those about effects that it lacks, unresolved beams, unused parameters,
    short runs, zero reactions, improbable values, long steps, excitations and events.

    Parameters
    ----------
    measures
        Expressions that are evaluated for the run, in addition to the measures of the spec.
    """
    found = (*_known(spec, measures), *_left_out(spec), *_improbable(spec), *_long_step(spec), *_excitations(spec))
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

    Excluded are warnings about intended limits of model and step, about unused parameters, short runs and reactions
    that are always zero, and those that the spec accepts.
    """
    known: tuple[str, ...] = (*_known(spec), *accepted_doubts(spec, warnings)) if warnings else ()
    return tuple(warning for warning in warnings if warning not in known)


def accepted_doubts(spec: RunSpec, warnings: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings that question the result, but are accepted by the spec."""
    own = _left_out(spec) if "left-out" in spec.accept else ()
    others = tuple(f"{name}: " for name in spec.accept if name != "left-out")
    return (*own, *(warning for warning in warnings if others and warning.startswith(others)))


def _left_out(spec: RunSpec) -> tuple[str, ...]:
    """Return warnings about effects that the mechanism lacks, which begin with the name of their criterion."""
    mechanism = spec.mechanism()
    return tuple(f"left-out: {sentence}" for sentence in (*mechanism.left_out, *mechanism.left_out_of_runs))


def _known(spec: RunSpec, measures: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the warnings that do not question the result."""
    notes = (*short_runs(spec), *zero_reactions(spec, spec.defined_measures()))
    return (*spec.mechanism().warnings, *_unresolved_beams(spec), *_unused_parameters(spec, measures), *notes)


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
    yield from motions_in_degrees(spec)
    yield from improbable_inertias(spec.mechanism())
    yield from improbable_frictions(spec.mechanism())
    yield from rolling_point_masses(spec.mechanism())
    yield from improbable_beams(spec.mechanism())
    yield from improbable_lengths(spec.mechanism())
    yield from improbable_bodies(spec.mechanism())
    yield from improbable_people(spec.model)


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


def _unused_parameters(spec: RunSpec, measures: Sequence[str] = ()) -> Iterator[str]:
    if not spec.parameters:
        return
    used = parameters_in_use(spec.parameters, [*spec.written.values(), *spec.expressions_outside_model, *measures])
    for name in spec.parameters:
        if name not in used:
            hint = did_you_mean(name, [other for other in spec.parameters if other != name])
            yield f"the parameter at parameters.{name} is not used{hint}"
