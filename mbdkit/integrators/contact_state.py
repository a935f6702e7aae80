"""Data of rigid contacts that one step passes to the next: modes, forces and impacts."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.contact_forces import HELD, ActingContact, held_coordinates
from mbdkit.integrators.interface import StepTaken
from mbdkit.methods.step_methods import Step, StepEvent, StepState

SOLVED = 1e-6
"""`ContactState.remarks` mentions relative errors of the velocities of contacts that are larger than this."""


class ContactImpact(NamedTuple):
    """An impact of a contact.

    Time [s], index of the contact, its impulses [N s], energy dissipated at all contacts together [J], and impulses
    (J, 3) of the joints caused by all contacts [N s, N m s]; see `EquationsOfMotion.reactions`.
    """

    time: float
    contact: int
    normal_impulse: float
    tangential_impulse: float
    energy_lost: float
    reactions: np.ndarray


@dataclass(frozen=True)
class ContactState:
    """Data of contacts that one step passes to the next.

    Attributes
    ----------
    modes, normal, tangent
        (C,) modes and forces [N] at the end of the step.
    force
        (n,) generalized forces of all contacts [N, N m].
    impacts
        All impacts so far.
    energy
        Largest kinetic energy so far [J].
    cut
        Names of contacts whose infinite sequence of impacts was cut short.
    changed
        Names of contacts at which a law of impact other than the chosen one was used.
    undetermined
        Names of contacts whose normal forces were not unique.
    ordered
        Names of contacts with simultaneous impacts, in another order of which their velocities would be different.
    cut_time
        Time at which a sequence of impacts was first cut short [s].
    time
        Time at which the step ended [s]; before its planned end if there was an event.
    event
        Event to be applied before the next step, or None. See `mbdkit.integrators.event_driven`.
    streak
        Number of consecutive steps that ended at an event.
    is_over_step
        Whether the forces are means over the step, not values at its end.
    undecided
        First time at which several contacts that affect each other have closed at once, in an unknown order [s].
    residual
        Largest error of the velocities of contacts, relative to the largest velocity in the same step.
    accelerations
        Accelerations that a time-stepping method passes to its next step.
    owed
        Energy that a time-stepping method has added by moving overlapping shapes apart, and that contacts have not
        dissipated yet [J].
    features
        (C,) see `mbdkit.integrators.contact_kinematics.ContactKinematics.held`.
    between
        Memory of the method that takes the steps between events; None after an event.
    """

    modes: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    force: np.ndarray
    impacts: tuple[ContactImpact, ...] = ()
    energy: float = 0.0
    cut: frozenset[str] = frozenset()
    changed: frozenset[str] = frozenset()
    undetermined: frozenset[str] = frozenset()
    ordered: frozenset[str] = frozenset()
    cut_time: float = math.inf
    time: float = math.inf
    event: tuple[int, int] | None = None
    streak: int = 0
    is_over_step: bool = False
    undecided: float = math.inf
    residual: float = 0.0
    accelerations: tuple[np.ndarray, ...] = ()
    owed: float = 0.0
    features: np.ndarray | None = None
    between: Any = None

    def after_stop(self) -> ContactState:
        """Return the state after a discontinuity of a motion or load; the next step determines the modes anew."""
        return replace(self, modes=np.zeros(0, dtype=int), accelerations=(), between=None)

    def remarks(self) -> tuple[str, ...]:
        """Return sentences about sequences of impacts that were cut short, about impacts computed with another law than
        the chosen one, about normal forces that are not unique, about simultaneous impacts whose order would matter,
        and about inaccurate velocities of contacts.
        """
        found = []
        if self.cut:
            names = listed(sorted(self.cut), "and")
            found.append(
                f"an infinite sequence of impacts was cut off at {names}: the contact stays closed after the last one "
                "that was computed; `/impacts` has the time at which the impacts would have accumulated"
            )
        if self.changed:
            names = listed(sorted(self.changed), "and")
            found.append(
                f"the law of impact would have created energy at {names}; Stronge's law was used there or, for several "
                "contacts at once, the law of the run or Poisson's law with a smaller restitution"
            )
        if self.undetermined:
            names = listed([f"'{name}'" for name in sorted(self.undetermined)], "and")
            several = len(self.undetermined) > 1
            which = f"forces of contacts {names} are" if several else f"force of contact {names} is"
            found.append(
                f"the normal {which} not unique, because other forces cause the same motion; the run records one "
                "possible set"
            )
        if self.ordered:
            names = listed([f"'{name}'" for name in sorted(self.ordered)], "and")
            found.append(
                f"impacts of contacts {names} coincide, and the run computes them together; if they happened one after "
                "another, for example because of a tiny gap, the velocities after them would be different"
            )
        if self.residual > SOLVED:
            found.append(
                f"the laws of contact and friction are satisfied to {self.residual:.1g} of the largest velocity only, "
                "in the worst step; a smaller `time.step` may help"
            )
        return tuple(found)


class HeldForces:
    """Forces and modes of rigid contacts as first-order states, which are constant within each step."""

    def __init__(self, contacts: Iterable[ActingContact]):
        rigid = [one for one in contacts if one.first_state >= 0]
        self._first = rigid[0].first_state if rigid else 0
        self._contacts, self._coordinates = len(HELD) * len(rigid), held_coordinates(rigid)
        self.count = self._contacts + len(self._coordinates)

    def others(self, mechanism: CompiledMechanism) -> list[str]:
        """Return the names of the first-order states of the mechanism that do not belong to contacts."""
        own = range(self._first, self._first + self.count)
        return [state.name for number, state in enumerate(mechanism.states) if number not in own]

    def of(self, memory: ContactState | None) -> np.ndarray:
        """Return the states (Z,) from the memory of the method; zeros before the first step."""
        z = np.zeros(self.count)
        if self.count and memory is not None:
            modes = memory.modes if len(memory.modes) else np.zeros(len(memory.normal))  # unknown after a stop
            z[: self._contacts] = np.stack([memory.normal, memory.tangent, np.abs(modes)], axis=1).ravel()
            z[self._contacts :] = memory.force[self._coordinates]
        return z


def held_step(
    contacts: Iterable[ActingContact],
    times: tuple[float, float],
    begin: StepState,
    end: StepState,
    event: StepEvent | None = None,
) -> Step:
    """Return a step from `begin` to `end`, whose memory is a `ContactState`, with the forces as first-order states.

    The forces are constant within the step if they are means over the step, or not known at its start.
    """
    memory = end.memory
    end = replace(end, z=HeldForces(contacts).of(memory))
    if begin.memory is not None and not memory.is_over_step:
        return Step(end, event=event)
    taken = StepTaken(*times, begin.q, begin.v, end.q, end.v, end.z, end.z)
    return Step(end, dense=taken.between, event=event)


def contacts_of(stepper: object) -> ContactState | None:
    """Return the data of rigid contacts with their impacts so far; None if the run of a stepper has none."""
    memory = getattr(getattr(getattr(stepper, "now", None), "state", None), "memory", None)
    return memory if isinstance(memory, ContactState) else None
