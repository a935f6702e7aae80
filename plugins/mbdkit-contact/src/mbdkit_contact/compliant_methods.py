"""Compliant contacts in controlled steps, which end where shapes begin or cease to touch.

See `mbdkit_contact.kernels.compliant_steps`. Fixed steps are left as they are; `mbdkit_contact.contact_criteria` warns
if they are so long that bodies can pass through each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.integrators.host.steps_to_changes import with_changes
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.start import treatment_method
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState
from mbdkit_contact.contact_section import ContactTreatment
from mbdkit_contact.events_of_contacts import ContactEvents
from mbdkit_contact.kernels.compliant_steps import (
    LEAST_CHANGE,
    SAME_PART,
    SAME_WAY,
    SHORTER_FROM_TOUCH,
    change_at,
    look,
)
from mbdkit_contact.kernels.event_bundle import NORMAL

PIECES = 4  #: Number of cubics that stand for the motion in a step with dense output.


@treatment_method
def compliant(
    method: Method, treatment: ContactTreatment
) -> StepMethod | ExternalMethod | Callable[[CompiledMethod], CompiledMethod]:
    """Return the method of a run whose controlled steps end where contacts begin and end."""
    if method.traits.compiled is not None:
        return _look_into_compiled if method.traits.tolerances is not None else lambda compiled: compiled
    steps = method if method.traits.steps is None else method.traits.steps()(method)
    assert isinstance(steps, StepMethod | ExternalMethod)
    return with_changes(steps, _change, _across)


def _look_into_compiled(method: CompiledMethod) -> CompiledMethod:
    workspace = method.workspace
    events = ContactEvents(EquationsOfMotion(workspace, states_at_start(workspace)))
    if events.contacts.names:
        dense = method.dense if method.has_dense_output else None
        events.bundle.inner[2] = 0 if dense is None else dense.address
        workspace.scratch.reacting.add_forces[:2] = 0, look.address
        method.looks_at = events  # type: ignore[attr-defined]
    return method


def _change(equations: EquationsOfMotion, t: float, begin: StepState, made: Step, end: float) -> float:
    """Return the share of a step at which a contact begins or ends, 1 if none does."""
    events = equations.derived(ContactEvents)
    if not events.contacts.names:
        return 1.0
    h, last, path, bundle = end - t, made.state, made.dense, events.bundle
    first, final = _ends(begin.q, begin.v), _ends(last.q, last.v)
    found, touches = float(change_at(events.pinned.address, *first, *final, h)), bool(np.any(bundle.touching))
    if path is not None and (found < 1.0 or np.any(bundle.touch.near)):  # else the cubic through both ends will do
        found = found if touches else 1.0  # a step from a touch goes no further than this cubic allows
        for k in range(PIECES):
            then = final if k == PIECES - 1 else _ends(*path((k + 1) / PIECES)[:2])
            share = float(change_at(events.pinned.address, *first, *then, h / PIECES))
            first = then
            if share < 1.0:
                found = min(found, (k + share) / PIECES)
                break
    if touches and not _meets_contact(equations, t, begin, last, end):
        found = min(found, SHORTER_FROM_TOUCH)
    same = SAME_PART * max(abs(t) / h, 1.0)
    return found + same if same < found < 1.0 - max(SAME_WAY, 2.0 * same) else 1.0


def _ends(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities with those of ground."""
    return np.append(q, np.zeros(3)), np.append(v, np.zeros(3))


def _meets_contact(equations: EquationsOfMotion, t: float, begin: StepState, last: StepState, end: float) -> bool:
    """See `mbdkit_contact.kernels.compliant_steps`."""
    first = equations.derivatives(t, begin.q, begin.v, begin.z)[0]
    by_contact = equations.derivatives(end, last.q, last.v, last.z)[0] - first
    own, mass = last.v - begin.v - (end - t) * first, equations.mass
    return bool(np.sum(mass * own**2) >= (LEAST_CHANGE * (end - t)) ** 2 * np.sum(mass * by_contact**2))


def _across(equations: EquationsOfMotion, t: float, begin: StepState) -> Step | None:
    """Return a step straight into a contact before which a library fails because a force jumps; None without one."""
    events = equations.derived(ContactEvents)
    h = 2.0 * SAME_PART * max(abs(t), 1.0)
    state = replace(begin, q=begin.q + h * begin.v, work=0.0, dissipated=0.0)
    change_at(events.pinned.address, *_ends(begin.q, begin.v), *_ends(state.q, state.v), h)  # writes the gaps
    begins = (events.bundle.begin[NORMAL] >= 0.0) & (events.bundle.gaps < 0.0)
    return Step(state, time=t + h) if np.any(begins) else None
