"""The nonsmooth generalized-alpha method: order 2 without contacts, and contacts as in the method of Moreau and Jean.

A step first ignores contacts: the generalized-alpha method of Chung and Hulbert gives positions q~ and velocities v~
at its end from accelerations that satisfy the equations of motion there,

    (1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) w_1 + alpha_f w_0,    w_1 the accelerations at (t_1, q~_1, v~_1)
    v~_1 = v_0 + h ((1 - gamma) a_0 + gamma a_1)
    q~_1 = q_0 + h v_0 + h^2 ((1/2 - beta) a_0 + beta a_1)

Then the velocities are made consistent with the joints, and contacts that would overlap get impulses, which change the
velocities by dv and the positions by h dv / 2. Finally the positions are projected.

Q.-z. Chen, V. Acary, G. Virlez and O. Bruls, International Journal for Numerical Methods in Engineering 96:487-511,
2013, with the algorithmic parameters of J. Chung and G. M. Hulbert, Journal of Applied Mechanics 60:371-375, 1993.
"""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.nearest_state import nearest_velocities
from mbdkit.methods.step_methods import StepState
from mbdkit_contact.step_impulses import SmoothStep
from mbdkit_contact.time_stepping import TimeStepping
from mbdkit_contact.time_stepping_methods import GeneralizedAlpha

MOST_ITERATIONS = 20
"""Largest number of Newton iterations in a step."""
CONVERGED, STAGNANT = 1e-14, 1e-9
"""Changes of the coordinates, relative to the largest coordinate, that count as zero, and below which the iteration may
stagnate.
"""


class GeneralizedAlphaSteps(TimeStepping):
    """The nonsmooth generalized-alpha method.

    Parameters
    ----------
    spectral_radius
        Factor by which a step multiplies the amplitude of infinitely fast vibrations, from 0 to 1.
    """

    def __init__(self, spectral_radius: float):
        self.alpha_m = (2.0 * spectral_radius - 1.0) / (spectral_radius + 1.0)
        self.alpha_f = spectral_radius / (spectral_radius + 1.0)
        self.gamma = 0.5 + self.alpha_f - self.alpha_m
        self.beta = 0.25 * (self.gamma + 0.5) ** 2
        #: Share of a step by which the accelerations a are ahead of w in time; starting with a at this time gives order
        #: 2.
        self.ahead = self.alpha_m - self.alpha_f

    @classmethod
    def of(cls, method: GeneralizedAlpha) -> GeneralizedAlphaSteps:
        """Return the steps of a method as described."""
        return cls(method.spectral_radius)

    def smooth(
        self, p: EquationsOfMotion, t: float, state: StepState, h: float, accelerations: tuple[np.ndarray, ...]
    ) -> SmoothStep:
        """See `TimeStepping.smooth`; `accelerations` are a_0 and w_0."""
        q0, v0 = state.q, state.v
        w, multipliers = p.accelerations(t, q0, v0)
        a0, w0 = accelerations or (w, w)
        # derivatives with respect to w_1: of a_0 (begin), of a_1 (end), of the velocities and positions at the end
        begin, end = 0.0, (1.0 - self.alpha_f) / (1.0 - self.alpha_m)
        if not accelerations:
            begin, end = self.ahead, 1.0 + self.ahead
        to_v = h * ((1.0 - self.gamma) * begin + self.gamma * end)
        to_q = h * h * ((0.5 - self.beta) * begin + self.beta * end)
        before = np.inf
        for _ in range(MOST_ITERATIONS):
            if not accelerations:
                a0 = w0 + self.ahead * (w - w0)
            a = ((1.0 - self.alpha_f) * w + self.alpha_f * w0 - self.alpha_m * a0) / (1.0 - self.alpha_m)
            q = q0 + h * v0 + h * h * ((0.5 - self.beta) * a0 + self.beta * a)
            v = v0 + h * ((1.0 - self.gamma) * a0 + self.gamma * a)
            matrix = p.iteration_matrix(
                t + h, q, v, w, multipliers, damping=to_v, stiffness=to_q, gamma_v=-to_v, residual_q=to_q
            )
            rest = p.gamma(t + h, q, v) - p.constraint_jacobian(t + h, q) @ w if p.m else np.zeros(0)
            dw, more = matrix.solve(-p.residual(t + h, q, v, w, multipliers), rest)
            w, multipliers = w + dw, multipliers + more
            change = p.relative_change(q, to_q * dw)
            if change <= CONVERGED or (change >= 0.5 * before and change < STAGNANT):
                break
            before = change
        else:
            raise StepError("newton-failed", f"the stage equations were not solved in {MOST_ITERATIONS} iterations")
        free = nearest_velocities(p, t + h, q, v) if p.m else v
        return SmoothStep(
            free,
            multipliers,
            q0 + 0.5 * h * v0,
            lambda impulse: p.solve(t + h, q, impulse, np.zeros(p.m)),
            lambda end: q + 0.5 * h * (end - free),
            (a, w),
        )
