"""Forces of muscles in runs: laws of the length of the path and its rate, with activation and fibre length as states.

With the length L of the path, the activation a, fibres of length l at the angle alpha to the tendon, the thickness
``w = l sin(alpha)``, the normalised velocity v of the fibres (negative: shortening), and the curves f of
`mbdkit_biomech.muscles.force_curves`, the tension is

    F = max_force (a f_active(l) f_velocity(v) + f_passive(l) + damping v) cos(alpha)

With a rigid tendon, ``l cos(alpha) = L - tendon_length``. An elastic tendon is in equilibrium with the fibres, so that
the velocity of the fibres is a function of l and of the tension ``max_force f_tendon((L - l cos(alpha)) /
tendon_length)``. De Groote's force-velocity curve is ``d1 y + d4`` with ``y = arcsinh(d2 v + d3)``. The condition of
equilibrium is then

    p y + q sinh(y) = r,    p = -d1 a f_active,    q = -damping / d2,
    r = d4 a f_active + f_passive - damping d3 / d2 - f_tendon / cos(alpha)

The left side increases, so that there is one solution, even for muscles without activation. With the curves of Millard,
the condition is ``a f_active f_velocity(v) + damping v = f_tendon / cos(alpha) - f_passive``, whose left side is a
Bezier curve with the same parameter as v.

The activation a follows the excitation e with the time constants of `Activation`, blended smoothly as in F. De Groote
et al., Annals of Biomedical Engineering 44:2922-2936, 2016, equations 1 and 2. With ``f = tanh(STEEPNESS (e - a)) /
2``,

    a' = ((1/2 + f) / (rise (1/2 + 3/2 a)) + (1/2 - f) (1/2 + 3/2 a) / fall) (e - a)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.expressions.program import Program, value_of
from mbdkit.mechanism.force_law import LawState, TracedLaw
from mbdkit_biomech.muscles.bezier_curve import Traced
from mbdkit_biomech.muscles.force_curves import CURVES, DeGrooteFregly, ForceCurves, Millard
from mbdkit_biomech.muscles.muscle import Activation, Muscle

#: Steepness of the transition between rising and falling activation.
#:
#: With 0.1, which is also in use, the two time constants would hardly differ; 10 is the default of SymPy
#: (`sympy.physics.biomechanics`).
STEEPNESS = 10.0

#: Number of Halley iterations in `solved`: four are exact to rounding errors, and one more makes the derivatives
#: exact.
ITERATIONS = 5

LAW_ID = "mbdkit:muscle"

Parameters = Mapping[str, Traced]


def activation_rate(excitation: Traced, p: Parameters) -> Traced:
    """Return the derivative of the activation with respect to time."""
    a = p["activation"]
    slowing = 0.5 + 1.5 * a
    f = 0.5 * elementary.tanh(STEEPNESS * (excitation - a))
    return ((0.5 + f) / (p["rise"] * slowing) + (0.5 - f) * slowing / p["fall"]) * (excitation - a)


def activation_rate_text(times: Activation, excitation: str, activation: str) -> str:
    """Return the rate of the activation as an expression of the state; excitation and activation are given as
    expressions.
    """
    gap, slowing = f"(({excitation}) - {activation})", f"(0.5 + 1.5*{activation})"
    f = f"0.5*tanh({STEEPNESS}*{gap})"
    return f"((0.5 + {f})/({times.rise!r}*{slowing}) + (0.5 - {f})*{slowing}/{times.fall!r})*{gap}"


def _value(curves: ForceCurves, name: Literal["active", "passive", "velocity", "tendon"], x: Traced) -> Traced:
    """Return values of a curve, computed by operations that can be traced."""
    return curves.curves[name].value(x) if isinstance(curves, Millard) else getattr(curves, name)(x)[0]


def rigid_tension(length: Traced, rate: Traced, p: Parameters, curves: ForceCurves) -> Traced:
    """Return the tension of a muscle with a rigid tendon."""
    along = length - p["tendon_length"]
    fiber = np.sqrt(along * along + p["thickness"] * p["thickness"])
    cosine = along / fiber
    velocity = rate * cosine / p["max_speed"]
    normal = fiber / p["optimal_length"]
    active = p["activation"] * _value(curves, "active", normal) * _value(curves, "velocity", velocity)
    return p["max_force"] * (active + _value(curves, "passive", normal) + p["damping"] * velocity) * cosine


def elastic_tension(length: Traced, p: Parameters, curves: ForceCurves) -> Traced:
    """Return the tension of an elastic tendon."""
    return p["max_force"] * _value(curves, "tendon", (length - _along(p)) / p["tendon_length"])


def fiber_pull(velocity: Traced, p: Parameters, curves: ForceCurves) -> Traced:
    """Return the force of fibres along an elastic tendon, as a share of `max_force`, at a normalised velocity."""
    normal = p["fiber_length"] / p["optimal_length"]
    active = p["activation"] * _value(curves, "active", normal) * _value(curves, "velocity", velocity)
    pull = active + _value(curves, "passive", normal) + p["damping"] * velocity
    return pull * _along(p) / p["fiber_length"]


def tendon_gap(length: Traced, force: Traced, p: Parameters, curves: ForceCurves) -> Traced:
    """Return zero if the tendon exerts a force, a share of `max_force`, where the fibres leave room for it.

    With De Groote's curves, lengths are compared and not forces, which would grow by factors of 10 with each 6 % of
    strain.
    """
    stretch = (length - _along(p)) / p["tendon_length"]
    if isinstance(curves, Millard):
        return force - _value(curves, "tendon", stretch)
    return stretch - curves.stretch(force)[0]


def _along(p: Parameters) -> Traced:
    """Return the length of the fibres along the tendon; nan if they are shorter than the thickness of the muscle."""
    fiber, thickness = p["fiber_length"], p["thickness"]
    return np.where(fiber > thickness, np.sqrt(fiber * fiber - thickness * thickness), np.nan)


def fiber_rate(length: Traced, p: Parameters, curves: ForceCurves) -> Traced:
    """Return the rate of the length of fibres in equilibrium with an elastic tendon."""
    along, fiber = _along(p), p["fiber_length"]
    normal = fiber / p["optimal_length"]
    active = p["activation"] * _value(curves, "active", normal)
    tendon = _value(curves, "tendon", (length - along) / p["tendon_length"])
    wanted = tendon * fiber / along - _value(curves, "passive", normal)
    if isinstance(curves, Millard):
        velocity = curves.curves["velocity"].x_where(active, p["damping"], wanted)
    else:
        d1, d2, d3, d4 = DeGrooteFregly.VELOCITY
        q = p["damping"] / -d2
        velocity = (elementary.sinh(solved(-d1 * active, q, d4 * active + q * d3 - wanted)) - d3) / d2
    return p["max_speed"] * velocity


def solved(p: Traced, q: Traced, r: Traced) -> Traced:
    """Return the solution y of ``p y + q sinh(y) = r``, where p and q are not negative and one of them is positive.

    Halley's method starts from the smaller of two upper bounds of abs(y). The solution is less than 1 away from there,
    and sinh bends little in between.
    """
    size = np.where(r < 0.0, -r, r)
    steep = size / (q + TINY)
    first, second = size / (p + q), elementary.log(steep + np.sqrt(steep * steep + 1.0))
    bound = np.where(first < second, first, second)
    y = np.where(r < 0.0, -bound, bound)
    for _ in range(ITERATIONS):
        s, c = elementary.sinh(y), elementary.cosh(y)
        gap, slope = p * y + q * s - r, p + q * c
        y = y - 2.0 * gap * slope / (2.0 * slope * slope - gap * q * s)
    return y


TINY = 1e-100  #: Added to divisors that may be 0; it does not change other divisors.


class TableForm(NamedTuple):
    """A table of an excitation without its numbers.

    The number of pieces, the number of terms of each piece, and whether the table repeats.
    """

    pieces: int
    terms: int
    is_periodic: bool


#: Form of an excitation that is a function of time; empty for other excitations.
#:
#: The form does not contain the numbers in the excitation, which are parameters of the law.
Form = Program | TableForm

#: Largest number of numbers in an excitation, by the curves of the muscle.
#:
#: It is limited because programs of laws have `mbdkit.engine.kernels.law_programs.REGISTERS` registers.
MOST_NUMBERS: Mapping[str, int] = {"de-groote-fregly": 440, "millard": 360}


def excitation_of(form: Form, time: Traced, numbers: Sequence[Traced]) -> Traced:
    """Return an excitation at a time.

    Parameters
    ----------
    numbers
        The constants of a program in order. For a table, the ends of its pieces, followed by the coefficients of each
        piece in descending powers.
    """
    if isinstance(form, TableForm):
        return _of_table(form, time, numbers)
    constants = iter(numbers)
    return value_of(form, lambda operation, number: next(constants) if operation == "const" else time)


def _of_table(form: TableForm, time: Traced, numbers: Sequence[Traced]) -> Traced:
    ends, terms = numbers[: form.pieces + 1], form.terms
    if form.is_periodic:
        period = ends[-1] - ends[0]
        time = time - period * np.floor((time - ends[0]) / period)
    own = [ends[0], *numbers[form.pieces + 1 : form.pieces + 1 + terms]]
    for piece in range(1, form.pieces):
        first = form.pieces + 1 + piece * terms
        following = [ends[piece], *numbers[first : first + terms]]
        own = [np.where(time >= ends[piece], x, old) for x, old in zip(following, own, strict=True)]
    value = own[1]
    for coefficient in own[2:]:
        value = value * (time - own[0]) + coefficient
    return value


@lru_cache(maxsize=256)
def muscle_law(tendon: str, curves: str, form: Form) -> TracedLaw:
    """Return the law of a muscle with a rigid or an elastic tendon and one of the `CURVES`.

    If the excitation is not a function of time, the law returns 0 as the rate of the activation, which is computed
    elsewhere.
    """
    if isinstance(form, TableForm):
        count = form.pieces + 1 + form.pieces * form.terms
    else:
        count = sum(name == "const" for name, _ in form)

    def activation(length: Traced, rate: Traced, time: Traced, p: Parameters) -> Traced:
        if not form:
            return 0.0 * p["activation"]
        return activation_rate(excitation_of(form, time, [p[f"number_{i}"] for i in range(count)]), p)

    curve = CURVES[curves]
    states = [LawState("activation", TracedLaw(activation, _parameters, has_derivatives=False), "1")]
    if tendon == "rigid":
        return TracedLaw(
            lambda length, rate, time, p: rigid_tension(length, rate, p, curve),
            _parameters,
            tuple(states),
            valid_range=lambda force: {"length": (force.muscle.tendon_length, np.inf)},
        )
    rate_law = TracedLaw(lambda length, rate, time, p: fiber_rate(length, p, curve), _parameters, has_derivatives=False)
    states.append(LawState("fiber_length", rate_law, "m"))
    return TracedLaw(lambda length, rate, time, p: elastic_tension(length, p, curve), _parameters, tuple(states))


def _parameters(force: Traced) -> dict[str, float]:
    """Return the parameters of the law of a `MuscleForce`."""
    muscle: Muscle = force.muscle
    numbers = {f"number_{i}": number for i, number in enumerate(force.numbers)}
    elastic = {"fiber_length": muscle.optimal_length} if muscle.tendon == "elastic" else {}
    return {
        "activation": muscle.activation.initial,
        "rise": muscle.activation.rise,
        "fall": muscle.activation.fall,
        "max_force": muscle.max_force,
        "optimal_length": muscle.optimal_length,
        "tendon_length": muscle.tendon_length,
        "thickness": muscle.thickness,
        "max_speed": muscle.max_velocity * muscle.optimal_length,
        "damping": muscle.damping,
        **numbers,
        **elastic,
    }
