"""Criteria of the verdict on the model of inverse dynamics: its inertias, the elements of its beams, and the muscles
and reserves that share the moments; on the full turns of angles, which wrapped data leave open and on which springs
depend, and on the sign of knee flexion; and on persons: compression of knees, data that contradict stated deviations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np

from mbdkit.base.text import listed
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.forces import TorsionSpring
from mbdkit.mechanism.improbable_bodies import improbable_people
from mbdkit.mechanism.improbable_values import improbable_measured
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import AnglePathway, JointAngles
from mbdkit.runs.angles_in_degrees import angles_in_degrees
from mbdkit.runs.coarse_beams import CoarseBeams
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import (
    Inverse,
    compression,
    reaction_forces_without_muscles,
    reactions_of,
    recorded_states,
)
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt, doubts
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import judged_frames, residual_wrench
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import unmeasured_frames
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.muscles.recruited import Recruited
from mbdkit_biomech.inverse_dynamics.signals.chi_square import quantile, quantile_of_many
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import RESERVE, free_roots
from mbdkit_biomech.muscles.muscle_summary import PULLING
from mbdkit_biomech.persons.landmarks import LEFT

#: A reserve is doubtful if its peak exceeds this share of the peak of the moment to which the reserve contributes.
#:
#: OpenSim's user guide recommends peaks of reserves below 10 % of the peak joint moment.
RESERVE_SHARE = 0.1

#: A muscle is too weak if it can exert less than this share of the peak of every moment to which it contributes.
#:
#: The muscles of the packaged examples can exert 0.8 times the peak or more. A `max_force` given in kN instead of N is
#: too small by a factor of 1000.
WEAK = 0.01

#: Smallest moment arm that is assumed in the search for weak muscles, as a share of the longest link. Muscles that act
#: mainly out of the plane may have smaller moment arms, although they are not weak.
LEAST_ARM = 0.02

AT_REST = 1e-9  #: Peaks of moments and forces [N m, N] below this value are rounding errors.


def model_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield doubts about the masses, beams, muscles and reserves of the model."""
    yield from spec_doubts(result.problem.spec)
    mechanism = result.problem.names.mechanism
    if mechanism.beams:
        coarse = CoarseBeams(mechanism, result.problem.prepared.workspace.mechanism)
        coarse.add(recorded_states(result))
        yield from doubts("elements", (f"{warning}." for warning in coarse.findings()))
    if result.recruited is not None:
        yield from doubts("fibers", _fibers(result, result.recruited))
        yield from doubts("reserves", _reserves(result, result.recruited))
        yield from doubts("max-force", _weak_muscles(result, result.recruited))


def spec_doubts(spec: InverseSpec) -> Iterator[Finding]:
    """Yield a doubt for each angle of the model that is probably in degrees, for a body height and a body mass that no
    person has, and those of `mechanism_doubts`.
    """
    for sentence in chain(angles_in_degrees(spec), improbable_people(spec.model)):
        yield doubt("units", f"{sentence}.")
    yield from mechanism_doubts(spec.mechanism())


def mechanism_doubts(mechanism: Mechanism) -> Iterator[Finding]:
    """Yield a doubt for each inertia, quantity of a beam, free length, optimal length and size of a body that seems to
    have another unit, and for effects that the mechanism lacks.
    """
    yield from (doubt(criterion, f"{sentence}.") for criterion, sentence in improbable_measured(mechanism))
    yield from doubts("left-out", (f"{sentence}." for sentence in mechanism.left_out))


def _fibers(result: Inverse, recruited: Recruited) -> Iterator[str]:
    low, high = PULLING
    for index, (name, muscle) in enumerate(result.problem.names.mechanism.muscles.items()):
        lengths = recruited.contraction.fiber_length[:, index] / muscle.optimal_length
        if (outside := np.flatnonzero((lengths < low) | (lengths > high))).size:
            yield (
                f"the fibres of muscle '{name}' are {np.nanmin(lengths):.3g} to {np.nanmax(lengths):.3g} optimal "
                f"lengths long, in {outside.size} rows outside of {low:g} to {high:g}, where they have almost no "
                f"active force: check its path, optimal_length and tendon_length."
            )


def _reserves(result: Inverse, recruited: Recruited) -> Iterator[str]:
    problem = result.problem
    names, every = [actuator.name for actuator in problem.actuators], recruited.actuators[..., 0]
    reserves = [actuator.name for actuator in problem.recorded_actuators[len(names) :]]
    for reserve, values in zip(reserves, every[:, len(names) :].T, strict=True):
        name = reserve.removeprefix(RESERVE)
        actuator = names.index(name)
        most, whole = (float(np.max(np.abs(x))) for x in (values, every[:, actuator]))
        if most > AT_REST and most > RESERVE_SHARE * whole:
            at = result.motion.time[int(np.argmax(np.abs(values)))]
            unit = problem.actuators[actuator].unit
            share = f", {most / whole:.2g} of the largest value of {name}" if whole > 0 else ""
            yield (
                f"the reserve of {name} supplies up to {most:.4g} {unit} at t = {at:.6g} s{share} (doubtful above "
                f"{RESERVE_SHARE:g}), so that the muscles do not produce the motion alone: they are too weak or too "
                f"few, or the optimal force of the reserve is so large that it costs less than they do."
            )


