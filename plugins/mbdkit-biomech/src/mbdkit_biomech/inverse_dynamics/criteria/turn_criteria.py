"""Criteria of the verdict on the full turns of angles, which wrapped data leave open and on which springs depend, and
on the sign of knee flexion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mbdkit.base.text import listed
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.forces import TorsionSpring
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.pathways import AnglePathway, JointAngles
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt

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
            off = abs(changes[b] - changes[a])
            if off > HALF_TURN:
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
    columns = np.flatnonzero(measured.may_turn & (off > HALF_TURN)).tolist()
    if columns:
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
