"""Inverse dynamics of a spec: from the measured motion to the forces of actuators and joints, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.integrate import cumulative_simpson

from mbdkit.base import elementary
from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.text import counted, listed
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.linear_systems import products
from mbdkit.engine.observed_states import GivenForces, JointSums, StateObserver
from mbdkit.integrators.interface import Nodes
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.quantities.states import States
from mbdkit.runs.assembled_mechanism import AssembledMechanism
from mbdkit.runs.followers import Follower
from mbdkit.runs.law_ranges import LawRanges
from mbdkit_biomech.inverse_dynamics.loads.dynamics import (
    Balance,
    Dynamics,
    largest_unbalanced,
    require_driven,
    solve_dynamics,
)
from mbdkit_biomech.inverse_dynamics.loads.followers import followers_of, loads_of, remarks_of
from mbdkit_biomech.inverse_dynamics.loads.loads import Loads, LoadSeries, read_loads
from mbdkit_biomech.inverse_dynamics.motion.fit import Fitter
from mbdkit_biomech.inverse_dynamics.motion.manifold import Manifold
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured, read_motion
from mbdkit_biomech.inverse_dynamics.motion.placed_gaps import PlacedGaps, place_gaps
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import (
    Independent,
    Motion,
    independent_coordinates,
    motion_of_derivatives,
    motion_of_series,
)
from mbdkit_biomech.inverse_dynamics.motion.smoothing import smoothed
from mbdkit_biomech.inverse_dynamics.motion.unused_data import UnusedData
from mbdkit_biomech.inverse_dynamics.muscles.knees import knee_forces
from mbdkit_biomech.inverse_dynamics.muscles.measured_targets import measured_targets
from mbdkit_biomech.inverse_dynamics.muscles.recruited import Recruited
from mbdkit_biomech.inverse_dynamics.muscles.recruitment import Recruiter
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Axial, Compartments
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import NamedActuator, actuators_of, light_roots
from mbdkit_biomech.muscles.muscle_values import Muscles
from mbdkit_biomech.uncertainty.sources import sources_of

_COLUMNS = "motion.columns"


@dataclass(frozen=True)
class InverseProblem:
    """A spec with its mechanism, data and actuators, before any results are computed.

    Attributes
    ----------
    spec
        The spec; for a person, that of the motion and loads of the scaled model.
    source
        The spec as given, which the archive contains.
    prepared
        The mechanism, assembled for the time of the motion.
    fitter
        Fits the mechanism to data; contains the constraint manifold of the mechanism.
    names
        Quantities of the mechanism by name.
    measured
        The measured motion; angles begin within half a turn of the initial pose of the mechanism.
    loads
        The measured loads by name.
    actuators
        The actuators, with residual ones last.
    recruiter
        Recruits the muscles; None without `recruitment`.
    unused
        Markers of the model without data, and columns of the table that are not used.
    followers
        Bodies that follow the motion, such as worn devices, by name.
    is_loaded
        Whether these bodies are there.
    """

    spec: InverseSpec
    prepared: AssembledMechanism
    fitter: Fitter
    names: QuantityNames
    measured: Measured
    loads: dict[str, LoadSeries]
    actuators: list[NamedActuator]
    source: InverseSpec
    recruiter: Recruiter | None = None
    unused: UnusedData = field(default_factory=UnusedData)
    followers: Mapping[str, Follower] = field(default_factory=dict)
    is_loaded: bool = True

    @property
    def recorded_actuators(self) -> list[NamedActuator]:
        """The actuators, followed by the reserves."""
        return [*self.actuators, *([] if self.recruiter is None else self.recruiter.reserves)]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the model, as sentences."""
        mechanism = self.names.mechanism
        texts = [f"{warning}." for warning in (*mechanism.warnings, *mechanism.left_out_of_runs)]
        if self.names.mechanism.muscles and self.recruiter is None:
            texts.append("the model has muscles, which exert no force because the spec has no `recruitment`.")
        texts += [*self.unused.warnings, *remarks_of(self)]
        if any(actuator.is_residual for actuator in self.actuators):
            texts += [f"{warning}." for warning in light_roots(self.names.mechanism)]
        return tuple(texts)

    @classmethod
    def of(cls, spec: InverseSpec) -> InverseProblem:
        """Read the data of a spec and assemble its mechanism.

        Raises
        ------
        SpecError
            If the data, or names in the spec, are wrong. The error contains the file and line, or the key of the spec.
        """
        source = spec
        names = QuantityNames(source.mechanism())
        spec = source.expanded
        try:
            with source.recording_files():
                measured, table = read_motion(spec, names)
                loads = read_loads(spec, names, table)
            observed = dict(zip(measured.names, measured.quantities.quantities, strict=True))
            actuators = actuators_of(spec.actuators, names, observed)
            recruiter = None
            if spec.recruitment is not None:
                targets = measured_targets(source, names, measured.time)
                recruiter = Recruiter(spec.recruitment, names, actuators, targets)
            followers = followers_of(source, names.mechanism)
        except SpecError as error:
            raise spec.placed(error) from error
        prepared = AssembledMechanism.at(spec, float(measured.time[0]), float(measured.time[-1]))
        measured = measured.near(prepared.equations.q0)
        fitter = Fitter(Manifold(prepared), prepared.workspace.mechanism.bodies)
        unused = UnusedData.of(spec, names, measured, table)
        problem = cls(spec, prepared, fitter, names, measured, loads, actuators, source, recruiter, unused, followers)
        try:
            sources_of(problem)  # before the computation, so that wrong names are found early
        except SpecError as error:
            raise source.placed(error) from error
        return problem


