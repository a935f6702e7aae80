"""Control of the step size by an estimate of the local error: proportional-integral control as in DOPRI5.

The error e of a step is the estimate over the tolerance, as a root mean square over all coordinates and velocities. A
step with e <= 1 is accepted. The size of the next step is then

    h_new = h S e_n^(-(1/k - 0.75 beta)) e_(n-1)^beta

where k is the order of the estimate in h, S a safety factor, and e_(n-1) the error of the previous accepted step. With
beta = 0 this is the elementary controller (Hairer, Norsett and Wanner 1993, II.4, equation 4.13); beta > 0 makes it a
proportional-integral controller (Gustafsson 1991, ACM TOMS 17, 533-554; Hairer and Wanner 1996, IV.2), which damps the
oscillations of the step size at the limit of stability of an explicit method. The factor 0.75 is that of DOPRI5
(``EXPO1``); DOP853 has 0.2 there, but beta = 0 by default. RADAU5 and SciPy's Radau use Gustafsson's predictive
controller instead, which also takes the sizes of the last two steps into account.

Any other controller is a digital filter with up to five coefficients (Soderlind 2003, ACM TOMS 29, 1-26), a
`mbdkit.methods.step_filter.StepFilter`:

    h_new = h (s/e_n)^(b1/k) (s/e_(n-1))^(b2/k) (s/e_(n-2))^(b3/k) (h/h_(n-1))^(-a2) (h_(n-1)/h_(n-2))^(-a3)

Here, s = S^k is the error at which the steps remain the same; a factor S of h_new, as above, would move this error to
S^(k/(b1 + b2 + b3)), which is 0.009 for H321 of order 5. The kernels read the coefficients as one row of numbers, so
that a controller of a plugin needs no code of its own.

The compiled functions accept numbers and lanes (`mbdkit_builder.lane_types`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.kernels.elementary.exponentials import exp
from mbdkit.engine.kernels.elementary.logarithms import log
from mbdkit.engine.kernels.observe import first_order_rates
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import subkernel

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace
    from mbdkit.methods.step_filter import StepFilter

SAFETY = 0.9  #: Safety factor S of a new step size: the default of DOPRI5, DOP853 and RADAU5 (``SAFE``), and of SciPy.

#: Bounds on h_new / h: the lower one of DOPRI5 (and SciPy), the upper one of DOP853.
#:
#: Other methods allow steps to grow by 8 (RADAU5) or 10 (DOPRI5, SciPy).
MIN_FACTOR, MAX_FACTOR = 0.2, 6.0

#: h_new / h after a step whose equations could not be solved, as in CVODE (Hindmarsh et al. 2005, ``ETACF``).
#:
#: RADAU5 and SciPy's Radau use 0.5.
SOLVER_FAILURE_FACTOR = 0.25

MIN_LAST_ERROR = 1e-4  #: Lower bound of e_(n-1) (DOPRI5, ``FACOLD``): one very accurate step must not shorten the next.

INTEGRAL_SHARE = 0.75  #: Reduction of the exponent of e_n per beta (DOPRI5, ``EXPO1``; DOP853 has 0.2).

#: Weight of the square of the second estimate in the error of DOP853 (Hairer, Norsett and Wanner 1993, II.10).
ROUGH_WEIGHT = 0.01

#: A step that would end within 1 % of its size before the end of the run is extended to the end (DOPRI5, DOP853).
END_MARGIN = 1.01


@dataclass(frozen=True)
class Control:
    """Tolerances and parameters of step-size control.

    The estimate of an implicit method has a lower order than the method. Keeping the estimate below the user's
    tolerance itself would make the error of the run proportional to a power of the tolerance. The estimate is compared
    with ``scale tolerance^(estimate_order / order)``, which makes the error proportional to the tolerance.

    Parameters
    ----------
    rtol, atol
        Tolerances given by the user: relative, and absolute [m, rad, m/s, rad/s].
    order
        Order of the method.
    estimate_order
        Order k of the estimate of the local error in the step size.
    estimates
        1, or 2 if a second estimate of lower order corrects the first (DOP853).
    scale
        Factor of the tolerance of the estimate.
    memory
        beta k, the influence of the previous error on the choice of a step. 0.2 avoids oscillations of the step size if
        stability limits the steps of an explicit method (DOPRI5). Implicit methods have no such limit; with 0, their
        errors follow the tolerance best.
    max_step
        Largest step [s]; a step that reaches a stop or the end of the run may be 1 % longer.
    length
        Unit of lengths [m] in which `atol` applies to positions and velocities, but not to angles and their rates.
    filter
        Coefficients of another controller, which takes the place of `memory`; None for the default controller.
    """

    rtol: float = 1e-6
    atol: float = 1e-8
    order: float = 1.0
    estimate_order: float = 1.0
    estimates: int = 1
    scale: float = 1.0
    memory: float = 0.0
    max_step: float = math.inf
    length: float = 1.0
    filter: StepFilter | None = None

    @property
    def inner_rtol(self) -> float:
        """Relative tolerance of the estimate."""
        return float(self.scale * elementary.pow(self.rtol, self.estimate_order / self.order))

    @property
    def inner_atol(self) -> float:
        """Absolute tolerance of the estimate; its ratio to `inner_rtol` is the user's."""
        return self.inner_rtol * self.atol / self.rtol

    @property
    def lengths(self) -> np.ndarray:
        """(3,) units of the coordinates x, y and the angle of a body, in which `atol` applies."""
        return np.array([self.length, self.length, 1.0])

    @property
    def iteration_tolerance(self) -> float:
        """Relative change of accelerations at which the iteration of an implicit method ends; chosen.

        It keeps the error of the iteration a thousand times below that of the step. RADAU5 and SciPy's Radau end it
        earlier, at min(0.03, rtol^0.5) of the tolerance.
        """
        return min(1e-3 * self.rtol, 1e-8)


