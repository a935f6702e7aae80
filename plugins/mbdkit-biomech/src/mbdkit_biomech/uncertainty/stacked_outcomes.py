"""Outcomes of inverse dynamics for many values of its uncertain scalars at once.

What is smooth is taken to first order about the result, by central differences of the exactly changed problem: the
values u of the actuators without muscles, the reactions r that they cause, moment arms R, reactions G of unit tensions
that actuators balance, lengths and rates of the paths of muscles, and positions and velocities. What has corners is
computed exactly: curves of the fibres, bounds of the activations, and the optimum of recruitment for the tensions F.
The reactions are ``r + G F``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import MbdkitError, RunError
from mbdkit.engine.linear_systems import products
from mbdkit.engine.observed_states import JointSums
from mbdkit_biomech.inverse_dynamics.compute import Inverse, compression
from mbdkit_biomech.inverse_dynamics.loads.dynamics import solve_dynamics
from mbdkit_biomech.inverse_dynamics.loads.followers import loads_of
from mbdkit_biomech.inverse_dynamics.muscles.fibers import fibers_of_length
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.recruitment import Recruiter
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import Shared, impossible, share_loads
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Axial, share_softly
from mbdkit_biomech.muscles.muscle_path import MusclePath, PathState
from mbdkit_biomech.persons.plate_contacts import later
from mbdkit_biomech.uncertainty.changed_problem import (
    OF_DYNAMICS,
    PROPERTIES,
    ChangedProblem,
    Changer,
    with_moved_points,
)
from mbdkit_biomech.uncertainty.sources import Place, UncertainScalar, shared_activations

#: Number of programmes of recruitment that are solved together. Fewer cost more calls of NumPy for the frames that need
#: many steps, more cost memory: two blocks of this size take about 0.4 GB.
ROWS = 8_000

THREADS = 2  #: Number of blocks that are solved at once. Results do not depend on it.

#: Least length of fibres along the tendon [m]; samples whose tendons leave less have no solution in these frames.
SHORTEST = 1e-3

#: Quantities of muscles that are taken to first order; lengths of fibres and tendons follow the scaled segments.
SMOOTH = "length", "rate", "optimal_length", "tendon_length"

#: Keys of places that are not taken to first order.
EXACT = (*PROPERTIES, "muscle_delay", "exponent", "minimum", "cocontraction", "across", "emg")


#: Why frames of samples have no result.
LOST = ("muscles are too weak", "tendons are longer than their paths", "no optimal activations were found")


class Outcomes(NamedTuple):
    """Outcomes for S values of the scalars in T frames; nan in frames without result.

    Actuators and reserves (S, T, U), reactions (S, T, J, 3), those without muscles, tensions (S, T, M), and the number
    (S, T) of the reason in `LOST`, counted from 1; 0 in frames that have a result.
    """

    actuators: np.ndarray
    reactions: np.ndarray
    without: np.ndarray
    muscles: np.ndarray
    lost: np.ndarray


class _Mechanics:
    """Forces of actuators and joints in a motion, and what unit tensions of muscles add to them."""

    def __init__(self, own: ChangedProblem):
        problem, motion = own.problem, own.motion
        self.own, self._sums = own, JointSums(problem.prepared.workspace.mechanism)
        loads = loads_of(problem, motion)
        self.dynamics, self._balance, _ = solve_dynamics(
            problem.fitter, motion, loads, problem.actuators, report=problem.spec.unbalanced == "report"
        )

    def reactions(self, lam: np.ndarray) -> np.ndarray:
        """Return the reactions (T, J, 3) for multipliers (T, m)."""
        motion, manifold = self.own.motion, self.own.problem.fitter.manifold
        return self._sums.sum(manifold.reactions(motion.time, motion.q, motion.v, lam).reactions)

    @cached_property
    def _nothing(self) -> np.ndarray:
        return self.reactions(np.zeros_like(self.dynamics.lam))

    def put_muscle(self, out: np.ndarray, index: int, path: PathState) -> None:
        """Put the length of a path, its rate, moment arms and reactions of a unit tension into smooth values (T,)."""
        pull = -path.gradient
        arms = self._balance.as_actuators(pull[..., None])[..., 0]
        lam = self._balance.directions.multipliers(pull - products(self._balance.columns, arms))
        out["length"][:, index], out["rate"][:, index] = path.length, path.rate(self.own.motion.v)
        out["arms"][..., index], out["unit"][..., index] = arms, self.reactions(lam) - self._nothing


class StackedOutcomes:
    """Computes outcomes of a result for values of the scalars of K sources.

    The changes of positions and velocities of the bodies by a change of each scalar by 1 are `moves` (K, T, B, 6).
    """

    def __init__(self, result: Inverse, sources: Sequence[UncertainScalar]):
        self.result, self.sources = result, sources
        self.recruiter = result.problem.recruiter
        self._names = [] if self.recruiter is None else list(self.recruiter.muscles)
        self._shared_activations = [] if self.recruiter is None else [*shared_activations(result.problem)]
        problem = ChangedProblem(result.problem, result.fitted, result.independent, result.motion)
        self._mechanics = _Mechanics(problem)
        self._base = self._smooth(problem)
        self._starts: dict[float, np.ndarray] = {}  # multipliers of the result by exponent
        self.moves = np.zeros((len(sources), len(self._base), result.motion.q.shape[1] // 3, 6))
        slopes, changer = {}, Changer(result)
        for index, source in enumerate(sources):
            smooth = {place: size for place, size in source.moves.items() if place[0] not in EXACT}
            if smooth and all(place[0] in ("muscle_points", "extensor_arm") for place in smooth):
                slopes[index] = self._slope_of_paths(smooth)
            elif smooth:
                slopes[index] = self._slope(changer, source, smooth, index)
        self._smooth_places = list(slopes)
        self._slopes = np.stack([*slopes.values()], axis=1) if slopes else self._base[:, None][:, :0]

    def _slope(
        self, changer: Changer, source: UncertainScalar, smooth: Mapping[Place, float], index: int
    ) -> np.ndarray:
        """Return the derivatives (T, W) with respect to a scalar, from changes by one standard deviation."""
        sides, states = [], []
        for sign in (1.0, -1.0):
            try:
                changed = changer.at({place: sign * size for place, size in smooth.items()})
                sides.append(self._smooth(changed, {place[0] for place in smooth}))
            except MbdkitError as error:
                raise RunError(
                    f"inverse dynamics has no result with the {source.group} changed by one standard deviation "
                    f"({error}): state a smaller uncertainty"
                ) from error
            motion = changed.motion
            states.append(np.concatenate([x.reshape(len(x), -1, 3) for x in (motion.q, motion.v)], axis=2))
        self.moves[index] = (states[0] - states[1]) / 2
        return np.asarray((sides[0] - sides[1]) / 2)

    @cached_property
    def _layout(self) -> np.dtype[np.void]:
        """Names and shapes of the W smooth values of a frame, of U actuators, J joints and M muscles."""
        problem, m = self.result.problem, len(self._names)
        u, j = len(problem.actuators), len(problem.prepared.workspace.mechanism.joints)
        shapes = {"value": (u,), "reactions": (j, 3), "arms": (u, m), "unit": (j, 3, m)} | dict.fromkeys(SMOOTH, (m,))
        return np.dtype([(name, float, shape) for name, shape in shapes.items()])

    def _smooth(self, problem: ChangedProblem, keys: set[str] | None = None) -> np.ndarray:
        """Return rows (T, W) of smooth values, see `_layout`; `keys` of what is changed, None for the result itself."""
        mechanics, same_paths = _Mechanics(problem), keys is not None and keys <= OF_DYNAMICS
        rows = self._base.copy() if same_paths else np.zeros((len(problem.motion.time), self._layout.itemsize // 8))
        out = rows.view(self._layout)[:, 0]
        out["value"], out["reactions"] = mechanics.dynamics.value, mechanics.reactions(mechanics.dynamics.lam)
        if (recruiter := problem.problem.recruiter) is None or same_paths:
            return rows
        for index, name in enumerate(self._names):
            mechanics.put_muscle(out, index, recruiter.path(name, problem.motion))
            for key in PROPERTIES[1:]:
                out[key][:, index] = getattr(recruiter.muscles[name], key)
        return rows

    def _slope_of_paths(self, places: Mapping[Place, float]) -> np.ndarray:
        """Return the derivatives (T, W) with respect to a scalar that changes paths of muscles, but no motion."""
        assert self.recruiter is not None
        problem, motion, sides = self._mechanics.own.problem, self.result.motion, []
        for sign in (1.0, -1.0):
            change, rows = {place: sign * size for place, size in places.items()}, self._base.copy()
            for index, (name, muscle) in enumerate(self.recruiter.muscles.items()):
                if (changed := with_moved_points(name, muscle, {}, change)) is not muscle:
                    path = MusclePath(name, changed, problem.names).at(motion.time, motion.q)
                    self._mechanics.put_muscle(rows.view(self._layout)[:, 0], index, path)
            sides.append(rows)
        return np.asarray((sides[0] - sides[1]) / 2)

    def at(self, values: np.ndarray) -> Outcomes:
        """Return the outcomes for values (S, K) of the scalars."""
        frames, joints = len(self._base), self._layout["reactions"].shape
        shapes = (len(self.result.problem.recorded_actuators),), joints, joints, (len(self._names),), ()
        out = Outcomes(*(np.empty((len(values), frames, *shape)) for shape in shapes))
        exponents, most = self._total(values, ("exponent",)), max(1, ROWS // frames)
        equal = (np.flatnonzero(exponents == exponent) for exponent in np.unique(exponents))  # they are solved together
        blocks = [rows[begin : begin + most] for rows in equal for begin in range(0, len(rows), most)]
        with ThreadPoolExecutor(THREADS) as pool:  # NumPy and machine code release the lock of the interpreter
            list(pool.map(lambda rows: self._fill(values[rows], rows, out), blocks))
        return out

    def _total(self, values: np.ndarray, place: Place) -> np.ndarray:
        moves = ((column, source.moves.get(place)) for column, source in zip(values.T, self.sources, strict=True))
        return sum((size * column for column, size in moves if size is not None), start=np.zeros(len(values)))

    def _fill(self, values: np.ndarray, rows: np.ndarray, out: Outcomes) -> None:
        smooth = self._base[:, None] + products(values[:, self._smooth_places], self._slopes)  # (T, S, W)
        own = smooth.view(self._layout)[..., 0]
        recruiter, recruited = self.recruiter, self.result.recruited
        if recruiter is None or recruited is None:
            out.actuators[rows], out.reactions[rows] = own["value"].swapaxes(0, 1), own["reactions"].swapaxes(0, 1)
            out.without[rows], out.lost[rows] = out.reactions[rows], 0
            return
        (frames, count), flat = smooth.shape[:2], own.reshape(-1)
        driven, exponent = recruited.sharing.driven, recruiter.exponent + float(self._total(values, ("exponent",))[0])
        programme, capacity, passive = self._programme(recruiter, driven, values, own)
        if exponent not in self._starts:
            none, base = np.zeros((1, values.shape[1])), self._base.view(self._layout)
            shared = self._shared(self._programme(recruiter, driven, none, base), none, base, exponent)
            solved = np.isfinite(shared.certificate)[:, None]
            self._starts[exponent] = np.where(solved, shared.multipliers, 0.0)
        starts = np.repeat(self._starts[exponent], count, axis=0)
        shared = self._shared((programme, capacity, passive), values, own, exponent, starts)
        solved = np.isfinite(shared.certificate)[:, None]
        force = np.where(solved, capacity * shared.value[:, : capacity.shape[1]] + passive, np.nan)
        beside = flat["value"] - products(flat["arms"], force)
        beside[:, recruiter.is_taken_over(driven)] = 0.0
        reserve = np.where(driven, beside, 0.0)[:, recruiter.reserve_places]
        late = self._total(values, ("muscle_delay",))
        if np.any(late):
            time, each = self.result.motion.time, enumerate(np.moveaxis(force.reshape(frames, count, -1), 1, 0))
            force = np.stack([later(time, own, -late[k]) for k, own in each], axis=1).reshape(force.shape)
        without = flat["reactions"].reshape(frames * count, -1)
        joint = without + products(flat["unit"].reshape(*without.shape, -1), force)
        actuators = np.hstack([np.where(driven, flat["value"], beside), reserve])
        lost = np.where(solved[:, 0], 0, 3)
        if (unsolved := np.flatnonzero(lost)).size:
            lost[unsolved[impossible(programme.only(unsolved))]] = 1
        lost[np.isnan(capacity + passive).any(axis=1)] = 2
        for target, found in zip(out, (actuators, joint, without, force, lost), strict=True):
            target[rows] = found.reshape(frames, count, *target.shape[2:]).swapaxes(0, 1)

    def _shared(
        self,
        own: tuple[Programme, np.ndarray, np.ndarray],
        values: np.ndarray,
        smooth: np.ndarray,
        exponent: float,
        start: np.ndarray | None = None,
    ) -> Shared:
        """Return the solutions of T * S programmes `own`, see `_programme`, with their soft targets."""
        programme, capacity, passive = own
        assert self.result.recruited is not None
        targets, q, frames = self.result.recruited.targets, self.result.motion.q, len(smooth)
        if not targets:
            return share_loads(programme, exponent, start)
        shape = (len(capacity), len(targets.knees))
        without, unit = np.zeros(shape), np.zeros((*shape, capacity.shape[1]))
        for k, knee in enumerate(targets.knees):
            without[:, k] = compression(smooth["reactions"][:, :, knee.index], q, knee.shank).ravel()
            units = np.moveaxis(smooth["unit"][:, :, knee.index], 2, -1)  # (T, S, M, 3)
            unit[:, k] = compression(units, q, knee.shank).reshape(unit[:, k].shape)
        shifts = [np.tile(self._total(values, ("across", knee.joint)), frames) for knee in targets.knees]
        of_emg = (self._total(values, ("emg", self._names[one.muscle])) for one in targets.emg)
        gains = [np.tile(elementary.exp(total), frames) for total in of_emg]
        soft = targets.soft(Axial(without, unit), np.nan_to_num(capacity), np.nan_to_num(passive), shifts, gains)
        return share_softly(programme, exponent, soft, start)[1]

    def _programme(
        self, recruiter: Recruiter, driven: np.ndarray, values: np.ndarray, smooth: np.ndarray
    ) -> tuple[Programme, np.ndarray, np.ndarray]:
        """Return the programmes of T * S samples, and capacities and passive forces (T * S, M) of muscles, which are
        nan where a tendon is too long.
        """
        capacity, passive = self._capacities(recruiter, values, smooth)
        minimum = np.tile(recruiter.asked.minimum + self._total(values, ("minimum",)), len(self._base))[:, None]
        for knee, phase, share in self._shared_activations:
            floor = self._total(values, ("cocontraction", knee, phase))
            minimum = minimum + (floor[:, None] * share[:, None]).reshape(len(capacity), -1)
        arms, value = (smooth[name].reshape(len(minimum), *smooth[name].shape[2:]) for name in ("arms", "value"))
        programme = recruiter.programme(arms, driven, value, np.nan_to_num(capacity), np.nan_to_num(passive), minimum)
        return programme, capacity, passive

    def _capacities(self, recruiter: Recruiter, values: np.ndarray, smooth: np.ndarray) -> Iterator[np.ndarray]:
        """Return capacities and passive forces (T * S, M) of muscles; nan where a tendon is too long."""
        asked, columns = recruiter.asked, []
        for index, (name, muscle) in enumerate(recruiter.muscles.items()):
            length, rate, optimal, tendon = (smooth[key][..., index] for key in SMOOTH)
            by_force, by_optimal, by_tendon = (elementary.exp(self._total(values, (key, name))) for key in PROPERTIES)
            force = muscle.max_force * by_force
            active = passive = np.broadcast_to(force, length.shape)
            if asked.capacity == "full" or asked.passive:
                along = length - tendon * by_tendon
                own = force, optimal * by_optimal
                fibers = fibers_of_length(muscle, np.maximum(along, SHORTEST), rate, own, with_passive=asked.passive)
                passive = np.where(along > SHORTEST, fibers.passive, np.nan)
                active = np.where(along > SHORTEST, fibers.active, np.nan) if asked.capacity == "full" else active
            columns.append((active, passive if asked.passive else np.zeros_like(passive)))
        return (np.stack(one, axis=-1).reshape(-1, len(columns)) for one in zip(*columns, strict=True))