@dataclass(frozen=True)
class Fitted:
    """The mechanism fitted to a measured motion in T frames.

    Attributes
    ----------
    measured
        The measured motion, with angles shifted by full turns so that they agree with the pose in the first frame.
    q
        (T, n) poses that satisfy the constraints.
    placed
        Gaps of the motion that are filled by means of the other columns; None if there are none.
    """

    measured: Measured
    q: np.ndarray
    placed: PlacedGaps | None = None

    @property
    def values(self) -> np.ndarray:
        """(T, K) values of the observed quantities."""
        return self.measured.quantities.values(self.q)

    @property
    def residual(self) -> np.ndarray:
        """(T, K) raw - fitted values; nan in gaps."""
        return np.asarray(self.measured.raw - self.values)

    @property
    def interpolated(self) -> np.ndarray:
        """(T, K) whether a value is missing and interpolated over time."""
        missing = np.isnan(self.measured.raw)
        return missing if self.placed is None else self.placed.interpolated(missing)


@dataclass(frozen=True)
class Inverse:
    """The result of inverse dynamics in T frames.

    `dynamics` contains the forces that produce the motion without muscles. `recruited` is None if the spec has no
    `recruitment`. `independent` is None if the data contain derivatives.
    """

    problem: InverseProblem
    fitted: Fitted
    independent: Independent | None
    motion: Motion
    loads: Loads
    dynamics: Dynamics
    recruited: Recruited | None = None

    @property
    def lam(self) -> np.ndarray:
        """(T, m) multipliers of the independent constraint rows, with the forces of recruited muscles if any."""
        return self.dynamics.lam if self.recruited is None else self.recruited.lam

    @property
    def actuators(self) -> np.ndarray:
        """(T, U, 2) values and powers of the actuators in `InverseProblem.recorded_actuators`."""
        if self.recruited is None:
            return np.stack([self.dynamics.value, self.dynamics.power], axis=-1)
        return self.recruited.actuators

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the result, as sentences."""
        problem, motion, dynamics = self.problem, self.motion, self.dynamics
        told = [*problem.warnings]
        if len(motion.coordinates) > 1:
            when = listed([f"{motion.time[begin]:.6g} s" for begin, _ in motion.coordinates[1:]], "and")
            told.append(
                f"no set of independent coordinates determines the motion well at all times, so that the set changes "
                f"at t = {when}; the smoothed motion may have small discontinuities there."
            )
        if dynamics.surplus:
            told.append(
                f"{counted(len(problem.actuators), 'actuator')} drive "
                f"{counted(len(problem.actuators) - dynamics.surplus, 'degree')} of freedom, so their values are not "
                "unique: the sum of (weight * value)^2 is minimised, with torques divided by the characteristic length "
                f"({problem.fitter.manifold.length:.4g} m)."
            )
        if problem.spec.unbalanced == "report" and np.any(dynamics.unbalanced):
            worst = largest_unbalanced(dynamics, problem.fitter.bodies)
            told.append(
                f"the actuators cannot produce the motion: in the least-squares solution, {worst} stay unbalanced."
            )
        return (*told, *self._laws_out_of_range())

    def _laws_out_of_range(self) -> tuple[str, ...]:
        workspace, motion = self.problem.prepared.workspace, self.motion
        ranges = LawRanges.of(self.problem.spec.mechanism(), workspace.mechanism, workspace)
        if ranges is None:
            return ()
        count = len(motion.time)
        q, v = (np.column_stack([x, np.zeros((count, 3))]) for x in (motion.q, motion.v))
        ranges.add_between(Nodes(motion.time, np.zeros(count), q, v))
        ranges.add(np.zeros(0), np.zeros((0, len(workspace.mechanism.forces), 5)))
        return tuple(f"{warning}." for warning in ranges.warnings())


def fit(problem: InverseProblem) -> Fitted:
    """Fit the mechanism to the measured motion.

    Raises
    ------
    SpecError
        If the columns do not determine the motion; the message names the bodies that are not observed.
    RunError
        If no pose is found.
    """
    first, values = _first_pose(problem)
    fitter, measured = problem.fitter, problem.measured.turned(values)
    q = fitter.poses(measured.target, first)
    fitter.require_observed(measured.target, q, _COLUMNS)
    return Fitted(*place_gaps(fitter, measured, q))


def _first_pose(problem: InverseProblem) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of the first frame; see `Fitter.first_pose`."""
    fitter, target, start = problem.fitter, problem.measured.target, problem.prepared.equations.q0
    fitter.require_observed(target.rows(slice(0, 1)), start[None], _COLUMNS)
    return fitter.first_pose(target, start)