class ControlData(NamedTuple):
    """Step-size control as the kernels read it; arrays without a shape have one element."""

    controlled: np.ndarray  #: Whether the error controls the step size; otherwise, the other fields are not used.
    rtol: np.ndarray  #: Relative tolerance of the estimate.
    atol: np.ndarray  #: (3,) absolute tolerances of the estimate for x, y and the angle of a body.
    exponent: np.ndarray  #: 1 / k.
    safety: np.ndarray  #: Safety factor of a size that follows from the last error alone.
    limits: np.ndarray  #: (2,) bounds on h_new / h.
    alone: np.ndarray  #: Power of e_n in h_new / h as long as there are too few earlier errors.
    gain: np.ndarray  #: Factor of h_new / h besides the powers below.
    powers: np.ndarray  #: (5,) powers of e_n, e_(n-1), e_(n-2), h / h_(n-1) and h_(n-1) / h_(n-2) in h_new / h.
    #: Number of errors that the controller needs: 2 or 3; negative if it does not use sizes of steps before the last
    #: one, so that only the first two powers are not 0.
    reach: np.ndarray
    estimates: np.ndarray  #: Number of estimates of the error, 1 or 2.
    min_size: np.ndarray  #: Smallest and largest step size [s].
    max_size: np.ndarray


def control_data(control: Control | None, min_size: float) -> ControlData:
    """Return the data of step-size control for the kernels; `control` is None for fixed steps."""
    c = control or Control()
    exponent, beta, chosen = 1.0 / c.estimate_order, c.memory / c.estimate_order, c.filter
    if chosen is None:
        alone, safety, gain, limits = -(exponent - INTEGRAL_SHARE * beta), SAFETY, SAFETY, (MIN_FACTOR, MAX_FACTOR)
        powers, reach = [alone, beta, 0.0, 0.0, 0.0], -2
    else:
        alone, safety, limits = -exponent, chosen.safety, chosen.limits
        gain = elementary.pow(safety, sum(chosen.errors))
        powers = [*(-weight * exponent for weight in chosen.errors), *(-weight for weight in chosen.ratios)]
        reach = 3 if powers[2] or powers[4] else 2 if powers[3] else -2
    return ControlData(
        controlled=np.array([int(control is not None)]),
        rtol=np.array([c.inner_rtol]),
        atol=c.inner_atol * c.lengths,
        exponent=np.array([exponent]),
        safety=np.array([safety]),
        limits=np.array(limits),
        alone=np.array([alone]),
        gain=np.array([gain]),
        powers=np.array(powers),
        reach=np.array([reach]),
        estimates=np.array([c.estimates]),
        min_size=np.array([min_size], dtype=np.float64),
        max_size=np.array([c.max_step], dtype=np.float64),
    )


def unit_of_length(by_size: bool, mechanism: CompiledMechanism) -> float:
    """Return the unit of length [m] in which an absolute tolerance applies; 1 for one given by the user.

    For the default tolerance, it is the characteristic length of the mechanism, but at most 1 m: a tolerance of 1e-6 m
    would allow any error in a mechanism of the size of micrometres. The tolerance of velocities is in this unit per
    second, so that a mechanism described in another unit of length takes the same steps.
    """
    return min(1.0, mechanism.length) if by_size else 1.0


@subkernel
def scaled_norm(control, error_q, error_v, error_z, c):
    """Return the root mean square of errors over ``atol + rtol |y|``, y the larger of both ends of the step.

    Estimates of the errors of positions, velocities and first-order states are given; `c` is the run. The absolute
    tolerance of angles applies to the states.
    """
    rtol = control.rtol[0]
    q, v, z, dq, dv, dz = c.from_q, c.from_v, c.from_z, c.dq, c.dv, c.dz
    total = 0.0
    n = len(q) - 3
    for d in range(n):
        atol = control.atol[d % 3]
        scale_q = atol + rtol * max(abs(q[d]), abs(q[d] + dq[d]))
        scale_v = atol + rtol * max(abs(v[d]), abs(v[d] + dv[d]))
        ratio_q, ratio_v = error_q[d] / scale_q, error_v[d] / scale_v
        total += ratio_q * ratio_q + ratio_v * ratio_v
    for d in range(len(z)):
        ratio = error_z[d] / (control.atol[2] + rtol * max(abs(z[d]), abs(z[d] + dz[d])))
        total += ratio * ratio
    return np.sqrt(total / (2 * n + len(z)))


