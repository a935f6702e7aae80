"""Event-driven contacts of one mechanism: their arrays, and calls of their kernels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.system import NOT_FINITE, OK
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.loop.step_loop import PAUSED
from mbdkit.integrators.run.impulse import ElementImpact
from mbdkit_contact.acting_contacts import position_error
from mbdkit_contact.contact_section import ContactTreatment
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.kernels.contact_forces import new_closed_contacts
from mbdkit_contact.kernels.contact_modes import react
from mbdkit_contact.kernels.event_bundle import (
    CHANGED,
    CUT,
    KEPT_STRIKES,
    MORE_ROOM,
    NO_IMPULSES,
    NO_MODES,
    OPEN_JOINTS,
    ORDERED,
    PAINLEVE,
    UNDETERMINED,
    ZENO,
    EventBundle,
    EventSearch,
    Known,
    Newton,
    Touch,
)
from mbdkit_contact.kernels.impacts import LAWS, new_impacts
from mbdkit_contact.kernels.steps_to_events import MOST_EVENTS, close_at, forces_at, happen_at
from mbdkit_contact.modes import OPEN, STICK
from mbdkit_contact.rigid_contacts import RigidContacts, zeros

#: Codes and clauses of the reasons for which a step fails.
FAILURES: dict[int, tuple[str, str]] = {
    PAINLEVE: ("painleve", "the friction of contact {name} presses it together more than it is pressed"),
    NO_MODES: ("painleve", "no forces at contact {name} satisfy Coulomb's law"),
    NO_IMPULSES: ("contact-solver", "no impulses of the contacts satisfy the law of impact"),
    ZENO: ("zeno", f"contacts changed {MOST_EVENTS} times without a step between"),
    OPEN_JOINTS: ("newton-failed", "no positions with closed joints and contacts were found"),
}
#: Number of contacts that may act at once before larger arrays are needed, and largest number of samples in a step.
FIRST_ROOM, MOST_SAMPLES = 8, 64
#: Least value of the largest velocity of a motion, so that rounding errors of bodies at rest count as zero, relative to
#: that of a fall over the length of the mechanism, or without gravity, to this length per second.
SLOWEST = 1e-3
MOST_SHARES = 1024  #: Size of ``Known.shares``.
#: Arrays that steps in Python pass to the next step.
_PASSED = tuple(name for name in Known._fields if name not in ("number", "rows", "strikes"))


def _new_known(count: int, size: int, pairs: int, held: int) -> Known:
    shapes = {
        "modes normal tangent": (count,), "shares": (MOST_SHARES,), "force shift_q shift_v": (size,), "energy": (1,),
        "rows": (max(2 * KEPT_STRIKES, 4 * count), 6), "strikes": (KEPT_STRIKES, size + 2 * pairs), "until": (2,),
        "shown": (2, held),
    }  # fmt: skip
    counts = {"basis": (1 + 2 * count,), "determined event number": (2,), "streak": (1,), "flags": (4, count)}
    return Known(**zeros(shapes), **zeros(counts, np.int64), features=np.full(count, -1.0), times=np.full(2, np.inf))


class ContactEvents:
    """Event-driven contacts of a mechanism in one run.

    Parameters
    ----------
    equations
        The equations of motion, whose forces do not include those of contacts.
    """

    def __init__(self, equations: EquationsOfMotion):
        self.p, self.contacts = equations, RigidContacts(equations, only_reacting=False)
        self.workspace: Workspace = equations.workspace
        self.impacts: list[ElementImpact] = []
        top, size = self.workspace.mechanism.topology, equations.n + 3
        count, pairs, held = len(self.contacts.names), len(top.pairs), self.contacts.held

        fall = equations.length * float(np.hypot(*top.gravity))
        slowest = SLOWEST * (math.sqrt(fall) if fall > 0.0 else equations.length)
        self._shapes = self.contacts.shapes
        given: dict[str, Any] = {
            "coefficients": self.contacts.coefficients,
            "limits": np.array([0.0, equations.length, np.sum(equations.mass[::3]), 0.0, 0.0, slowest]),
            "places": np.array([held.states.start, len(held.states)]),
            "coordinates": np.array(held.coordinates, dtype=np.int64),
            "known": _new_known(count, size, pairs, len(held.states)),
            "still": top._replace(gravity=np.zeros(2)),
            "search": EventSearch(
                np.zeros((3, count, 2)), np.zeros((3, count, 4)), np.zeros((3, count)), np.zeros((3, count)),
                np.zeros(count), np.zeros(4, np.int64), np.zeros(7), np.zeros(1), np.zeros(2, np.int64), np.zeros(1),
            ),
            "touch": Touch(
                np.zeros(count, np.int64), self.contacts.arms, np.zeros((4, size)), np.zeros((size // 3, 7)),
                np.zeros((size // 3, 7)), np.zeros((4, 2)), np.zeros((4, size)),
            ),
            **self._of_room(max(1, min(count, FIRST_ROOM)), size, pairs),
        }  # fmt: skip
        given |= zeros({
            "q v a free x y rest": (size,),
            "normal tangent sliding approach pace gaps modes kept_modes kept_features": (count,),
            "values begin end": (3, count),
            "rows": (count, 16),
            "lam lam_x": (pairs, 2),
            "z": (len(equations.z0),),
            "t": (1,),
            "gained": (2,),
            "sample_times": (MOST_SAMPLES,),
            "sample_values": (MOST_SAMPLES, 3, count),
            "shares": (MOST_SHARES,),
        })  # fmt: skip
        counts = {"engine law pauses power": (1,), "ended reason": (2,), "samples": (3,), "inner": (4,)}
        given |= zeros({**counts, "basis": (1 + 2 * count,), "touching struck": (count,)}, np.int64)
        self.bundle = EventBundle(**given)
        self.pinned = PinnedBundle(self.bundle)
        self.contacts.hold(self.contacts.own(equations.z0))
        self._take_up_addresses()

    def _of_room(self, most: int, size: int, pairs: int) -> dict[str, Any]:
        """Return the arrays of up to `most` contacts that act at once."""
        unknowns, forces = self.workspace.unknowns, 2 * most
        newton = Newton(
            answers=np.zeros((forces, unknowns), complex),
            right=np.zeros(max(unknowns, forces), complex),
            sites=np.zeros((forces, 2), dtype=np.int64),
            held=np.zeros((forces, 6)),
            matrix=np.zeros((forces, forces), complex),
            inverse=np.zeros((forces, forces), complex),
            key=np.full(3, -1),
            real=np.zeros(unknowns),
            solved=np.zeros(unknowns),
        )
        closed = new_closed_contacts(self._shapes, most, size, pairs)
        return {"closed": closed, "newton": newton, "impacts": new_impacts(most)}

    @classmethod
    def on(cls, equations: EquationsOfMotion, treatment: ContactTreatment) -> ContactEvents:
        """Return the contacts of equations of motion, and exclude their forces, computed here, from the equations."""
        events = equations.derived(cls)
        events.use(treatment)
        return events

    def use(self, treatment: ContactTreatment) -> None:
        """Use the law of impact of a treatment, and its limit of energies, or that of bounces that rounding hides."""
        hidden = position_error(self.workspace.q0.reshape(-1, 3)) / self.p.length
        self.bundle.law[0], self.bundle.limits[0] = LAWS.index(treatment.impact_law), max(treatment.rest_energy, hidden)

    def _take_up_addresses(self) -> None:
        """Take up the addresses of all arrays, which may have changed."""
        self.bundle.engine[0] = self.workspace.stepping_engine
        reacting = self.workspace.scratch.reacting
        reacting.add_forces[0], reacting.engine[0] = react.address, self.workspace.stepping_engine
        reacting.elements[0] = self.pinned.address

    def grow(self) -> None:
        """Allocate arrays for twice as many contacts that act at once."""
        bundle = self.bundle
        most, size, pairs = 2 * len(bundle.closed.chosen), len(bundle.q), len(bundle.lam)
        self.bundle = bundle._replace(**self._of_room(most, size, pairs))
        self.pinned.replace(self.bundle)
        self._take_up_addresses()

    # ---- impacts and what one step passes to the next --------------------------------------------------------------

    def take_impacts(self) -> list[ElementImpact]:
        """Return the impacts that kernels have stored since the last call."""
        known, n, p = self.bundle.known, self.p.n, self.p
        rows, strikes = known.rows[: known.number[0]], known.strikes[: known.number[1]]
        unknowns = self.workspace.mechanism.row_index
        impacts, reactions = list[ElementImpact](), list[np.ndarray]()
        times = {int(row[5]): float(row[0]) for row in rows}
        for number, strike in enumerate(strikes):
            lam, pairs = np.zeros(p.m), strike[n + 3 :].reshape(-1, 2)
            lam[unknowns[unknowns >= 0] - n] = pairs[unknowns >= 0]
            reactions.append(p.reactions(times.get(number, 0.0), strike[:n].copy(), lam))
        none = 0.0 * p.reactions(0.0, p.q0, np.zeros(p.m)) if len(rows) > 0 else np.zeros((0, 3))
        for time, contact, normal, tangent, lost, strike_of in rows.tolist():
            own = none if strike_of < 0 else reactions[int(strike_of)]
            impacts.append(ElementImpact(time, int(contact), normal, tangent, lost, own))
        known.number[:] = 0
        return impacts

    def serve(self) -> None:
        """See `mbdkit.integrators.stages.compiled_method.CompiledMethod.serve`."""
        if np.any(self.bundle.known.number):  # an impact without impulses has a place, but no row
            self.impacts += self.take_impacts()

    def resume(self) -> None:
        """See `mbdkit.integrators.stages.compiled_method.CompiledMethod.resume`."""
        if self.bundle.reason[0] == MORE_ROOM:
            if np.any(self.bundle.known.number):
                self.serve()
            else:
                self.grow()
        self.bundle.reason[0] = 0

    def state(self, impacts: tuple[ElementImpact, ...] = (), **more: Any) -> ContactState:
        """Return the present data of the contacts, with impacts so far."""
        known, named = self.bundle.known, self.contacts.named
        return ContactState(
            known.modes.astype(int),
            known.normal.copy(),
            known.tangent.copy(),
            known.force[:-3].copy(),
            impacts=impacts,
            cut=named(known.flags[CUT]),
            changed=named(known.flags[CHANGED]),
            undetermined=named(known.flags[UNDETERMINED]),
            ordered=named(known.flags[ORDERED]),
            cut_time=float(known.times[0]),
            undecided=float(known.times[1]),
            known={name: getattr(known, name).copy() for name in _PASSED},
            **more,
        )

    @contextmanager
    def as_in(self, memory: ContactState) -> Iterator[None]:
        """Use the modes of the step that has ended with `memory`; what the next step takes up does not change."""
        kept = {name: getattr(self.bundle.known, name).copy() for name in _PASSED}
        self._use(memory.known)
        try:
            yield
        finally:
            self._use(kept)

    def held_at(self, t: float, q: np.ndarray, v: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return the first-order states (Z,) with the forces of contacts at a point; see `at`."""
        self.at(t, q, v, own)
        self.show_forces()
        known = self.bundle.known
        return self.contacts.all_states(own, ContactState(known.modes, known.normal, known.tangent, known.force))

    def _use(self, arrays: Mapping[str, np.ndarray]) -> None:
        for name in _PASSED:
            getattr(self.bundle.known, name)[...] = arrays[name]

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Use the arrays of a `ContactState`; without any, those of contacts before the first step."""
        known, bundle = self.bundle.known, self.bundle
        if not arrays:
            arrays = _new_known(len(known.modes), len(known.force), len(bundle.lam), known.shown.shape[1])._asdict()
        self._use(arrays)
        self.check_indices()
        while np.count_nonzero(known.modes != OPEN) > len(self.bundle.closed.chosen):
            self.grow()

    def check_indices(self) -> None:
        """Raise ValueError if data from a file contain places of arrays that do not exist."""
        known, shapes = self.bundle.known, self._shapes
        starts = np.append(np.unique(shapes.contacts[:, 2]), len(shapes.kinds))  # rows may share their features
        counts = starts[np.searchsorted(starts, shapes.contacts[:, 2], side="right")] - shapes.contacts[:, 2]
        whole = known.features == np.round(known.features)
        forces = np.count_nonzero(known.modes != OPEN) + np.count_nonzero(known.modes == STICK)
        basis = known.basis[1 : 1 + forces * (known.basis[0] != 0)]  # what lies behind is left from other modes
        if (
            np.any(known.event < 0)
            or known.event[0] > 3
            or known.event[1] >= max(1, len(known.modes))
            or np.any(known.number < 0)
            or np.any(known.number > [len(known.rows), len(known.strikes)])
            or not 0 <= known.basis[0] <= forces
            or np.any((basis < 0) | (basis >= forces))
            or not np.all(whole & (known.features >= -1) & (known.features < counts))
            or not np.all(np.isin(known.modes, (-2.0, 0.0, 1.0, 2.0)))
        ):
            raise ValueError("a contact, a feature or a mode does not exist")

    # ---- calls of kernels ------------------------------------------------------------------------------------------

    @property
    def modes(self) -> np.ndarray:
        """(C,) modes of the contacts."""
        return self.bundle.known.modes

    def at(self, t: float, q: np.ndarray, v: np.ndarray, own: np.ndarray) -> None:
        """Look at a point: time, positions and velocities (n,), and the states that do not belong to contacts."""
        bundle, n = self.bundle, self.p.n
        bundle.t[0], bundle.q[:n], bundle.v[:n] = t, q, v
        bundle.z[:] = self.contacts.all_states(own)

    def called(self, kernel: Callable[..., int], *given: float) -> None:
        """Call a kernel at the point that returns a status; raise StepError if there is no solution."""
        reacting = self.workspace.scratch.reacting
        acts = int(reacting.acts[0])

        def solve(t: float) -> int:
            self._take_up_addresses()
            reacting.acts[0] = 0  # the kernels add the forces of contacts themselves
            while (status := int(kernel(self.workspace.stepping_engine, self.pinned.address, *given))) == PAUSED:
                self.grow()
            return status if status in (OK, NOT_FINITE) or not self.bundle.reason[0] else NOT_FINITE

        try:
            self.p.solved_by(solve, float(self.bundle.t[0]))
        except (StepError, SingularSystemError):
            self.raise_failure()
            raise
        finally:
            reacting.acts[0] = acts

    def raise_failure(self) -> None:
        """Raise StepError if the last call has failed for a reason of contacts."""
        if (failure := self.failure) is not None:
            self.bundle.reason[0] = 0
            raise failure

    @property
    def failure(self) -> StepError | None:
        """Why the last call has failed, if that is a reason of contacts."""
        reason, contact = self.bundle.reason.tolist()
        if reason not in FAILURES:
            return None
        code, clause = FAILURES[reason]
        return StepError(code, clause.format(name=f"'{self.contacts.names[contact]}'"))

    def happen(self, kind: int, contact: int) -> None:
        """Apply an event to the point, or determine the modes anew if `kind` is negative."""
        self.called(happen_at, kind, contact)

    def show_forces(self) -> None:
        """Evaluate accelerations, multipliers and forces at the point; the forces are data for the next step."""
        self.called(forces_at)

    def close(self) -> None:
        """Close joints and contacts at the point."""
        self.called(close_at)

    @contextmanager
    def acting(self) -> Iterator[None]:
        """Let closed contacts act in the equations of motion."""
        reacting = self.workspace.scratch.reacting
        before = reacting.acts[0]
        self._take_up_addresses()
        reacting.acts[0] = 1
        try:
            yield
        finally:
            reacting.acts[0] = before
            reacting.power[0] = 0.0
