"""Criterion of the verdict on stated deviations: the data contradict them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import judged_frames, residual_wrench
from mbdkit_biomech.inverse_dynamics.criteria.unmeasured_contacts import unmeasured_frames
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
