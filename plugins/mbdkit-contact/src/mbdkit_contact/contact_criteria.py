"""Criteria of runs with contacts: events at zeros of a slip, point masses that cannot roll, and slow friction."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.base.plain_data import quoted
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.mechanism.bodies import GROUND
from mbdkit.quantities.states import States
from mbdkit.runs.row_criteria import SHARE, FrictionElement, SlowFriction
from mbdkit.runs.run_seams import rows_criterion, spec_criterion
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.finding import Finding
from mbdkit_contact.quantities import contacts_in

_SLIP = re.compile(r"contacts(\.\w+|\[[^\]]+\])\.slip")


@spec_criterion
def slip_events(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a warning for each event that is the zero crossing of the slip of a contact."""
    for name, event in spec.events.items():
        if (slip := _SLIP.fullmatch(event.when.strip())) is not None:
            sentence = (
                f"event '{name}' watches the sign of {slip[0]}, which is zero except for rounding errors while the "
                f"contact sticks or rolls; to find the begin or end of slip, watch abs({slip[0]}) - 1e-6 with rigid "
                "contacts, or subtract the transition speed with compliant ones"
            )
            yield Finding("slip-events", "doubtful", sentence, f"events.{quoted(name)}.when", is_named=False)


@spec_criterion
def rolling_point_masses(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield a doubt about each point mass with a round shape that friction cannot turn."""
    mechanism = spec.mechanism()
    for name, contact in mechanism.contacts.items():
        for _, _, body, shape in contact.by_body:
            circle = shape.circle
            is_point_mass = body != GROUND and mechanism.bodies[body].inertia is None
            if is_point_mass and circle is not None and circle.radius > 0 and max(contact.friction_coefficients) > 0:
                sentence = (
                    f"body '{body}' is a point mass (it has no inertia), so that the friction of contact '{name}' does "
                    f"not turn its circle of {circle.radius:g} m, and it slides instead of rolling; give `inertia`"
                )
                yield Finding("rolling-point-masses", "doubtful", sentence, "model", is_named=False)


@rows_criterion
def slow_friction(spec: RunSpec, compiled: CompiledMechanism, size: float) -> SlowFriction | None:
    """Return the slow friction of the contacts of a mechanism; None if they are rigid, or cannot touch."""
    if compiled.reacting is not None or not compiled.extensions["contacts"]:
        return None
    elements = []
    for name, contact in spec.mechanism().contacts.items():
        assert contact.compliance is not None
        key, speed = f"contacts.{quoted(name)}.compliance", contact.compliance.transition_speed
        elements.append(FrictionElement(f"contact '{name}'", key, speed, 1.0, SHARE * size))

    def take(states: States) -> tuple[np.ndarray, np.ndarray]:
        values = states.of(contacts_in)
        slip, friction = (values[name][:, : len(elements)] for name in ("slip", "friction_force"))
        return slip, slip * friction

    return SlowFriction(elements, take)