def check(problem: InverseProblem) -> None:
    """Raise those errors of `compute` that can be found from the pose in the first frame alone."""
    try:
        first, _ = _first_pose(problem)
        if problem.spec.unbalanced == "refuse":
            require_driven(problem.fitter, float(problem.measured.time[0]), first, problem.actuators)
    except SpecError as error:
        raise problem.spec.placed(error) from error


def compute(problem: InverseProblem) -> Inverse:
    """Compute the forces of actuators and joints.

    Raises
    ------
    SpecError
        If the input is wrong. The error contains the file and line of the key in the spec.
    RunError
        If no pose fits the data, or the mechanism passes a singular position.
    """
    try:
        fitted = fit(problem)
        return forces_of(problem, fitted, *motion_of(problem, fitted))
    except SpecError as error:
        raise problem.spec.placed(error) from error


def motion_of(problem: InverseProblem, fitted: Fitted) -> tuple[Independent | None, Motion]:
    """Return the motion of a fitted mechanism, and its independent coordinates unless derivatives were given."""
    fitter, measured = problem.fitter, fitted.measured
    if measured.derivatives is not None:
        return None, motion_of_derivatives(fitter.manifold, measured, fitted.q)
    independent = independent_coordinates(fitter, measured, fitted.q, problem.names.candidates())
    series = smoothed(measured.time, independent.quantities.values(fitted.q), problem.spec.motion.smooth)
    return independent, motion_of_series(fitter, independent, measured.time, fitted.q, series)


def forces_of(
    problem: InverseProblem, fitted: Fitted, independent: Independent | None, motion: Motion, *, strict: bool = True
) -> Inverse:
    """Return the result of inverse dynamics for a motion.

    See `compute` for errors, and `Recruiter.recruited` for `strict`.
    """
    loads = loads_of(problem, motion)
    report = problem.spec.unbalanced == "report"
    dynamics, balance, needed = solve_dynamics(problem.fitter, motion, loads, problem.actuators, report=report)
    recruiter = problem.recruiter
    recruited = None
    if recruiter is not None:
        axial = partial(axial_forces, problem, motion, dynamics, balance)
        recruited = recruiter.recruited(motion, dynamics, balance, needed, axial, strict=strict)
    return Inverse(problem, fitted, independent, motion, loads, dynamics, recruited)


def axial_forces(
    problem: InverseProblem, motion: Motion, dynamics: Dynamics, balance: Balance, pull: np.ndarray
) -> Axial:
    """Return the compressions of the knees of the targets of recruitment.

    Parameters
    ----------
    pull
        (T, n, M) generalized forces of unit tensions, which actuators balance.
    """
    assert problem.recruiter is not None
    knees, muscles = problem.recruiter.targets.knees, pull.shape[2]
    along = partial(_compressions, problem, motion, knees)
    without, nothing = along(dynamics.lam), along(np.zeros_like(dynamics.lam))
    unit = np.zeros((*without.shape, muscles))
    if knees:
        left = pull - products(balance.columns, balance.as_actuators(pull))
        for index in range(muscles):
            unit[..., index] = along(balance.directions.multipliers(left[..., index])) - nothing
    return Axial(without, unit)


def knees_of(problem: InverseProblem) -> list[tuple[int, int]]:
    """Return the indices of joint and shank of the knees of the result."""
    joints = problem.prepared.workspace.mechanism.joints
    shanks = {name: problem.names.mechanism.joints[name].bodies[1] for name in problem.source.result_names["knees"]}
    return [(list(joints).index(name), problem.names.body(shank, "model")) for name, shank in shanks.items()]


