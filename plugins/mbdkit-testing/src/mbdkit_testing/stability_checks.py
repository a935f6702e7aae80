"""Claims of A- and L-stability, tested on linear oscillators and dampers, and claims of variable order.

The eigenvalues of the mechanisms are multiplied by steps of a fixed size to products of many decades. Nothing is
assumed of the method: multistep methods and methods for constrained formulations are tested in the same way.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit_testing.check import STEP_LIMIT, Skip, check
from mbdkit_testing.check_result import Result, at_most, failed, passed, unclaimed
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, stretches
from mbdkit_testing.trial_models import oscillators

STEP = 0.01
#: Damping ratios of the oscillators: from the imaginary axis, on which multistep methods of order 3 and more fail, to
#: the real axis.
DAMPING = (0.0, 0.02, 0.1, 0.3, 0.7, 1.5)
#: Moduli of the eigenvalues of the undamped oscillator times the step.
PRODUCTS = tuple(10.0**power for power in np.linspace(-1.0, 3.0, 13))
#: Number of steps, and largest ratio of the amplitudes of their last and second quarters that counts as stable.
STEPS, GROWTH = 80, 1.0 + 1e-6
#: Frequencies [rad/s], tolerance and relative deflection of oscillators for adaptive methods, and the largest ratio of
#: the numbers of steps that counts as stable: what is so small needs small steps only for stability, which are then in
#: proportion to the period.
FREQUENCIES, LOOSE, SMALL, MORE = (1e2, 1e4), 1e-3, 1e-4, 10.0
#: Number of steps of the test of L-stability, and its two products of eigenvalue and step.
DAMPED_STEPS, STIFF, STIFFEST = 4, 1e3, 1e6
#: L-stable methods leave at `STIFFEST` at most this share of what they leave at `STIFF`, or a negligible amplitude.
LEFT, NEGLIGIBLE = 0.1, 1e-12


def amplitudes(integrator: IntegratorUnderTest, product: float, damping: tuple[float, ...], steps: int) -> np.ndarray:
    """Return the amplitudes (steps + 1, number of oscillators) of oscillators that are released at a deflection of 1 m.

    The amplitude is the square root of the energy, relative to that at a deflection of 1 m.

    Parameters
    ----------
    product
        Frequency of the undamped oscillator times the step.
    damping
        Damping ratio of each oscillator.
    """
    frequency = product / STEP
    workspace = integrator.workspace(oscillators(frequency, damping))
    stepper = integrator.stepper(workspace, steps * STEP, steps, every=1)
    rows = [np.hypot(stretch.q - 1.0, stretch.v / frequency) for stretch in stretches(stepper)]
    return np.concatenate(rows)[:, : 3 * len(damping) : 3]


@check("stability.a-stable")
def a_stable(integrator: IntegratorUnderTest) -> Result:
    """The oscillations of linear oscillators with and without damping do not grow in an A-stable method, whatever the
    product of frequency and step.
    """
    if integrator.claims.adaptive:
        return _adaptive(integrator)
    worst, where = 0.0, ""
    for product in PRODUCTS:
        text = f"at a frequency times step of {product:.3g}"
        try:
            result = amplitudes(integrator, product, DAMPING, STEPS)
        except Skip as stopped:
            worst, where = math.inf, f"{text} {stopped}"
            break
        quarter = STEPS // 4
        before, after = result[quarter : 2 * quarter].max(axis=0), result[3 * quarter :].max(axis=0)
        growth = np.where(after < NEGLIGIBLE, 0.0, after / np.maximum(before, NEGLIGIBLE))
        if growth.max() > worst:
            worst = float(growth.max())
            where = f"{text} and a damping ratio of {DAMPING[int(growth.argmax())]:g} oscillations grow"
        if worst > GROWTH:
            break
    if not integrator.claims.a_stable:
        return unclaimed(growth=worst)
    return at_most(GROWTH, f"it claims to be A-stable, but {where}", growth=worst)


def _adaptive(integrator: IntegratorUnderTest) -> Result:
    """Return whether the number of steps is limited where deflections are far below the tolerance."""
    if "rtol" not in integrator.plugin.options.model_fields:
        raise Skip("it is adaptive, and has no option `rtol`")
    options, counts = integrator.tolerances(LOOSE), list[int]()
    for frequency in FREQUENCIES:
        model = oscillators(frequency, DAMPING, LOOSE * SMALL)
        with integrator.run(model, {"end": 1.0}, options=options, output={"every": 10**9}) as run:
            counts.append(int(run.stats["accepted"]) if run.status == "complete" else STEP_LIMIT)
    figures = {f"steps_at_{frequency:g}": count for frequency, count in zip(FREQUENCIES, counts, strict=True)}
    if not integrator.claims.a_stable:
        return unclaimed(**figures)
    if counts[1] > MORE * counts[0]:
        return failed("it claims to be A-stable, but takes more steps where oscillators are stiffer", **figures)
    return passed(**figures)


@check("stability.l-stable")
def l_stable(integrator: IntegratorUnderTest) -> Result:
    """What an L-stable method leaves of strongly damped oscillations after some steps tends to zero as the product of
    eigenvalue and step grows.
    """
    if integrator.claims.adaptive:
        raise Skip("it is adaptive: its steps follow the frequency")
    damping = tuple(ratio for ratio in DAMPING if ratio > 0.5)
    try:
        stiff, stiffest = (
            float(amplitudes(integrator, product, damping, DAMPED_STEPS)[-1].max()) for product in (STIFF, STIFFEST)
        )
    except Skip as stopped:
        if integrator.claims.l_stable:
            return failed(f"it claims to be L-stable, but {stopped}")
        raise
    figures = {"left_at_1e3": stiff, "left_at_1e6": stiffest}
    if not integrator.claims.l_stable:
        return unclaimed(**figures)
    if not (stiffest < NEGLIGIBLE or stiffest < LEFT * stiff):
        cause = f"it claims to be L-stable, but {DAMPED_STEPS} steps leave {stiffest:.2g} of a stiff mode"
        return failed(cause, **figures)
    return passed(**figures)


CHECKS = (a_stable, l_stable)
