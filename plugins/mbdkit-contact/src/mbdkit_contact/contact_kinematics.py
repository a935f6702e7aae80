"""Kinematics of rigid contacts: gaps, slips, and their derivatives in a state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mbdkit.engine.contact_forces import ActingContact
from mbdkit_contact.near_contacts import NearContacts
from mbdkit_contact.polygon_features import EXACT, Feature, features_of, shape_pairs

NEAR = 1e-3
"""Gap, relative to the length of the mechanism, up to which two shapes count as near each other."""
FEW = 8
"""Up to this number of contacts of a kind, evaluating them one by one is faster than with arrays."""


@dataclass(frozen=True)
class Rows:
    """Gaps and slips of C contacts in a state, with their derivatives.

    Attributes
    ----------
    gap, slip
        (C,) gaps [m] and slip velocities [m/s].
    normal_right, tangent_right
        (C,) right-hand sides of the constraints on accelerations; see `mbdkit.symbolic.contact_rows.row_function`.
    bodies
        (C, 2) indices of the two bodies of each contact.
    gradients
        (2, C, 6) derivatives of the rates of gap and slip with respect to the velocities of both bodies.
    n
        Number of coordinates.
    """

    gap: np.ndarray
    slip: np.ndarray
    normal_right: np.ndarray
    tangent_right: np.ndarray
    bodies: np.ndarray
    gradients: np.ndarray
    n: int

    @cached_property
    def columns(self) -> np.ndarray:
        """(C, 6) indices of the coordinates of both bodies; those of the ground come after all others."""
        return (3 * self.bodies[:, :, None] + np.arange(3)).reshape(len(self.bodies), 6)

    @cached_property
    def normal(self) -> np.ndarray:
        """(C, n) derivatives of the rates of the gaps with respect to the velocities."""
        return self._whole(self.gradients[0])

    @cached_property
    def tangent(self) -> np.ndarray:
        """(C, n) derivatives of the slip velocities with respect to the velocities."""
        return self._whole(self.gradients[1])

    def _whole(self, parts: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(parts), self.n + 3))
        np.put_along_axis(rows, self.columns, parts, axis=1)
        return rows[:, : self.n]

    def rates(self, v: np.ndarray) -> np.ndarray:
        """Return the rates of the gaps and the slip velocities (2, C) at velocities (n,)."""
        return np.asarray(np.sum(self.gradients * np.concatenate([v, np.zeros(3)])[self.columns], axis=2))

    def force(self, forces: np.ndarray) -> np.ndarray:
        """Return the generalized forces (n,) of normal and tangential forces (2, C)."""
        parts = np.sum(forces[:, :, None] * self.gradients, axis=0)
        return np.bincount(self.columns.ravel(), parts.ravel(), self.n + 3)[: self.n]


class _Alike(NamedTuple):
    """Features of one kind of geometry.

    Their indices among all features, their bodies (2, K), and the N numbers that describe the geometry of each (N, K).
    """

    kind: tuple[str, int]
    places: np.ndarray
    bodies: np.ndarray
    numbers: np.ndarray

    @classmethod
    def of(cls, features: Sequence[Feature], kind: tuple[str, int]) -> _Alike:
        places = [i for i, one in enumerate(features) if one.kind == kind]
        some = [features[i] for i in places]
        bodies, numbers = np.array([one.bodies for one in some]).T, np.array([one.numbers for one in some]).T
        return cls(kind, np.array(places), bodies, numbers)


class ContactKinematics:
    """Gaps and rows of the contacts of a mechanism.

    Parameters
    ----------
    contacts
        The contacts.
    n
        Number of coordinates of the mechanism.
    length
        Characteristic length of the mechanism [m].

    Attributes
    ----------
    held
        (C,) index of the feature at which each closed contact stays; -1 for open contacts, which use the feature
        nearest to touching. See `mbdkit_contact.polygon_features`.
    """

    def __init__(self, contacts: Sequence[ActingContact], n: int, length: float):
        self._n, self._exact = n, EXACT * length
        self._bodies = np.array([one.bodies for one in contacts], dtype=int).reshape(-1, 2)
        own = [features_of(one) for one in contacts]
        features = [feature for some in own for feature in some]
        self._first = np.cumsum([0, *(len(some) for some in own)], dtype=int)[:-1]
        kinds = [one.kind for one in features]
        self._alike = [_Alike.of(features, kind) for kind in dict.fromkeys(kinds)]
        #: For each of F features, its index among the features of its kind, and the index of its kind.
        self._place, self._kind = np.zeros((2, len(features)), dtype=int)
        for number, alike in enumerate(self._alike):
            self._place[alike.places], self._kind[alike.places] = np.arange(len(alike.places)), number
        self._polygons = shape_pairs(contacts, self._exact)
        self._reach = NEAR * length if len(contacts) > FEW else math.inf
        self._near = NearContacts(features, self._reach) if len(contacts) > FEW and not self._polygons else None
        self.held = self.none_held()

    def none_held(self) -> np.ndarray:
        """Return `held` for contacts that are all open."""
        return np.full(len(self._first), -1)

    def hold(self, q: np.ndarray, closed: np.ndarray) -> None:
        """Fix the features of closed contacts (C,): those fixed already, else the features nearest to touching at
        position `q`.
        """
        if self._polygons:
            held, some = self.none_held(), np.flatnonzero(closed)
            held[some] = self._chosen(self._states(q, 0.0 * q), some)[0]
            self.held = held

    def margins(self, q: np.ndarray) -> np.ndarray:
        """Return the distances [m] by which contacts (C,) may still slide until they leave their fixed features;
        infinite for contacts without one.
        """
        margins = np.full(len(self._first), np.inf)
        if np.all(self.held < 0):
            return margins
        states = self._states(q, 0.0 * q)
        for alike in self._polygons:
            for pair, i in np.argwhere(self.held[alike.rows] >= 0).tolist():
                row = alike.rows[pair, i]
                margins[row] = alike.margin(states, pair, i, int(self.held[row])) + 2.0 * self._exact
        return margins

    def _chosen(self, states: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of the features of the contacts with the indices `some` (k,), and lower bounds (k,) of the
        gaps of those whose feature does not act.

        The bound is -inf for a contact whose feature acts.
        """
        if not self._polygons:
            return np.zeros(len(some), dtype=int), np.full(len(some), -np.inf)
        features, least = np.zeros(len(self._first), dtype=int), np.full(len(self._first), -np.inf)
        held = self.held[some]
        is_open = np.zeros(len(self._first), dtype=bool)
        is_open[some] = held < 0
        for alike in self._polygons:
            which = is_open[alike.rows].any(axis=1).nonzero()[0]
            if not len(which):
                continue
            found, rows = alike.chosen(states, which), alike.rows[which]
            features[rows] = found.features
            least[rows] = np.where(found.acts, -np.inf, np.maximum(found.distances, self._exact))
        return np.where(held < 0, features[some], held), np.where(held < 0, least[some], -np.inf)

    @property
    def reach(self) -> float:
        """Largest gap that `gaps` always computes exactly [m]."""
        return self._reach

    def gaps(self, q: np.ndarray, within: float = 0.0) -> np.ndarray:
        """Return the gaps (C,) of all contacts at a position [m].

        For a gap above both `within` and `reach`, the result may be a lower bound that is above both, too.
        """
        if len(self._first) <= FEW:
            return self.rows(q, 0.0 * q).gap
        states = self._states(q, 0.0 * q)[:4]
        if self._polygons:
            return self._gaps_of_polygons(states, max(within, self._reach))
        assert self._near is not None
        known = self._near.bounds(q) if within <= self._reach else None
        if known is None:
            gaps = np.empty(len(self._first))
            self._evaluate(states, np.arange(len(gaps)), gaps)
            self._near.keep(q, gaps)
            return gaps
        gaps, near = known
        self._evaluate(states, near, gaps)
        return gaps

    def _gaps_of_polygons(self, states: np.ndarray, within: float) -> np.ndarray:
        """Return the gaps (C,) of all contacts; for pairs of shapes with a polygon, the distance between circles around
        both shapes where it is larger than `within`.
        """
        gaps = np.full(len(self._first), -np.inf)
        for alike in self._polygons:
            apart = alike.bounds(states)
            gaps[alike.rows] = np.where(apart > within, apart, -np.inf)[:, None]
        near = np.flatnonzero(gaps < within)
        self._evaluate(states, near, gaps)
        return gaps

    def _evaluate(self, states: np.ndarray, some: np.ndarray, gaps: np.ndarray) -> None:
        """Compute the gaps of the contacts with the indices `some` (k,), and write them into `gaps` (C,)."""
        from mbdkit.symbolic.contact_rows import gap_function  # loads SymPy

        features, least = self._chosen(states, some)
        none, own = (0.0,) * 3, self._first[some] + features
        for number, alike in enumerate(self._alike):
            which = self._kind[own] == number
            places = self._place[own[which]]
            first, second = (states[:, side[places]] for side in alike.bodies)
            gaps[some[which]] = gap_function(alike.kind)(*first, *none, *second, *none, *alike.numbers[:, places])
        gaps[some] = np.maximum(gaps[some], least)

    def rows(self, q: np.ndarray, v: np.ndarray, some: np.ndarray | None = None) -> Rows:
        """Return gaps, slips and derivatives of all contacts in a state, or of those with the indices `some`."""
        from mbdkit.symbolic.contact_rows import row_function  # loads SymPy

        states = self._states(q, v)
        chosen = np.arange(len(self._first)) if some is None else some
        features, least = self._chosen(states, chosen)
        own = self._first[chosen] + features
        values = np.empty((16, len(chosen)))
        for number, alike in enumerate(self._alike):
            which = np.flatnonzero(self._kind[own] == number)
            places = self._place[own[which]]
            given = np.concatenate([states[:, alike.bodies[0, places]], states[:, alike.bodies[1, places]]])
            numbers = alike.numbers[:, places]
            if len(which) <= FEW:
                function = row_function(alike.kind, is_of_arrays=False)
                for place, one, given_numbers in zip(which, given.T.tolist(), numbers.T.tolist(), strict=True):
                    values[:, place] = function(*one, *given_numbers)
                continue
            for row, computed in enumerate(row_function(alike.kind, is_of_arrays=True)(*given, *numbers)):
                values[row, which] = computed
        gradients = np.ascontiguousarray(values[2:14].reshape(2, 6, len(chosen)).transpose(0, 2, 1))
        gap = np.maximum(values[0], least)
        return Rows(gap, values[1], values[14], values[15], self._bodies[chosen], gradients, self._n)

    def _states(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return x, y, cosine and sine of the angle and the velocities of all bodies (7, B + 1), ground last."""
        states = np.zeros((7, self._n // 3 + 1))
        states[2, -1] = 1.0
        x, y, angle = q.reshape(-1, 3).T
        states[0, :-1], states[1, :-1], states[4:, :-1] = x, y, v.reshape(-1, 3).T
        angles = angle.tolist()  # NumPy's vectorized functions may round differently for different array lengths
        states[2, :-1], states[3, :-1] = [math.cos(x) for x in angles], [math.sin(x) for x in angles]
        return states
