"""Recruitment: the muscle forces that produce the moments of inverse dynamics and are optimal in each frame.

Actuators represent the net moments of the muscles about the joints. With the tensions F of the muscles, the moment arms
R of the muscles about the coordinates of the actuators, and reserves r,

    R F + r = u,    F = capacity a + passive,

where u are the values of the actuators. The activations a, between a minimum and 1, and the reserves r minimise the sum
of all ``(a / weight)^p`` and ``|r / optimal force|^p``, where p is the exponent of the section `recruitment`; for an
infinite exponent, they minimise the largest ``a / weight`` or ``|r / optimal force|``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import counted, listed
from mbdkit.engine.linear_systems import products
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.loads.dynamics import Balance, Dynamics
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.muscles.fibers import ElasticMuscles, fibers_on_rigid_tendon, in_equilibrium
from mbdkit_biomech.inverse_dynamics.muscles.loads_over_time import (
    ActivationDynamics,
    share_over_time,
    smallest_supplement_over_time,
)
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.recruited import Contraction, Recruited, Sharing
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import Shared, share_loads, smallest_supplement
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Axial, Targets, share_softly
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Recruitment
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import NamedActuator, reserves_of
from mbdkit_biomech.muscles.muscle import Muscle
from mbdkit_biomech.muscles.muscle_path import MusclePath, PathState
from mbdkit_biomech.muscles.patella import PatellaPath
from mbdkit_biomech.persons.plate_contacts import later

#: A muscle does not act on a coordinate if its moment arm is at most this [m for angles, 1 for lengths].
NO_ARM = 1e-9

TIMES_NAMED = 6

#: Number of times that scales of EMG follow from activations, and activations from scales. The error of the knee of 24
#: drawn persons falls by 30, 37, 39 and 40 % after one, two, three and four of them.
CALIBRATIONS = 3


class Recruiter:
    """Recruits the muscles of a mechanism.

    Parameters
    ----------
    asked
        The section `recruitment` of the spec.
    names
        Quantities of the mechanism by name.
    actuators
        The U actuators of the spec.
    targets
        What is known beside the moments.

    Attributes
    ----------
    muscles
        The muscles by name.

    Raises
    ------
    SpecError
        If the mechanism has no muscles, a reserve refers to an unknown actuator, or options of the section exclude each
        other.
    """

    def __init__(self, asked: Recruitment, names: QuantityNames, actuators: Sequence[NamedActuator], targets: Targets):
        if not (muscles := names.mechanism.muscles):
            raise SpecError("needs muscles, but the model has none", key="recruitment")
        self.asked, self._actuators, self.targets = asked, actuators, targets
        self.muscles: Mapping[str, Muscle] = muscles
        self._paths = {name: MusclePath(name, muscle, names) for name, muscle in muscles.items()}
        uses_fibers = asked.capacity == "full" or asked.passive
        elastic = {name: muscle for name, muscle in muscles.items() if uses_fibers and muscle.tendon == "elastic"}
        self._is_elastic = np.array([name in elastic for name in muscles])
        for name, muscle in elastic.items():
            self._require_simple(name)
            if not muscle.tendon_length:
                raise SpecError(
                    "should be greater than 0, because an elastic tendon needs a length",
                    key=f"model.muscles.{quoted(name)}.tendon_length",
                )
        if asked.dynamics == "activation" and asked.exponent in (1, "inf"):
            raise SpecError(
                f"activation dynamics need an exponent of 2 or more, not {asked.exponent}", key="recruitment.exponent"
            )
        self.floor: np.ndarray | float = 0.0  # (T, M) what least activations exceed the minimum by
        self.late = 0.0  # time by which muscles act later than recruitment says [s]
        self._joined = np.array([not actuator.is_residual for actuator in actuators], dtype=bool)
        self._reserves = reserves_of(asked, actuators)

    def _require_simple(self, name: str) -> None:
        """Raise SpecError if recruitment has options that need rigid tendons; `name` is that of an elastic muscle."""
        if self.targets:
            raise SpecError(
                f"bounds by the compartments of knees and EMG need rigid tendons; the tendon of muscle '{name}' is "
                "elastic: use `frontal: none`, and leave out `emg`",
                key="recruitment",
            )
        wrong = {
            "exponent": self.asked.exponent in (1, "inf"),
            "dynamics": self.asked.dynamics == "activation",
            "capacity": self.asked.capacity == "isometric",
        }
        for key in (key for key, is_wrong in wrong.items() if is_wrong):
            raise SpecError(
                f"should not be {getattr(self.asked, key)}, which needs rigid tendons; the tendon of muscle "
                f"'{name}' is elastic",
                key=f"recruitment.{key}",
            )

    @property
    def patellas(self) -> dict[int, PatellaPath]:
        """The patellas by index of the muscle."""
        paths = (self._paths[name].patella for name in self.muscles)
        return {index: patella for index, patella in enumerate(paths) if patella is not None}

    @property
    def is_elastic(self) -> bool:
        """Whether there are muscles with elastic tendons, and recruitment uses their fibres."""
        return bool(self._is_elastic.any())

    @property
    def couples_frames(self) -> bool:
        """Whether the forces of the muscles in a frame depend on other frames."""
        return self.is_elastic or self.asked.dynamics == "activation"

    def with_targets(self, targets: Targets) -> Recruiter:
        """Return a recruiter of the same muscles with other targets."""
        other = copy(self)
        other.targets = targets
        return other

    @property
    def reserves(self) -> list[NamedActuator]:
        """The reserves, in the order of their actuators."""
        return [reserve.actuator for reserve in self._reserves]

    def recruited(
        self,
        motion: Motion,
        dynamics: Dynamics,
        balance: Balance,
        needed: np.ndarray,
        axial: Callable[[np.ndarray], Axial],
        *,
        strict: bool = True,
    ) -> Recruited:
        """Return the forces of muscles and reserves that produce a motion.

        Parameters
        ----------
        dynamics
            The forces that produce the motion without muscles.
        balance, needed
            Balance of forces of the motion, and the generalized forces (T, n) that actuators and joints supply.
        axial
            Returns the compressions of the knees of `targets`, given the generalized forces (T, n, M) of unit tensions.
        strict
            Whether to raise an error for frames that muscles and reserves cannot produce; otherwise, forces in them are
            nan.

        Raises
        ------
        SpecError
            If there is not one actuator for each degree of freedom, or if no muscle acts on an actuator.
        RunError
            If a path is not possible, if tendons have no equilibrium, or if muscles and reserves cannot produce the
            motion. In the last case, the message states the smallest reserves that suffice.
        """
        if balance.effect.shape[1] != balance.effect.shape[2] or dynamics.surplus:
            raise SpecError(
                f"recruitment needs one actuator for each of the {counted(balance.effect.shape[1], 'degree')} of "
                f"freedom, but there are {balance.effect.shape[2]}",
                key="actuators",
            )
        own = self.contraction(motion)
        sharing = self.sharing(own, balance, dynamics.value)
        if self.is_elastic:
            own = self._in_equilibrium(own, sharing, dynamics.value, motion.time)
            programme = self.programme(sharing.arms, sharing.driven, dynamics.value, own.capacity, own.passive)
            sharing = replace(sharing, programme=programme)
        driven = sharing.driven
        shared = share_loads(sharing.programme, self.exponent)
        failed = ~np.isfinite(shared.certificate)
        if strict and failed.any():
            raise self._impossible(sharing, motion.time, failed)
        targets, alone = self.targets, shared.value[:, : len(self.muscles)]
        if targets:
            along, programme = axial(own.pull), sharing.programme
            for _ in range(1 if all(one.has_scale for one in targets.emg) else CALIBRATIONS):
                targets = self.targets.calibrated(alone, shared.value[:, : len(self.muscles)], sharing.programme)
                soft = targets.soft(along, own.capacity, own.passive)
                programme, shared = share_softly(sharing.programme, self.exponent, soft)
                failed = ~np.isfinite(shared.certificate)
                if strict and failed.any():
                    raise self._impossible(sharing, motion.time, failed)
            sharing = replace(sharing, programme=programme)
        if self.asked.dynamics == "activation" and len(motion.time) > 1:
            shared = self._over_time(sharing, shared, motion.time, strict=strict)
            failed = ~np.isfinite(shared.certificate)
        activation = np.where(failed[:, None], np.nan, shared.value[:, : len(self.muscles)])
        force = own.capacity * activation + own.passive
        beside = dynamics.value - products(sharing.arms, force)
        beside[:, self.is_taken_over(driven)] = 0.0
        places = self.reserve_places
        reserve = np.where(driven, beside, 0.0)[:, places]
        if self.late:  # what the muscles then lack is no force of the reserves
            force = later(motion.time, force, -self.late)
            beside = dynamics.value - products(sharing.arms, force)
        pushed = products(balance.columns, beside) + products(own.pull, force)
        speed = products(np.swapaxes(balance.columns, 1, 2), motion.v)
        values = np.hstack([np.where(driven, dynamics.value, beside), reserve])
        actuators = np.stack([values, values * np.hstack([speed, speed[:, places]])], axis=-1)
        power, lam = -force * own.rate, balance.directions.multipliers(pushed - needed)
        return Recruited(own, sharing, shared, targets, activation, force, power, beside, actuators, lam)

    def _over_time(self, sharing: Sharing, shared: Shared, time: np.ndarray, *, strict: bool) -> Shared:
        """Return the solution with activation dynamics, starting from the solutions of single frames; see
        `recruited`.
        """
        if not np.all(np.isfinite(shared.certificate)):
            return replace(shared, certificate=np.full_like(shared.certificate, np.inf))
        activations = [muscle.activation for muscle in self.muscles.values()]
        fall, rise = (np.array([getattr(activation, name) for activation in activations]) for name in ("fall", "rise"))
        dynamics = ActivationDynamics.of(time, fall, rise)
        result = share_over_time(sharing.programme, self.exponent, dynamics, shared.value)
        if strict and not np.all(np.isfinite(result.certificate)):
            lacking = smallest_supplement_over_time(sharing.programme, dynamics)
            failed = np.any(np.abs(lacking) > 1e-9 * sharing.programme.size, axis=1)
            raise self._impossible(sharing, time, failed, lacking)
        return result

    @property
    def exponent(self) -> float:
        """Exponent of the cost; may be infinite."""
        return math.inf if self.asked.exponent == "inf" else float(self.asked.exponent)

    @property
    def reserve_places(self) -> list[int]:
        """Indices of the actuators of the reserves."""
        return [reserve.of for reserve in self._reserves]

    def is_taken_over(self, driven: np.ndarray) -> np.ndarray:
        """Return which actuators (U,) are replaced by muscles without a reserve."""
        alone: np.ndarray = driven.copy()
        alone[self.reserve_places] = False
        return alone

    def path(self, name: str, motion: Motion) -> PathState:
        """Return the path of a muscle."""
        return self._paths[name].at(motion.time, motion.q)

    def contraction(self, motion: Motion) -> Contraction:
        """Return the geometry and the possible forces of the muscles."""
        is_full = self.asked.capacity == "full"
        columns: list[tuple[np.ndarray, ...]] = []
        for name, muscle in self.muscles.items():
            path = self.path(name, motion)
            rate = path.rate(motion.v)
            if is_full or self.asked.passive:
                fibers = fibers_on_rigid_tendon(name, muscle, motion.time, path.length, rate)
                lengths = fibers.length, fibers.rate
                forces = fibers.active, fibers.passive
            else:
                lengths = np.full_like(rate, np.nan), np.full_like(rate, np.nan)
                forces = rate, np.zeros_like(rate)
            active = forces[0] if is_full else np.full_like(rate, muscle.max_force)
            passive = forces[1] if self.asked.passive else np.zeros_like(rate)
            columns.append((path.length, rate, *lengths, active, passive, -path.gradient))
        return Contraction(*(np.stack(one, axis=-1) for one in zip(*columns, strict=True)))

    def sharing(self, own: Contraction, balance: Balance, value: np.ndarray) -> Sharing:
        """Return how muscles and reserves share the values (T, U) that the actuators have without muscles.

        Raises
        ------
        SpecError
            If no muscle acts on an actuator.
        """
        arms = balance.as_actuators(own.pull)
        driven = self._joined & np.any(np.abs(arms) > NO_ARM, axis=(0, 2))
        if not driven.any():
            raise SpecError("no muscle acts on an actuator: muscles must cross joints that move", key="recruitment")
        return Sharing(arms, driven, self.programme(arms, driven, value, own.capacity, own.passive))

    def programme(
        self,
        arms: np.ndarray,
        driven: np.ndarray,
        value: np.ndarray,
        capacity: np.ndarray,
        passive: np.ndarray,
        minimum: np.ndarray | None = None,
    ) -> Programme:
        """Return the convex programmes of T frames; see `Sharing` and `Contraction`.

        Parameters
        ----------
        minimum
            (T, M) smallest activations; by default, those of the spec and of `floor`.
        """
        rows = np.flatnonzero(driven)
        spare = [reserve for reserve in self._reserves if driven[reserve.of]]
        frames, count = len(value), len(self.muscles)
        reserves = np.zeros((frames, len(rows), len(spare)))
        for column, reserve in enumerate(spare):
            reserves[:, np.flatnonzero(rows == reserve.of), column] = reserve.optimal
        low, high = np.full((frames, count), self.asked.minimum) + self.floor, np.ones((frames, count))
        if minimum is not None:
            low[:] = minimum
        without = np.full((frames, len(spare)), np.inf)
        return Programme(
            np.concatenate([arms[:, driven] * capacity[:, None], reserves], axis=2),
            value[:, driven] - products(arms[:, driven], passive),
            np.hstack([low, -without]),
            np.hstack([high, without]),
            np.concatenate([self.weights, np.ones(len(spare))]),
        )

    def _in_equilibrium(self, own: Contraction, sharing: Sharing, value: np.ndarray, time: np.ndarray) -> Contraction:
        """Return the muscles with fibres in equilibrium with elastic tendons.

        Parameters
        ----------
        own, sharing
            The muscles with rigid tendons, and the programmes that determine their shares.
        value
            (T, U) values of the actuators without muscles.
        """
        which, count = self._is_elastic, len(self.muscles)
        muscles = {name: muscle for (name, muscle), is_one in zip(self.muscles.items(), which, strict=True) if is_one}
        elastic = ElasticMuscles(muscles, with_passive=self.asked.passive)
        capacity, passive = own.capacity.copy(), own.passive.copy()

        def share(frame: int, slope: np.ndarray, offset: np.ndarray) -> np.ndarray:
            capacity[frame, which], passive[frame, which] = slope, offset
            span = slice(frame, frame + 1)
            programme = self.programme(sharing.arms[span], sharing.driven, value[span], capacity[span], passive[span])
            loads = share_loads(programme, self.exponent)
            solved = np.isfinite(loads.certificate[0])
            return np.asarray(np.where(solved, loads.value[0, :count][which], np.nan))

        result = in_equilibrium(elastic, time, own.length[:, which], own.rate[:, which], share)
        length, rate = own.fiber_length.copy(), own.fiber_rate.copy()
        length[:, which] = [one.length for one in result]
        rate[:, which] = [one.rate for one in result]
        return replace(own, fiber_length=length, fiber_rate=rate, capacity=capacity, passive=passive)

    @property
    def weights(self) -> np.ndarray:
        """Weights (M,) of the muscles."""
        return np.array([muscle.weight for muscle in self.muscles.values()])

    def _impossible(
        self, sharing: Sharing, time: np.ndarray, failed: np.ndarray, lacking: np.ndarray | None = None
    ) -> RunError:
        """Return the error for frames without solution, which states the smallest reserves that suffice, or the muscle
        whose force at the minimum activation is too large.

        Parameters
        ----------
        lacking
            (T, K) smallest reserves; by default, those that suffice for each frame alone.
        """
        rows, programme = np.flatnonzero(failed), sharing.programme
        driven = [self._actuators[int(k)] for k in np.flatnonzero(sharing.driven)]
        by_frames = lacking is None
        signed = smallest_supplement(programme.only(rows)) if lacking is None else lacking[rows]
        lacking = np.abs(signed)
        largest = np.max(lacking, axis=0)
        texts = [
            f"{one.name} {most:.4g} {one.unit} (t = {time[rows[int(np.argmax(lacking[:, k]))]]:.6g} s)"
            for k, (one, most) in enumerate(zip(driven, largest, strict=True))
            if most > 1e-9 * np.max(programme.size[rows][:, k])
        ]
        times = listed([f"{time[row]:.6g}" for row in rows[:TIMES_NAMED]], "" if len(rows) > TIMES_NAMED else "and")
        more = ", ..." if len(rows) > TIMES_NAMED else ""
        if not texts:
            more += " s; use another `exponent`" + ("" if len(self._reserves) >= len(driven) else ", or reserves")
            return RunError(f"no optimal activations were found at t = {times}{more}")
        if by_frames and self.asked.minimum > 0.0:
            without = replace(programme.only(rows), low=np.where(np.isinf(programme.low[rows]), -np.inf, 0.0))
            if np.all(np.abs(smallest_supplement(without)) <= 1e-9 * programme.size[rows]):
                return self._too_strong(sharing, time, rows, signed)
        fast = "" if by_frames else " with activations that change as fast as their dynamics allow"
        about = "about " if self.is_elastic else ""  # computed for the lengths of the tendons in the last iteration
        return RunError(
            f"the muscles cannot produce the motion{fast} in {len(rows)} of {counted(len(time), 'frame')}, at t = "
            f"{times}{more} s; `recruitment.reserves` should be at least {about}{listed(texts, 'and')}"
        )

    def _too_strong(self, sharing: Sharing, time: np.ndarray, rows: np.ndarray, lacking: np.ndarray) -> RunError:
        """Return the error for frames that have solutions only with activations below the minimum.

        Parameters
        ----------
        rows, lacking
            The F frames, and the smallest reserves (F, K) that suffice in them.
        """
        programme, driven = sharing.programme, np.flatnonzero(sharing.driven)
        place, equation = np.unravel_index(np.argmax(np.abs(lacking) / programme.size[rows]), lacking.shape)
        row, actuator = rows[place], self._actuators[int(driven[equation])]
        least = self.asked.minimum * programme.matrix[row, equation, : len(self.muscles)]
        muscle = int(np.argmax(-least * np.sign(lacking[place, equation])))  # the largest moment that is to be balanced
        name, force = list(self.muscles)[muscle], list(self.muscles.values())[muscle].max_force
        needed = programme.right[row, equation]
        return RunError(
            f"the minimum activation of {self.asked.minimum:g} prevents the motion in {len(rows)} of "
            f"{counted(len(time), 'frame')}: at t = {time[row]:.6g} s, {actuator.name} needs {needed:.4g} "
            f"{actuator.unit}, but muscle '{name}' alone exerts {least[muscle]:.4g} "
            f"{actuator.unit} at this activation; check its `max_force` of {force:g} N, or reduce "
            f"`recruitment.minimum`"
        )
