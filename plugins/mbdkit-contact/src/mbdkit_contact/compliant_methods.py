"""Compliant contacts in controlled steps, which end where shapes begin or cease to touch.

See `mbdkit_contact.kernels.compliant_steps`. Fixed steps are left as they are; `mbdkit_contact.contact_criteria` warns
if they are so long that bodies can pass through each other.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.integrators.interface import SAME_INSTANT
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.start import treatment_method
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState, Why
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

MOST_CUTS = 20  #: Largest number of times that a library is opened again in one step.
PIECES = 4  #: Number of cubics that stand for the motion in a step with dense output.


@treatment_method
def compliant(
    method: Method, treatment: ContactTreatment
) -> StepMethod | ExternalMethod | Callable[[CompiledMethod], CompiledMethod]:
    """Return the method of a run whose controlled steps end where contacts begin and end."""
    if method.traits.compiled is not None:
        return _look_into_compiled if method.traits.tolerances is not None else lambda compiled: compiled
    steps = method if method.traits.steps is None else method.traits.steps()(method)
    if isinstance(steps, ExternalMethod):
        return CompliantLibrary(steps)
    assert isinstance(steps, StepMethod)
    return steps if steps.tolerances is None else CompliantSteps(steps)


def _look_into_compiled(method: CompiledMethod) -> CompiledMethod:
    workspace = method.workspace
    events = ContactEvents(EquationsOfMotion(workspace, states_at_start(workspace)))
    if events.contacts.names:
        dense = method.dense if method.has_dense_output else None
        events.bundle.inner[2] = 0 if dense is None else dense.address
        workspace.scratch.reacting.add_forces[:] = 0, look.address
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


class CompliantSteps(StepMethod):
    """A method in Python with controlled steps that end where compliant contacts begin and end.

    Parameters
    ----------
    method
        The method that takes the steps.
    """

    def __init__(self, method: StepMethod):
        self.method = method
        self.tolerances, self.error_order, self.hint = method.tolerances, method.error_order, method.hint
        self.carries_multipliers = method.carries_multipliers  # type: ignore[misc]

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> object:
        """See `StepMethod.begin`."""
        return self.method.begin(equations, t, state, why)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        """Take a step; reject it if a contact begins or ends within it, and ask for the part before."""
        new = self.method.step(equations, t, state, h)
        made = new if isinstance(new, Step) else Step(new)
        share = _change(equations, t, state, made, t + h) if made.accepted and made.time is None else 1.0
        return made if share == 1.0 else replace(made, accepted=False, next_step=share * h)


class CompliantLibrary(ExternalMethod):
    """A library with a loop of its own whose steps end where compliant contacts begin and end.

    If a contact begins or ends within a step, the library is opened again at the start of this step, with that point as
    its end, and then there.

    Parameters
    ----------
    library
        The library.
    """

    def __init__(self, library: ExternalMethod):
        self._given = library
        self.tolerances, self.hint = library.tolerances, library.hint
        self.carries_multipliers = library.carries_multipliers  # type: ignore[misc]

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        """See `ExternalMethod.open`."""
        self._library, self._equations, self._stop = copy.copy(self._given), equations, stop
        self._open(t, state, stop)

    def _open(self, t: float, state: StepState, until: float) -> None:
        self._now, self._until, self._ended = (t, state), until, False
        self._library.open(self._equations, t, state, until)

    def advance(self) -> Step:
        """See `ExternalMethod.advance`."""
        if self._ended:
            self._open(*self._now, self._stop)
        t, begin = self._now
        for _ in range(MOST_CUTS):
            made = self._advance()
            assert made.time is not None
            end = float(made.time)
            if (share := _change(self._equations, t, begin, made, end)) == 1.0:
                break
            self._open(t, begin, t + share * (end - t))
        self._now = end, made.state
        self._ended |= self._now[0] >= self._until - SAME_INSTANT * max(abs(self._until), 1.0)
        return made

    def _advance(self) -> Step:
        """Return a step of the library, or straight into a contact before which it fails because a force jumps."""
        try:
            return self._library.advance()
        except StepError as error:
            (t, begin), events = self._now, self._equations.derived(ContactEvents)
            h = 2.0 * SAME_PART * max(abs(t), 1.0)
            state = replace(begin, q=begin.q + h * begin.v, work=0.0, dissipated=0.0)
            change_at(events.pinned.address, *_ends(begin.q, begin.v), *_ends(state.q, state.v), h)  # writes the gaps
            begins = (events.bundle.begin[NORMAL] >= 0.0) & (events.bundle.gaps < 0.0)
            if error.code != "step-too-small" or not np.any(begins):
                raise
        self._ended = True
        return Step(state, time=t + h)

    def cut(self, t: float) -> StepState | None:
        """See `ExternalMethod.cut`."""
        return self._library.cut(t)

    def save(self) -> bytes | None:
        """See `ExternalMethod.save`: nothing where the library is opened again."""
        own = self._library.save()
        return b"" if self._ended and own is not None else own

    def restore(self, stored: bytes) -> None:
        """See `ExternalMethod.restore`."""
        if stored:
            self._library.restore(stored)
