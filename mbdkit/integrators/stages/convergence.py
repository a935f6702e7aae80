"""Convergence tests of the iterations that solve stage equations, with the constants that they use.

An iteration ends in one of three ways. It converges when the change that the next iteration would make is predicted to
be negligible (Hairer and Wanner 1996, *Solving Ordinary Differential Equations II*, IV.8, equation 8.10; Deuflhard
2004, *Newton Methods for Nonlinear Problems*, section 2.1). It stalls when changes no longer decrease; this is accepted
only if round-off explains the remaining change. Otherwise it fails. The *contraction* is the ratio of the change by an
iteration to the change by the previous one.

Linear and angular quantities are always compared separately, because their units have no common size.

The tests of index 1 serve single runs and runs in lanes (`mbdkit_builder.lane_types`), where they return masks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.kernels.cross_sections import beam_levels
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS
from mbdkit.engine.kernels.table_rows import LINEAR, PAIR, SPRING, TENSION
from mbdkit.engine.native.arithmetic import any_of, where
from mbdkit.engine.native.functions import subkernel

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

#: Default tolerance of the predicted change: relative to accelerations for index 1, to the state otherwise.
#:
#: It is below `EPS` so that in fixed steps the iteration adds no error of its own, which would break the symmetry of
#: the method. Measured for Gauss with four stages and a double pendulum over 200 000 steps of 0.01 s: the relative
#: drift of the energy is 4e-10 with a tolerance of 1e-14, 1e-10 with 1e-15, 2e-11 with 1e-16, and 1e-11 with 1e-17 and
#: with 1e-18, where it is due to rounding alone. With 1e-18, a step takes 0.05 to 0.6 iterations more than with 1e-17.
TOLERANCE = 1e-17

#: Largest contraction for which later changes are predicted (a chosen value). RADAU5 predicts them up to 0.99.
#:
#: The predicted sum of all later changes is theta / (1 - theta) times the last one; for theta near 1 that is
#: unreliable.
LARGEST_CONTRACTION = 0.9

LARGEST_RATE = 0.99  #: Contraction from which a careful iteration counts as diverging (RADAU5).

#: Contraction above which an iteration counts as stalled.
#:
#: Converging simplified Newton iterations contract by O(h^2), usually by 1e-2 or less. Round-off gives ratios near 1.
#: QNERR of Deuflhard (2004) gives up at the same contraction (``THETA_MAX``).
STALLED = 0.5

#: A stalled relative change below this is round-off (a chosen value).
#:
#: Cancellation of forces and the solution of the linear systems amplify `EPS` by factors of some hundred to thousand.
NEGLIGIBLE_CHANGE = 1e-12

#: Smallest divisor. It avoids a division by zero where the quotient is not used or its dividend is zero.
SMALLEST = 1e-300

#: Stalled iterations after which weaker criteria for round-off apply.
#:
#: Two are not enough: a single large ratio also occurs where the iteration changes its tangent. With four instead of
#: three, positions in the packaged examples differ by at most 4e-15 of the largest one after up to ten steps.
PATIENCE = 3

#: Relative change above which growth counts as divergence; chosen. Smaller changes may grow by round-off alone.
RUNAWAY = 1e-6

#: Growth from one iteration to the next that counts as divergence, and the first iteration where it does; chosen.
#:
#: The first iterations start from free flight or from an old tangent and may grow before they converge.
RUNAWAY_GROWTH, FIRST_RUNAWAY = 4.0, 5

#: Contraction above which the tangent is evaluated again within the step; chosen.
#:
#: Evaluating and factorizing it costs about as much as three iterations, so it must save at least that many. RADAU5
#: keeps its Jacobian for the next step if the contraction is below 0.001 (``THET``). Here it is evaluated in every
#: step.
SLOW = 0.25

#: Number of iterations with one tangent before it is evaluated again; two changes are needed to know the contraction.
FEWEST_WITH_ONE_TANGENT = 3

MOST_ITERATIONS = 50  #: Default limit of the iterations in a step.

CONFIRMED_GROWTH = 10.0  #: Growth of the last change, with new tangents, up to which it counts as round-off; chosen.

#: Number of iterations over which the contraction has to be steady if the limit of iterations is extended; chosen. Over
#: fewer iterations, steady contraction may occur by chance.
STEADY = 10

#: Limit of the iterations in a fixed step that contract steadily, unless the user gives one; chosen. Iterations that
#: contract by 0.94 converge within it.
MOST_EXTENDED = 500

#: A solution of the stage equations is rejected if its accelerations change positions in the step by more than this, in
#: units of the largest position or displacement of the step (at least 1 m or 1 rad); chosen far above the changes that
#: a method can resolve.
FAR = 1e9

#: Relative change below which the accelerations of the next iteration are refined to round-off (index 1); chosen.
#:
#: The error of an unrefined solution has no influence on iterations with larger changes.
ROUGH_CHANGE = 1e-5


class IterationLimit(NamedTuple):
    """Limit of the iterations in a step; arrays of one item.

    Steps that are too long for the default limit are rejected under step size control. A fixed step is repeated with an
    extended limit, which has a second rule: see `loses_steadiness`.
    """

    most: np.ndarray  #: Iterations after which the equations count as unsolved.
    steady_after: np.ndarray  #: Iterations after which contraction has to be steady.


def new_limit(given: int | None) -> IterationLimit:
    """Return the limit given by the user, or the default one."""
    most = MOST_ITERATIONS if given is None else given
    return IterationLimit(np.array([most], dtype=np.int64), np.array([most], dtype=np.int64))


@subkernel
def is_converged(n, now, ratio, tolerance):
    """Return whether the predicted change of later iterations is within `tolerance`.

    Hairer and Wanner (1996), IV.8.10, with ``kappa Tol = tolerance``; RADAU5 and SciPy's Radau use the same test with
    a tolerance of at most 0.03 of that of the error.

    Parameters
    ----------
    n
        Number of iterations so far.
    now, ratio
        Relative change by the last iteration, and its contraction.
    tolerance
        Largest relative change that is negligible.
    """
    is_negligible = (ratio < LARGEST_CONTRACTION) & (ratio / (1.0 - ratio) * now <= tolerance)
    return (now == 0.0) | ((n > 1) & is_negligible)


@subkernel
def confirms(now, before):
    """Return whether a change with new tangents confirms that the iteration has converged with the old ones."""
    return (now <= NEGLIGIBLE_CHANGE) | (now <= CONFIRMED_GROWTH * before)


@subkernel
def predicts_failure(n, most, now, ratio, tolerance):
    """Predict from the last contraction whether an iteration with one tangent fails to converge in `most` iterations.

    RADAU5 and SciPy's Radau give up by the same test (Hairer and Wanner 1996, IV.8, p. 121). Changes at the level of
    round-off predict nothing.

    Parameters
    ----------
    n, most
        Number of iterations so far, and the largest number.
    now, ratio
        Relative change by the last iteration, and its contraction.
    tolerance
        Relative change at which the iteration ends.
    """
    fails = (n >= 2) & (not now <= NEGLIGIBLE_CHANGE)
    if any_of(fails):
        last = ratio ** (most - n) / max(1.0 - ratio, SMALLEST) * now
        fails = fails & ((ratio >= LARGEST_RATE) | (last > max(tolerance, NEGLIGIBLE_CHANGE)))
    return fails


@subkernel
def loses_steadiness(n, limit, peak, earlier, tolerance):
    """Return whether an iteration with an extended limit does not contract steadily enough to converge.

    Every `STEADY` iterations, the largest change in the last `STEADY` iterations is compared with that in the `STEADY`
    iterations before them. An iteration without steady contraction is stopped, so that it cannot converge to a distant
    solution.

    Parameters
    ----------
    n, limit
        Number of iterations so far, and its `IterationLimit`.
    peak, earlier
        Largest relative change in the last `STEADY` iterations, and in those before.
    tolerance
        Relative change at which the iteration ends.
    """
    if n < limit.steady_after[0] or n % STEADY != 0:
        return peak < 0.0  # nowhere
    rate = elementary.pow(peak / earlier, 1.0 / STEADY)
    return (rate >= 1.0) | predicts_failure(n, limit.most[0], peak, rate, tolerance)


@subkernel
def is_stalled(n, now, ratio):
    """Return whether the change no longer decreases."""
    return (n > 1) & (ratio > STALLED) & (now < np.inf)


@subkernel
def moves_by_roundings(moved):
    """Return whether a relative change of positions is a few units of round-off."""
    return moved <= FEW_ROUNDINGS * EPS


@subkernel
def has_failed(n, most, now, ratio):
    """Return whether an iteration diverges, has used up its `most` iterations, or gives a change that is not finite."""
    runs_away = (n >= FIRST_RUNAWAY) & (ratio > RUNAWAY_GROWTH) & (now > RUNAWAY)
    return (n >= most) | runs_away | (not now < np.inf)


@subkernel
def stays_near(c, acc, h):
    """Return whether the accelerations of the stages (s, n) change positions in a step by less than `FAR` allows.

    Near a singular position, an iteration can diverge and then converge relative to accelerations of 1e40 m/s^2.
    """
    largest, size = 0.0, 1.0
    for i in range(len(acc)):
        for d in range(len(c.q) - 3):
            largest = where(abs(acc[i, d]) <= largest, largest, abs(acc[i, d]))  # becomes NaN if one is NaN
    for d in range(len(c.q) - 3):
        size = max(max(size, abs(c.q[d])), h * abs(c.v[d]))
    return h * h * largest < FAR * size


@subkernel
def relative_to_accelerations(acc, change, bodies):
    """Return the largest change of an acceleration relative to the largest acceleration.

    Linear and angular accelerations are compared separately, and the larger result is returned. The result is at most
    1, because a change can be larger than the resulting acceleration where forces cancel. It is infinite if a change is
    not finite.
    """
    size_t = size_r = change_t = change_r = 0.0
    finite = True
    for i in range(len(acc)):
        for b in range(bodies):
            size_t = max(max(size_t, abs(acc[i, 3 * b])), abs(acc[i, 3 * b + 1]))
            size_r = max(size_r, abs(acc[i, 3 * b + 2]))
            now_t = abs(change[i, 3 * b]) + abs(change[i, 3 * b + 1])
            now_r = abs(change[i, 3 * b + 2])
            finite = finite & (now_t + now_r < np.inf)  # `max` ignores NaN
            change_t = max(change_t, now_t)
            change_r = max(change_r, now_r)
    relative_t = change_t / max(size_t, max(change_t, SMALLEST))
    relative_r = change_r / max(size_r, max(change_r, SMALLEST))
    return where(finite, max(relative_t, relative_r), np.inf)


@subkernel
def _largest_sizes(x, change, bodies):
    """Return the largest linear and angular entries of `x`, each at least 1, and those of `change` (s, 3 (B + 1)).

    The entries of `change` count as infinite if it contains NaN.
    """
    size_t = size_r = 1.0
    change_t = change_r = 0.0
    finite = True
    for b in range(bodies):
        size_t = max(max(size_t, abs(x[3 * b])), abs(x[3 * b + 1]))
        size_r = max(size_r, abs(x[3 * b + 2]))
        for i in range(len(change)):
            now_t = max(abs(change[i, 3 * b]), abs(change[i, 3 * b + 1]))
            now_r = abs(change[i, 3 * b + 2])
            finite = finite & (now_t + now_r < np.inf)
            change_t = max(change_t, now_t)
            change_r = max(change_r, now_r)
    return size_t, size_r, where(finite, change_t, np.inf), where(finite, change_r, np.inf)


@subkernel
def relative_to_state(change, x, bodies):
    """Return the largest entry of `change` (s, 3 (B + 1)) relative to the largest entry of `x`; linear and angular
    entries are compared separately.

    `x` (3 (B + 1),) holds positions or velocities; sizes below 1 m, 1 rad, 1 m/s or 1 rad/s count as 1. The result is
    infinite if a change is not a number.
    """
    size_t, size_r, change_t, change_r = _largest_sizes(x, change, bodies)
    return max(change_t / size_t, change_r / size_r)


@subkernel
def accelerations_are_round_off(c, m, h, patient):
    """Return whether a change of the stage accelerations that no longer decreases is round-off.

    It is round-off if it changes the positions of a step by a few units of round-off only. Lengths are compared with
    the largest coordinate (at least 1 m), angles with the largest angle (at least 1 rad). If `patient`, also accept
    changes that are small compared with the acceleration that any single force would cause: forces that cancel, or that
    act along their own lever arm, still contribute their round-off, so that magnitudes are added instead of the forces.

    Parameters
    ----------
    c, m
        Bundles of the run and of the stages; `w.jac` and the force terms are those of the last stage.
    h
        Step [s].
    patient
        Whether the iteration has stalled for several iterations.
    """
    top, w = c.top, c.w
    last = len(m.acc) - 1
    v, lam, acc = m.v_stage[last], m.lam[last], m.acc[last]
    bodies = len(top.mass) - 1
    size_t, size_r, change_t, change_r = _largest_sizes(c.from_q, m.change, bodies)
    small_t = change_t * h * h <= FEW_ROUNDINGS * EPS * size_t
    small_r = change_r * h * h <= FEW_ROUNDINGS * EPS * size_r
    small = small_t & small_r
    if not any_of(patient & (not small)):
        return small
    level_t = level_r = inverse_arm = 0.0
    for b in range(bodies):
        level_t = max(max(level_t, abs(top.gravity[0])), abs(top.gravity[1]))
        level_t = max(max(level_t, abs(acc[3 * b])), abs(acc[3 * b + 1]))
        level_r = max(level_r, abs(acc[3 * b + 2]))
    for k in range(len(top.pairs)):
        force = abs(lam[k, 0]) + abs(lam[k, 1])
        for side in range(2):
            b = top.pairs[k, PAIR.first + side]
            e = 3 * side
            x, y = abs(w.jac[k, e]) + abs(w.jac[k, 6 + e]), abs(w.jac[k, e + 1]) + abs(w.jac[k, 7 + e])
            arm = abs(top.pair_parameters[k, 2 * side]) + abs(top.pair_parameters[k, 2 * side + 1])
            turn = abs(w.jac[k, e + 2]) + abs(w.jac[k, 8 + e]) + arm
            inverse_arm = where(arm > 0.0, max(inverse_arm, 1.0 / max(arm, SMALLEST)), inverse_arm)
            level_t = max(level_t, force * max(x, y) * top.weight[b, 0])
            level_r = max(level_r, force * turn * top.weight[b, 2])
    for k in range(len(top.springs)):
        a, b = top.springs[k, SPRING.first], top.springs[k, SPRING.second]
        speed = 0.0
        for i in range(3):
            speed += abs(w.grad[k, i] * v[3 * a + i]) + abs(w.grad[k, 3 + i] * v[3 * b + i])
        force = (
            abs(w.tension[k, TENSION.by_length]) * (abs(w.s[k, 0]) + abs(top.linear[k, LINEAR.free_length]))
            + abs(w.tension[k, TENSION.by_rate]) * speed
        )
        force = max(force, abs(w.tension[k, TENSION.force]))
        for side in range(2):
            body = top.springs[k, SPRING.first + side]
            for i in range(3):
                level = force * abs(w.grad[k, 3 * side + i]) * top.weight[body, i]
                if i < 2:
                    level_t = max(level_t, level)
                else:
                    level_r = max(level_r, level)
    if len(top.sections) > 0:
        beam_t, beam_r = beam_levels(top, w)
        level_t, level_r = max(level_t, beam_t), max(level_r, beam_r)
    level_r = max(level_r, level_t * inverse_arm)  # a body pinned at a point turns when the point is accelerated
    small_t = small_t | (change_t <= NEGLIGIBLE_CHANGE * level_t)
    small_r = small_r | (change_r <= NEGLIGIBLE_CHANGE * level_r)
    return small | (patient & small_t & small_r & (level_t + level_r < np.inf))


@subkernel
def report_divergence(c, iterations, change, stages):
    """Store the largest change of an acceleration, its coordinate and the iterations for `describe_divergence`."""
    c.report[0], c.report[2] = 0.0, iterations
    for i in range(stages):
        for d in range(len(c.q) - 3):
            size, largest = abs(change[i, d]), c.report[0]
            c.report[0] = where(size <= largest, largest, size)  # becomes NaN if the size is NaN
            c.report[1] = where(size <= largest, c.report[1], d)


def describe_divergence(workspace: Workspace, report: np.ndarray) -> str:
    """Return where the stage equations failed to converge, from a report (3,) of `report_divergence`."""
    if not np.isfinite(report[0]):
        return ": the stage iteration ran away"
    if report[2] == 0:
        return (
            f": the symmetric projection did not converge, its last residual was {report[0]:.3g} of the state; the "
            "bodies turn or the joints drift too far in a step; projection without `symmetric` takes larger steps"
        )
    name = workspace.mechanism.unknown_name(int(report[1]))
    unit = "rad/s^2" if int(report[1]) % 3 == 2 else "m/s^2"
    return (
        f": the stage equations did not converge in {int(report[2])} iterations, "
        f"the last one still changed an acceleration of {name} by {report[0]:.3g} {unit}"
    )
