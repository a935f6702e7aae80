"""The problem of inverse dynamics and its motion with changes of the person, of loads and of muscles.

An error e of a joint centre moves the centre in the frames of both segments, so that it turns with them. The columns of
the centre, angles and lengths of the segments beside it, muscles scaled with these lengths, and arms of measured forces
follow from it. The smoothing has the parameters of the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mbdkit.base import elementary
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.runs.assembled_mechanism import AssembledMechanism
from mbdkit.runs.followers import Follower
from mbdkit_biomech.inverse_dynamics.compute import Fitted, Inverse, InverseProblem, forces_of
from mbdkit_biomech.inverse_dynamics.loads.loads import LoadSeries
from mbdkit_biomech.inverse_dynamics.motion.fit import Fitter
from mbdkit_biomech.inverse_dynamics.motion.manifold import GivenMechanism, Manifold, Quantities
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Independent, Motion, motion_of_series
from mbdkit_biomech.inverse_dynamics.motion.smoothing import fixed, smoothed_each
from mbdkit_biomech.inverse_dynamics.muscles.recruitment import Recruiter
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Smoothing
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import actuators_of
from mbdkit_biomech.muscles.muscle import Muscle
from mbdkit_biomech.persons.calibration import ENDS, joints_of
from mbdkit_biomech.persons.landmarks import LEFT
from mbdkit_biomech.persons.plate_contacts import later
from mbdkit_biomech.persons.scaled_model import moved_muscle, of_model, scaled_model
from mbdkit_biomech.uncertainty.sources import Place, segment_of, shared_activations

MOVING = ("centers", "lengths", "angles")  #: Keys of places that change the motion.

#: Keys of places that change the mechanism.
MODEL = ("centers", "lengths", "masses", "inertias", "muscle_points", "extensor_arm")

#: Keys of places that leave the paths of muscles as they are.
OF_DYNAMICS = frozenset(("masses", "inertias", "pressure", "plate_gain", "offset", "followers"))

PROPERTIES = ("max_force", "optimal_length", "tendon_length")  #: Properties of muscles that have factors.

#: Changes by place: of lengths [m], angles [rad] and times [s], and of logarithms of shares.
Change = Mapping[Place, float]


@dataclass(frozen=True)
class ChangedProblem:
    """A problem with its fitted data, independent coordinates and motion."""

    problem: InverseProblem
    fitted: Fitted
    independent: Independent | None
    motion: Motion

    def forces(self) -> Inverse:
        """Return the result; tensions are nan in frames that the muscles cannot produce."""
        return forces_of(self.problem, self.fitted, self.independent, self.motion, strict=False)


class Changer:
    """Applies changes to the problem of a result."""

    def __init__(self, result: Inverse):
        self.result, self.problem = result, result.problem
        self.person = result.problem.source.person

    def at(self, change: Change) -> ChangedProblem:
        """Return the problem with changes; raise MbdkitError if it has no solution."""
        base, keys = self.problem, {place[0] for place in change}
        mechanism = self._mechanism(change) if keys & set(MODEL) else base.names.mechanism
        names = QuantityNames(mechanism)
        fitted, independent, motion = self.result.fitted, self.result.independent, self.result.motion
        problem = replace(base, names=names, loads=self._loads(change), followers=self._followers(change))
        if keys & set(MODEL):
            prepared = AssembledMechanism.at(GivenMechanism(mechanism), float(motion.time[0]), float(motion.time[-1]))
            fitter = Fitter(Manifold(prepared), prepared.workspace.mechanism.bodies)
            quantities = Quantities([names.find(name, "motion.columns") for name in base.measured.names])
            observed = dict(zip(base.measured.names, quantities.quantities, strict=True))
            actuators = actuators_of(base.spec.actuators, names, observed)
            problem = replace(problem, prepared=prepared, fitter=fitter, actuators=actuators)
            fitted = replace(fitted, measured=replace(fitted.measured, quantities=quantities))
        if keys & set(MOVING):
            fitted, independent, motion = self._moved(problem, fitted, change)
        if base.recruiter is not None and not keys <= OF_DYNAMICS:
            problem = replace(problem, recruiter=self._recruiter(problem, change))
        return ChangedProblem(problem, fitted, independent, motion)

    def _mechanism(self, change: Change) -> Mechanism:
        lengths = self._segment_lengths(change)
        base = self.problem.names.mechanism
        if lengths:
            source = self.problem.source
            base = of_model(source, scaled_model(source, self.person.subject, lengths)).mechanism()
        other = copy(base)
        other.bodies = dict(base.bodies)
        for name, body in base.bodies.items():
            segment = segment_of(name, self.person)
            mass = factor(change, "masses", segment)
            if body.inertia is not None:
                body = body.model_copy(update={"inertia": body.inertia * mass * factor(change, "inertias", segment)})
            other.bodies[name] = body.model_copy(update={"mass": body.mass * mass})
        sizes = {name: factor(change, "lengths", segment_of(name, self.person)) for name in base.bodies}
        if any(size != 1.0 for size in sizes.values()):
            other.joints = {name: _stretched_points(joint, sizes) for name, joint in base.joints.items()}
            other.forces = {name: _stretched_points(force, sizes) for name, force in base.forces.items()}
            other.markers = {
                name: one.model_copy(update={"point": _scaled(one.point or (0.0, 0.0), sizes.get(one.body, 1.0))})
                for name, one in base.markers.items()
            }
        if muscles := getattr(base, "muscles", None):
            other.muscles = {name: with_moved_points(name, muscle, sizes, change) for name, muscle in muscles.items()}
        return other

    @cached_property
    def _legs(self) -> tuple[str, ...]:
        return ("", LEFT) if f"hip{LEFT}" in self.person.centers else ("",)

    def _angle(self, body: str) -> np.ndarray:
        return np.asarray(self.result.motion.q[:, 3 * self.problem.names.body(body, "model") + 2])

    @cached_property
    def _reference(self) -> int:
        """The frame of the motion nearest to that in which covariances are given."""
        return int(np.argmin(np.abs(self.result.motion.time - self.person.time[self.person.reference])))

    def displacement(self, joint: str, change: Change) -> np.ndarray:
        """Return the displacement (T, 2) of a joint centre."""
        x, y = (change.get(("centers", joint, axis), 0.0) for axis in "xy")
        found = np.zeros((len(self.result.motion.time), 2))
        for weight, body in zip(self.person.centers[joint].fit.weights, joints_of(self._legs)[joint], strict=True):
            angle = self._angle(body)
            turn = angle - angle[self._reference]
            c, s = elementary.cos(turn), elementary.sin(turn)
            found += weight * np.column_stack([c * x - s * y, s * x + c * y])
        return found

    def _segment_lengths(self, change: Change) -> dict[str, float]:
        """Return the lengths of `thigh` and `shank`, whose weights are those of `Person.lengths`; empty without changed
        centres.
        """
        if not any(place[0] == "centers" for place in change):
            return {}
        found = {}
        for name, ends in ENDS.items():
            moves, weights = [], []
            for leg in self._legs:
                first, last = (f"{end}{leg}" for end in ends)
                angle = self._angle(f"{name}{leg}")
                up = np.column_stack([-elementary.sin(angle), elementary.cos(angle)])
                gap = self.displacement(first, change) - self.displacement(last, change)
                moves.append(float(np.mean(np.sum(up * gap, axis=1))))
                own, covariance = up[self._reference], self.person.centers[first].covariance
                covariance = (covariance + self.person.centers[last].covariance)[:2, :2]
                weights.append(1.0 / float(np.sum(own[:, None] * covariance * own)))
            move = sum(w * one for w, one in zip(weights, moves, strict=True)) / sum(weights)
            found[name] = self.person.lengths[name].value + move
        return found

    def _shifts(self, change: Change) -> np.ndarray:
        """Return the changes (T, K) of the observed quantities."""
        names = self.problem.measured.names
        found = np.tile([change.get(("angles", name), 0.0) for name in names], (len(self.result.motion.time), 1))
        for joint in dict.fromkeys(place[1] for place in change if place[0] == "centers"):
            is_hip = joint.startswith("hip")
            share = 1.0 / len(self._legs) if is_hip else 1.0  # both hips are one point of the trunk
            moved = share * self.displacement(joint, change)
            for axis, letter in enumerate("xy"):
                found[:, names.index(f"markers.{'hip' if is_hip else joint}.{letter}")] += moved[:, axis]
        return found

    def _moved(
        self, problem: InverseProblem, fitted: Fitted, change: Change
    ) -> tuple[Fitted, Independent | None, Motion]:
        own, fitter, time = self.result, problem.fitter, self.result.motion.time
        shift, measured = self._shifts(change), fitted.measured
        measured = replace(measured, raw=measured.raw + shift, values=measured.values + shift)
        q = fitter.refined(measured.target, fitted.q)
        independent = own.independent
        assert independent is not None
        known = problem.names.candidates() | dict(zip(measured.names, measured.quantities.quantities, strict=True))
        quantities = Quantities([known[name] for name in independent.names])
        independent = replace(independent, quantities=quantities)
        series = smoothed_each(time, quantities.values(q), self._how)
        motion = motion_of_series(fitter, independent, time, own.motion.q, series)
        return replace(fitted, measured=measured, q=q), independent, motion

    @cached_property
    def _how(self) -> list[Smoothing]:
        independent = self.result.independent
        assert independent is not None
        values = independent.quantities.values(self.result.fitted.q)
        return fixed(self.result.motion.time, values, self.problem.spec.motion.smooth)

    def _followers(self, change: Change) -> Mapping[str, Follower]:
        found = dict(self.problem.followers)
        for place, size in change.items():
            if place[0] == "followers":
                found[place[1]] = found[place[1]].changed({place[2]: size})
        return found

    def _loads(self, change: Change) -> dict[str, LoadSeries]:
        late = change.get(("offset",), 0.0)
        found = {}
        for name, load in self.problem.loads.items():
            if (gain := factor(change, "plate_gain", name)) != 1.0:
                load = replace(load, force=gain * load.force, torque=gain * load.torque)
            if move := change.get(("pressure", name), 0.0):
                load = load.moved(("point", 0), move)
            if late and name in self.person.plates.loads:
                point = None if load.point is None else later(load.time, load.point, late)
                force, torque = (later(load.time, x, late) for x in (load.force, load.torque))
                load = replace(load, force=force, torque=torque, point=point)
            found[name] = load
        return found

    def _recruiter(self, problem: InverseProblem, change: Change) -> Recruiter:
        asked = self.problem.recruiter.asked  # type: ignore[union-attr]
        moved = {key: getattr(asked, key) + change[key,] for key in ("exponent", "minimum") if (key,) in change}
        own, recruited = list(problem.names.mechanism.muscles), self.result.recruited
        assert recruited is not None
        shifts = [change.get(("across", one.joint), 0.0) for one in recruited.targets.knees]
        gains = [factor(change, "emg", own[one.muscle]) for one in recruited.targets.emg]
        targets = recruited.targets.changed(shifts, gains)
        recruiter = Recruiter(asked.model_copy(update=moved), problem.names, problem.actuators, targets)
        for knee, phase, share in shared_activations(self.problem):
            recruiter.floor = recruiter.floor + change.get(("cocontraction", knee, phase), 0.0) * share
        recruiter.late = change.get(("muscle_delay",), 0.0)
        muscles = {}
        for name, muscle in recruiter.muscles.items():
            changed = {key: getattr(muscle, key) * factor(change, key, name) for key in PROPERTIES}
            muscles[name] = muscle.model_copy(update=changed)
        recruiter.muscles = muscles
        return recruiter


def factor(change: Change, key: str, element: str) -> float:
    """Return the factor of a share; 1 if it is not changed."""
    return float(elementary.exp(change.get((key, element), 0.0)))


def _stretched_points(element: Any, sizes: Mapping[str, float]) -> Any:
    """Return a joint or a force whose points are stretched from the centres of mass of their bodies."""
    if getattr(element, "points", None) is None:
        return element
    own = zip(element.bodies, element.points, strict=True)
    return element.model_copy(update={"points": tuple(_scaled(point, sizes.get(body, 1.0)) for body, point in own)})


def _scaled(point: Sequence[float], size: float) -> tuple[float, ...]:
    return tuple(size * x for x in point)


def with_moved_points(name: str, muscle: Muscle, sizes: Mapping[str, float], change: Change) -> Muscle:
    """Return a muscle whose points are stretched from the centres of mass of their bodies, and moved, and with another
    lever arm of the patella; the muscle itself if nothing changes.
    """
    bodies = dict.fromkeys(item.on for item in muscle.path)
    points = {}
    for body in bodies:
        x, y = (change.get(("muscle_points", name, body, axis), 0.0) for axis in "xy")
        points[body] = (sizes.get(body, 1.0), x, y)
    if muscle.patella is not None and (longer := change.get(("extensor_arm", muscle.patella.joint), 0.0)):
        own = muscle.patella.model_copy(update={"deviations": muscle.patella.deviations + longer})
        muscle = muscle.model_copy(update={"patella": own})
    if all(point == (1.0, 0.0, 0.0) for point in points.values()):
        return muscle
    return Muscle.model_validate(moved_muscle(muscle.model_dump(mode="json", exclude_none=True), points))