def _weak_muscles(result: Inverse, recruited: Recruited) -> Iterator[str]:
    problem = result.problem
    arms = np.max(np.abs(recruited.sharing.arms), axis=0)  # (U, M)
    peaks = np.max(np.abs(result.dynamics.value), axis=0)
    least = LEAST_ARM * problem.fitter.manifold.length
    for index, (name, muscle) in enumerate(problem.names.mechanism.muscles.items()):
        acting = np.flatnonzero((arms[:, index] > 0) & recruited.sharing.driven & (peaks > AT_REST))
        if not acting.size:
            continue
        moments = muscle.max_force * np.maximum(arms[acting, index], least)
        best = int(np.argmax(moments / peaks[acting]))
        if (share := moments[best] / peaks[acting][best]) < WEAK:
            actuator = problem.actuators[acting[best]]
            yield (
                f"muscle '{name}' with a max_force of {muscle.max_force:g} N can exert at most {share:.2g} of the "
                f"largest value of {actuator.name}, {peaks[acting][best]:.4g} {actuator.unit} (doubtful below "
                f"{WEAK:g}): is its force in another unit, such as kN?"
            )


def misfit_doubts(result: Inverse, bars: ResultBars | None) -> Iterator[Finding]:
    """Yield a doubt if differences that should vanish are larger than the stated deviations explain.

    These are the differences in the plane between centres by landmarks or regression and those by the motion, and, if
    both feet have loads, residual forces and moment. Residuals at different times have common causes, so that the mean
    square over time of each counts as that of one variable.
    """
    if (person := result.problem.source.person) is None:
        return
    squares = {f"centre of {joint}": center.square for joint, center in person.centers.items() if center.square}
    freedoms = 2 * len(squares)
    roots = free_roots(result.problem.names.mechanism)
    inside = judged_frames(len(result.motion.time), unmeasured_frames(result))
    measured = {"foot", f"foot{LEFT}"} <= {load.body for load in result.problem.spec.loads.values()}
    if bars is not None and bars.uncertain is not None and len(roots) == 1 and measured and inside.any():
        residual, bar = (x[inside] for x in residual_wrench(result, roots[0], bars, only_residuals=False))
        mean = np.mean(residual * residual, axis=0) / np.mean(bar * bar, axis=0) * quantile(1.0)
        squares |= dict(zip(("residual force along x", "residual force along y", "residual moment"), mean, strict=True))
        freedoms += 3
    whole = float(sum(squares.values()))
    if not squares or not whole > (limit := quantile_of_many(freedoms)):
        return
    texts = [f"{name} {squares[name] ** 0.5:.1f}" for name in sorted(squares, key=lambda name: -squares[name])[:3]]
    yield doubt(
        "misfit",
        f"landmarks, motion and loads contradict each other by more than the stated deviations explain: the sum of "
        f"squares relative to them is {whole:.1f} for {freedoms} degrees of freedom (doubtful above {limit:.1f}, which "
        f"Gaussian errors exceed in 5 % of cases); largest are {listed(texts, 'and')} deviations. Error bars are too "
        "narrow: check markers, plates and subject, or state larger deviations in `uncertainty`",
    )


#: A foot stands alone if its load exceeds this share of the largest load of all plates, and no other one acts.
STANCE = 0.5

#: Compression is doubtful if it is smaller than without muscles by more than the first share of the ground's force in
#: more than the second share of the rows in single stance.
LESS, FRAMES = 0.05, 0.05

PULLED = 0.01  #: A knee is pulled if muscles leave a tension of more than this share of its largest force.