def _compressions(
    problem: InverseProblem, motion: Motion, knees: Sequence[Compartments], lam: np.ndarray
) -> np.ndarray:
    if not knees:
        return np.zeros((len(motion.time), 0))
    result = problem.fitter.manifold.reactions(motion.time, motion.q, motion.v, lam).reactions
    reactions = JointSums(problem.prepared.workspace.mechanism).sum(result)
    return np.stack([compression(reactions[:, knee.index], motion.q, knee.shank) for knee in knees], axis=1)


def compression(reaction: np.ndarray, q: np.ndarray, shank: int) -> np.ndarray:
    """Return the component (T, ...) of reactions of a knee (T, ..., 2 or 3) along the shank, positive if pushed.

    Parameters
    ----------
    q
        (T, n) positions.
    shank
        Index of the shank among the bodies; the knee is on the positive y axis of its frame.
    """
    angle = q[:, 3 * shank + 2].reshape(-1, *[1] * (reaction.ndim - 2))
    return np.asarray(elementary.sin(angle) * reaction[..., 0] - elementary.cos(angle) * reaction[..., 1])


def recorded_states(result: Inverse, knees: np.ndarray | None = None) -> States:
    """Return the states of the motion with accelerations, reactions, forces and energies.

    Parameters
    ----------
    knees
        (T, K, 3) compressions of knees with both sides of their bars; without bars if it is not given.

    Raises
    ------
    RunError
        If the states are not unique at a singular position.
    """
    motion, dynamics = result.motion, result.dynamics
    workspace, manifold = result.problem.prepared.workspace, result.problem.fitter.manifold
    count = len(motion.time)
    reactions = manifold.reactions(motion.time, motion.q, motion.v, result.lam)
    q, v, a = (np.column_stack([x, np.zeros((count, 3))]) for x in (motion.q, motion.v, motion.a))
    observer = StateObserver(workspace)
    observed: Observed = observer.arrays(count)
    singular = observer.observe(motion.time, q, v, observed, GivenForces(a, reactions.lam, reactions.reactions))
    if singular is not None:
        where = workspace.mechanism.unknown_name(singular.unknown)
        raise RunError(f"no unique solution near {where} at t = {motion.time[singular.row]:.6g} s")
    supplied = reactions.powers[:, 0] + dynamics.power.sum(axis=1) + result.loads.power.sum(axis=1)
    work, dissipated = (cumulative_simpson(x, x=motion.time, initial=0) for x in (supplied, reactions.powers[:, 1]))
    start, muscles = float(observed.kinetic[0] + observed.potential[0]), _muscles(result)
    handles: dict[str, object] = {"actuators": result.actuators}
    if muscles is not None:
        handles |= {"muscles": muscles, "knees": _knees(result, knees)}
    none = np.zeros(count)
    return States(workspace.mechanism, motion.time, q, v, lambda: observed, work, dissipated, start, handles, none)


def _knees(result: Inverse, bars: np.ndarray | None) -> np.ndarray:
    """Return the forces in knees; see `knee_forces`."""
    if bars is None:
        own, q = reactions_of(result), result.motion.q
        bars = np.full((len(q), len(knees := knees_of(result.problem)), 3), np.nan)
        for k, (joint, shank) in enumerate(knees):
            bars[:, k, 0] = compression(own[:, joint], q, shank)
    return knee_forces(result, bars)


def _muscles(result: Inverse) -> Muscles | None:
    if (one := result.recruited) is None:
        return None
    contraction, muscles = one.contraction, tuple(result.problem.names.mechanism.muscles.values())
    fibers = contraction.fiber_length, contraction.fiber_rate
    return Muscles(contraction.length, contraction.rate, *fibers, one.activation, one.force, one.power, muscles)


def without_followers(result: Inverse) -> Inverse:
    """Return the result for the same motion without the bodies that follow it."""
    problem = replace(result.problem, is_loaded=False)
    return forces_of(problem, result.fitted, result.independent, result.motion, strict=False)


def reactions_of(result: Inverse) -> np.ndarray:
    """Return the reaction forces and torques (T, J, 3) [N, N m]."""
    motion, problem = result.motion, result.problem
    rows = problem.fitter.manifold.reactions(motion.time, motion.q, motion.v, result.lam).reactions
    return JointSums(problem.prepared.workspace.mechanism).sum(rows)


def reaction_forces_without_muscles(result: Inverse) -> np.ndarray:
    """Return the reaction forces (T, J, 2) [N] for the same motion without muscles, produced by the actuators alone."""
    return reactions_of(replace(result, recruited=None))[:, :, :2]
