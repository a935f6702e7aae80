"""Criteria of the verdict on the model of inverse dynamics: its inertias, the elements of its beams, and the muscles
and reserves that share the moments.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from mbdkit.mechanism.improbable_bodies import improbable_people
from mbdkit.mechanism.improbable_values import improbable_measured
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.angles_in_degrees import angles_in_degrees
from mbdkit.runs.coarse_beams import CoarseBeams
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, recorded_states
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.inverse_dynamics.muscles.recruited import Recruited
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import RESERVE
from mbdkit_biomech.muscles.muscle_summary import PULLING

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
    workspace = result.problem.prepared.workspace
    mechanism = result.problem.names.mechanism
    if mechanism.beams:
        coarse = CoarseBeams(mechanism, workspace.mechanism)
        coarse.add(recorded_states(result))
        for warning in coarse.findings():
            yield doubt("elements", f"{warning}.")
    if result.recruited is not None:
        yield from _fibers(result, result.recruited)
        yield from _reserves(result, result.recruited)
        yield from _weak_muscles(result, result.recruited)


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
    for criterion, sentence in improbable_measured(mechanism):
        yield doubt(criterion, f"{sentence}.")
    for sentence in mechanism.left_out:
        yield doubt("left-out", f"{sentence}.")


def _fibers(result: Inverse, recruited: Recruited) -> Iterator[Finding]:
    low, high = PULLING
    for index, (name, muscle) in enumerate(result.problem.names.mechanism.muscles.items()):
        lengths = recruited.contraction.fiber_length[:, index] / muscle.optimal_length
        outside = np.flatnonzero((lengths < low) | (lengths > high))
        if outside.size:
            yield doubt(
                "fibers",
                f"the fibres of muscle '{name}' are {np.nanmin(lengths):.3g} to {np.nanmax(lengths):.3g} optimal "
                f"lengths long, in {outside.size} rows outside of {low:g} to {high:g}, where they have almost no "
                f"active force: check its path, optimal_length and tendon_length.",
            )


def _reserves(result: Inverse, recruited: Recruited) -> Iterator[Finding]:
    problem = result.problem
    names = [actuator.name for actuator in problem.actuators]
    reserves = [actuator.name for actuator in problem.recorded_actuators[len(names) :]]
    for reserve, values in zip(reserves, recruited.reserve.T, strict=True):
        name = reserve.removeprefix(RESERVE)
        actuator = names.index(name)
        most, whole = (float(np.max(np.abs(x))) for x in (values, recruited.actuator[:, actuator]))
        if most > AT_REST and most > RESERVE_SHARE * whole:
            at = result.motion.time[int(np.argmax(np.abs(values)))]
            unit = problem.actuators[actuator].unit
            share = f", {most / whole:.2g} of the largest value of {name}" if whole > 0 else ""
            yield doubt(
                "reserves",
                f"the reserve of {name} supplies up to {most:.4g} {unit} at t = {at:.6g} s{share} (doubtful above "
                f"{RESERVE_SHARE:g}), so that the muscles do not produce the motion alone: they are too weak or too "
                f"few, or the optimal force of the reserve is so large that it costs less than they do.",
            )


def _weak_muscles(result: Inverse, recruited: Recruited) -> Iterator[Finding]:
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
        share = moments[best] / peaks[acting][best]
        if share < WEAK:
            actuator = problem.actuators[acting[best]]
            yield doubt(
                "max-force",
                f"muscle '{name}' with a max_force of {muscle.max_force:g} N can exert at most {share:.2g} of the "
                f"largest value of {actuator.name}, {peaks[acting][best]:.4g} {actuator.unit} (doubtful below "
                f"{WEAK:g}): is its force in another unit, such as kN?",
            )