def compression_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt for each knee whose compression in single stance is smaller than without muscles, which is the
    force of the ground less weight and inertia of the segments beneath; and a finding, which makes the result bad, for
    each knee that muscles pull apart, beyond what weight and inertia do without muscles.
    """
    if result.recruited is None:
        return
    names, joints = result.problem.names, list(result.problem.prepared.workspace.mechanism.joints)
    loads, measured = result.loads, len(result.problem.loads)  # further loads are those of worn devices
    size = np.sqrt(np.sum(loads.force * loads.force, axis=2))[:, :measured]
    reactions, without = reactions_of(result)[..., :2], reaction_forces_without_muscles(result)
    for leg in ("", LEFT):
        knee = f"knee{leg}"
        if knee not in joints or f"shank{leg}" not in names.mechanism.bodies:
            continue
        index, shank = joints.index(knee), names.body(f"shank{leg}", "model")
        pushed, alone = (compression(one[:, index], result.motion.q, shank) for one in (reactions, without))
        columns = [column for column, body in enumerate(loads.bodies[:measured]) if body == f"foot{leg}"]
        ground, other = np.sum(size[:, columns], axis=1), np.sum(np.delete(size, columns, axis=1), axis=1)
        stands = (ground > STANCE * np.max(size, initial=0.0)) & (other <= 0)
        less = np.where(stands, alone - pushed, -np.inf)
        if np.sum(less > LESS * ground) > FRAMES * np.sum(stands):
            row = int(np.argmax(less))
            yield doubt(
                "compression",
                f"muscles reduce the compression of {knee} in single stance by up to {less[row]:.4g} N (t = "
                f"{result.motion.time[row]:.6g} s), below the force of the ground less weight and inertia of the "
                "segments beneath; muscles pull, and can only add to it: check the paths of the muscles that cross it",
            )
        row = int(np.argmin(pushed - np.minimum(alone, 0.0)))
        if pushed[row] < min(alone[row], 0.0) - PULLED * float(np.max(np.linalg.norm(reactions[:, index], axis=1))):
            sentence = (
                f"{knee} is pulled: muscles leave a tension of {-pushed[row]:.4g} N along the shank at t = "
                f"{result.motion.time[row]:.6g} s, which cartilage cannot carry: give the muscles of the quadriceps a "
                "`patella`, and check the paths of the muscles that cross the knee"
            )
            yield Finding("compression", "bad", sentence)


#: The number of full turns of an angle is uncertain if the angle in the first row differs from that of the model by
#: more than this [rad], which is about 160 degrees.
HALF_TURN = 2.8


def turn_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt for each force that depends on an angle whose number of full turns is uncertain."""
    if result.problem.spec.motion.is_run:
        return
    mechanism, bodies = result.problem.names.mechanism, result.problem.fitter.bodies
    change = (result.fitted.q[0] - result.problem.prepared.equations.q0)[2::3]
    changes = dict(zip(bodies, change.tolist(), strict=True)) | {GROUND: 0.0}
    for name, force in mechanism.forces.items():
        if not isinstance(force, TorsionSpring | Law) or (isinstance(force, TorsionSpring) and not force.stiffness):
            continue
        pathway = force.pathway
        if not isinstance(pathway, AnglePathway | JointAngles):
            continue
        for a, b in (segment.bodies for segment in pathway.segments(mechanism.joints)):
            if (off := abs(changes[b] - changes[a])) > HALF_TURN:
                columns = _angles_of(result, [bodies.index(one) for one in (a, b) if one != GROUND])
                yield doubt(
                    "turns",
                    f"force '{name}' depends on the angle between {a} and {b}, which in the first row differs by "
                    f"{off:.3g} rad from that of the model (doubtful above {HALF_TURN:g}), so that its number of full "
                    f"turns is not certain{columns}: give the bodies in the model about the angles that they have in "
                    "the first row.",
                )


def uncertain_turns(result: Inverse) -> Iterator[str]:
    """Yield a remark on columns of angles whose number of full turns is uncertain."""
    measured = result.problem.measured
    pose = measured.quantities.values(result.problem.prepared.equations.q0[None])[0]
    off = np.abs(measured.values[0] - pose) / measured.quantities.scale
    if columns := np.flatnonzero(measured.may_turn & (off > HALF_TURN)).tolist():
        text = listed([f"{measured.names[index]} {off[index]:.3g} rad" for index in columns], "and")
        yield (
            f"the first values of columns differ by about half a turn from those of the model ({text}). If these "
            "angles have another zero than in the model, correct it with the `offset` of a named coordinate; otherwise "
            "give the bodies in the model about the angles that they have in the first row, because the numbers of "
            "full turns are not certain."
        )


def _angles_of(result: Inverse, bodies: Iterable[int]) -> str:
    """Return a clause with the columns of angles that depend on the angles of bodies; empty if there are none."""
    measured = result.problem.measured
    slopes = measured.quantities.jacobian(result.fitted.q[:1])[0][:, [3 * body + 2 for body in bodies]]
    concerned = measured.quantities.is_angle & np.any(slopes != 0.0, axis=1)
    names = [name for name, one in zip(measured.names, concerned, strict=True) if one]
    return f" (columns of {listed(names, 'and')})" if names else ""


KNEE = "knee_flexion"  #: Coordinates whose names begin with this are positive if the knee is bent.

#: The sign is doubtful if the knee is hyperextended by more than the first number of degrees in more than this share of
#: the frames, and flexed by at most half as much in all but this share. Healthy knees extend to between 0 and 10
#: degrees beyond the straight leg.
HYPEREXTENDED, FRAMES = 20.0, 0.1


def knee_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt for each coordinate of knee flexion that is negative beyond what knees allow."""
    names = result.problem.names
    for name in names.mechanism.coordinates:
        if not name.startswith(KNEE):
            continue
        values = np.degrees(names.coordinate(name).value(result.fitted.q))
        least, most = np.quantile(values, (FRAMES, 1 - FRAMES)).tolist()
        if least < -HYPEREXTENDED and most <= -least / 2:
            yield doubt(
                "knee",
                f"{name} is below {least:.3g} degrees in {FRAMES:.0%} of the rows (doubtful below "
                f"{-HYPEREXTENDED:g}), although flexion is positive: the knee is hyperextended. If its "
                "column has the other sign, write `scale: -1`; otherwise check the sign and offset of the coordinate.",
            )
