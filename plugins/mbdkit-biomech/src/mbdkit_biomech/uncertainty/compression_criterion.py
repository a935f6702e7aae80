"""Criteria of the verdict on persons: compression of knees, and data that contradict stated deviations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, compression, reaction_forces_without_muscles, reactions_of
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import judged_frames, residual_wrench
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import unmeasured_frames
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.signals.chi_square import quantile, quantile_of_many
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import free_roots
from mbdkit_biomech.persons.landmarks import LEFT


def misfit_doubts(result: Inverse, bars: ResultBars | None) -> Iterator[Finding]:
    """Yield a doubt if differences that should vanish are larger than the stated deviations explain.

    These are the differences in the plane between centres by landmarks or regression and those by the motion, and, if
    both feet have loads, residual forces and moment. Residuals at different times have common causes, so that the mean
    square over time of each counts as that of one variable.
    """
    person = result.problem.source.person
    if person is None:
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