@subkernel
def combined_error(fine, rough):
    """Return the error from two estimates of different order, as in DOP853."""
    return where(fine > 0.0, fine * fine / np.sqrt(fine * fine + ROUGH_WEIGHT * rough * rough), fine)


@subkernel
def local_error(control, estimates, c):
    """Return the local error over the tolerance, from one or two estimates of it, for the step of the run `c`."""
    error = scaled_norm(control, estimates.est_q, estimates.est_v, estimates.est_z, c)
    if control.estimates[0] == 2:
        rough = scaled_norm(control, estimates.second_q, estimates.second_v, estimates.second_z, c)
        error = combined_error(error, rough)
    return error


@subkernel
def fitted_size(t, h, end):
    """Return the size `h` of a step from `t`, changed so that the steps end at `end` and the last is not too short.

    If two steps are left, they are made equal, so that the last one is not a tiny remainder.
    """
    return where(t + END_MARGIN * h >= end, end - t, where(t + 2.0 * h > end, 0.5 * (end - t), h))


@subkernel
def is_too_small(control, t, h, end):
    """Return whether the step size is at or below its lower limit; the last step of a run is never too small."""
    return (not h > control.min_size[0]) & (t + END_MARGIN * h < end)


@subkernel
def _power(x, y):
    """Return x^y up to a few rounding errors, in a third of the time of the exact power; NaN for 0^0."""
    return exp(y * log(x))


@subkernel
def factor_after_acceptance(control, h, error, past):
    """Return h_new / h after an accepted step of size `h`.

    `past` has the errors and sizes of the steps before, as `mbdkit.integrators.run.run_state.Progress`; an error is 0
    if there is no such step, or if it says nothing about the next one. After a rejection (``retrying``) the size must
    not grow.
    """
    last_error, earlier_error = past.last_error[0], past.earlier_error[0]
    is_known = last_error > 0.0
    if control.reach[0] > 2:
        is_known = earlier_error > 0.0
    factor = where(is_known, control.gain[0], control.safety[0])
    factor = factor * _power(error, where(is_known, control.powers[0], control.alone[0]))
    factor = where(is_known, factor * _power(last_error, control.powers[1]), factor)
    if control.reach[0] > 0:
        last_size = where(is_known, past.last_size[0], h)
        ratio = _power(h / last_size, control.powers[3])
        if control.reach[0] > 2:
            ratio = ratio * _power(earlier_error, control.powers[2])
            ratio = ratio * _power(last_size / where(is_known, past.earlier_size[0], h), control.powers[4])
        factor = where(is_known, factor * ratio, factor)
    least, most = control.limits[0], control.limits[1]
    factor = min(most, max(least, where(error > 0.0, factor, most)))
    return where(past.retrying[0] != 0, min(1.0, factor), factor)


@subkernel
def factor_after_rejection(control, solved, error):
    """Return h_new / h after a rejected step, by the error alone; `solved` is false if the error is unknown because the
    equations could not be solved.
    """
    factor = max(control.limits[0], control.safety[0] * _power(error, -control.exponent[0]))
    return where(solved & (error < np.inf), factor, SOLVER_FAILURE_FACTOR)


def first_step(workspace: Workspace, span: float, control: Control, z: np.ndarray | None = None) -> float:
    """Return a small first step from the start of a workspace in a run of length `span` [s]; see `first_size`.

    `z`: (Z,) first-order states at the start; by default, the initial ones of the mechanism.
    """
    z = workspace.mechanism.initial_states if z is None else z
    n3 = 3 * len(workspace.mechanism.bodies)
    y = np.concatenate([workspace.q0[:n3], workspace.v0[:n3], np.zeros(2), z])
    rates = np.zeros_like(y)
    acc, lam = np.zeros((3, workspace.mechanism.size)), np.zeros((len(workspace.stepping_topology.pairs), 2))
    first_order_rates(workspace.stepping_engine, False, workspace.t0, y, acc, lam, rates)
    return first_size(y[: 2 * n3], rates[: 2 * n3], span, control)


def first_size(y: np.ndarray, rates: np.ndarray, span: float, control: Control) -> float:
    """Return a small first step [s] (Hairer, Norsett and Wanner 1993, II.4, steps a and b of the algorithm).

    Parameters
    ----------
    y
        (6 B,) positions and velocities at the start.
    rates
        (6 B,) their derivatives.
    span
        Length of the run [s].
    control
        Tolerances.
    """
    scale = control.atol * np.tile(control.lengths, len(y) // 3) + control.rtol * np.abs(y)
    d0, d1 = (float(np.sqrt(np.mean((x / scale) ** 2))) for x in (y, rates))
    guess = 0.01 * d0 / d1 if d0 > 1e-5 and 1e-5 < d1 < np.inf else 1e-6
    return float(min(guess, 0.01 * span))
