"""Requirements on every force law: consistent derivatives, potential, passivity and energy balance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, cast

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.engine.force_laws import bind_law
from mbdkit.engine.native.calls import LAW
from mbdkit.mechanism.force_law import ExpressionLaw, FunctionLaw, TracedLaw, law_range
from mbdkit.registry.items import ForceLawPlugin
from mbdkit.runs.simulation import simulate
from mbdkit.spec.choices import law_element
from mbdkit.spec.run_spec import RunSpec
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, at_most, failed, passed, unclaimed, warned
from mbdkit_testing.integrator_under_test import require_complete
from mbdkit_testing.item_checks import ItemUnderTest
from mbdkit_testing.options_under_test import options_result, results_of_variants, validated

#: Largest length or angle, rate and time at which a law without bounds is tested [m or rad, per s, s].
FAR = 10.0
GRID = 25, 9, 4  #: Numbers of lengths, rates and times of the grid of samples.
#: Number of further random samples; half of them are close to the ends of the range, zero, or the law's parameters.
RANDOM = 8000
RANDOM_OF_VARIANTS = 2000  #: Number of random samples for each other value of an option.
#: Samples close to an end of the range, zero, or a parameter are at distances from it between 1 and ``10**-DECADES``
#: times the range.
DECADES = 7.0
#: Number of intervals of the length over which the change of the potential is compared with the force.
FINE = 4000
#: Number of samples from which a random search for a gain of energy starts, and number of rounds of the search.
CLIMBERS, ROUNDS = 16, 40
AGREE = 1e-5  #: Largest relative difference between a derivative and finite differences.
#: Smallest size of derivatives in comparisons, relative to the largest value divided by the range.
#:
#: Rounding may dominate smaller derivatives.
SMALL = 2e-4
#: Steps of the finite differences, as shares of the range of the argument.
STEPS = 1e-6, 1e-7, 1e-8, 1e-9, 1e-10
#: Relative change of a force or state, or share of a force that adds energy, that counts as rounding.
ROUNDING = 1e-9
ARGUMENTS = ("length", "rate", "time")


@dataclass
class ForceLawUnderTest(ItemUnderTest[ForceLawPlugin]):
    """A force law with options.

    Parameters
    ----------
    random
        Number of samples at random places.
    """

    random: int = field(default=RANDOM, repr=False)

    @property
    def claims(self) -> dict[str, bool]:
        """Whether the law claims a potential, and whether it claims passivity."""
        law = self.plugin.law
        return {"potential": law.potential not in (None, False), "passive": law.passive}

    @property
    def law(self) -> ExpressionLaw | FunctionLaw | TracedLaw:
        """The law."""
        return cast("ExpressionLaw | FunctionLaw | TracedLaw", self.plugin.law)

    @cached_property
    def element(self) -> Any:
        """An element of type ``law`` with these options."""
        pathway = {"type": "two-points", "bodies": ["ground", "mass"], "points": [[0.0, 0.0], [0.0, 0.0]]}
        return validated(law_element(self.item), {"law": self.item.id, "pathway": pathway, **self.options})

    @cached_property
    def compiled(self) -> tuple[object, np.ndarray]:
        """The machine code of the law and its numeric options."""
        bound, numbers = bind_law(self.law, self.element, self.item.id)
        return bound, np.array(numbers)

    @cached_property
    def span(self) -> np.ndarray:
        """(3, 2) lowest and highest length, rate and time of the tests.

        They are the valid range of the law; where it has no bound, it is limited by means of `FAR`.
        """
        found = []
        for argument, (low, high) in law_range(self.law, self.element, self.item.id).items():
            first = 0.0 if argument == "time" else -FAR
            low, high = (
                low if low > -math.inf else min(first, high - FAR),
                high if high < math.inf else max(FAR, low + FAR),
            )
            found.append((low, high))
        return np.array(found)

    def __call__(self, places: np.ndarray) -> np.ndarray:
        """Return force, derivatives with respect to length and rate, and potential (N, 4) at lengths, rates and times
        (N, 3).
        """
        return self._values(places, *self.compiled)

    def rates(self, places: np.ndarray) -> dict[str, np.ndarray]:
        """Return the rates (N,) of the first-order states at their initial values, by name; see `__call__`."""
        found = {}
        for state in self.law.states:
            bound, numbers = bind_law(state.rate, self.element, self.item.id)
            found[state.name] = self._values(places, bound, np.array(numbers))[:, 0]
        return found

    @staticmethod
    def _values(places: np.ndarray, bound: Any, numbers: np.ndarray) -> np.ndarray:
        out = np.zeros((len(places), 4))
        function = LAW(bound.address)
        given, to, width = numbers.ctypes.data, out.ctypes.data, out.strides[0]
        for row, (length, rate, time) in enumerate(places.tolist()):
            function(bound.program, length, rate, time, given, to + row * width)
        return out

    @cached_property
    def places(self) -> np.ndarray:
        """(N, 3) lengths, rates and times within the range: a grid, and random samples, which are the same in each
        call.
        """
        low, high = self.span.T
        axes = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, GRID, strict=True)]
        axes[1] = np.append(axes[1], 0.0) if low[1] <= 0.0 <= high[1] else axes[1]
        generator = np.random.default_rng(31)
        found = generator.uniform(low, high, (self.random, 3))
        for argument in range(3):
            centers = [low[argument], high[argument], 0.0, *(self.compiled[1] if argument == 0 else ())]
            near = np.array([x for x in centers if low[argument] <= x <= high[argument]])
            half = self.random // 2
            away = (high[argument] - low[argument]) * 10.0 ** -generator.uniform(0.0, DECADES, half)
            sign = generator.choice([-1.0, 1.0], half)
            rows = generator.permutation(self.random)[:half]
            found[rows, argument] = generator.choice(near, half) + sign * away
        edge = 1e-6 * (high - low)
        return np.asarray(np.clip(np.concatenate([np.array(list(product(*axes))), found]), low + edge, high - edge))

    @cached_property
    def samples(self) -> np.ndarray:
        """(N, 4) values of the law at `places`."""
        return self(self.places)

    @property
    def is_finite(self) -> bool:
        """Whether all samples are finite."""
        return bool(np.all(np.isfinite(self.samples)))


def _at(place: np.ndarray) -> str:
    return f"length {place[0]:g}, rate {place[1]:g}, time {place[2]:g}"


@check("law.options")
def options(law: ForceLawUnderTest) -> Result:
    """The law's options round-trip through JSON and have descriptions."""
    return options_result(law.plugin.options, law.options)


@check("law.finite")
def finite(law: ForceLawUnderTest) -> Result:
    """The law's values are finite and repeatable over the range of lengths, rates and times."""
    wrong = ~np.all(np.isfinite(law.samples), axis=1)
    if np.any(wrong):
        row = int(np.argmax(wrong))
        return failed(
            f"it gives {law.samples[row].tolist()} at {_at(law.places[row])}; if it does not hold there, it should "
            f"declare where it does (`valid_range`)"
        )
    changed = np.any(law.samples != law(law.places), axis=1)
    if np.any(changed):
        return failed(f"two evaluations at {_at(law.places[int(np.argmax(changed))])} differ")
    return passed(places=len(law.places))


@check("derivatives.length")
def by_length(law: ForceLawUnderTest) -> Result:
    """The law's derivative with respect to length agrees with finite differences of its force."""
    return _derivative(law, 0)


@check("derivatives.rate")
def by_rate(law: ForceLawUnderTest) -> Result:
    """The law's derivative with respect to rate agrees with finite differences of its force."""
    return _derivative(law, 1)


def _derivative(law: ForceLawUnderTest, argument: int) -> Result:
    if not law.is_finite:
        raise Skip("it does not give finite numbers")
    defects = _defects(law, law.places, argument, law.samples[:, 0], law.samples[:, 1 + argument], of=0)
    worst = int(np.argmax(defects))
    cause = f"its derivative with respect to {ARGUMENTS[argument]} differs from that of its force at"
    return at_most(AGREE, f"{cause} {_at(law.places[worst])}", difference=float(defects[worst]))


def _defects(
    law: ForceLawUnderTest, places: np.ndarray, argument: int, values: np.ndarray, given: np.ndarray, of: int
) -> np.ndarray:
    """Return the relative differences (N,) between given derivatives and the closest of several finite differences.

    Where the slope is discontinuous, the derivative of either side is correct, so that central, forward and backward
    differences are used. Where none of them agrees with the given derivative, smaller steps are tried, because the
    slope may change quickly.

    Parameters
    ----------
    argument
        Index of the argument.
    values, given
        (N,) values at `places`, and their derivatives with respect to the argument.
    of
        Index of the result of the law: 0 for the force, 3 for the potential.
    """
    width = float(np.ptp(law.span[argument]))
    smallest = SMALL * np.max(np.abs(values)) / width  # rounding may dominate smaller slopes
    size = np.maximum(np.maximum(np.abs(given), np.abs(values) / width), max(smallest, 1e-300))
    defects = np.full(len(places), np.inf)
    for step in STEPS:
        rows = np.flatnonzero(~(defects <= AGREE))
        slopes = np.array(_slopes(law, places[rows], argument, values[rows], step * width, of))
        found = np.abs(slopes - given[rows]) / size[rows]
        found[~np.isfinite(found)] = np.inf  # values may be undefined outside the range
        defects[rows] = np.minimum(defects[rows], found.min(axis=0, initial=np.inf))
    return defects


def _slopes(
    law: ForceLawUnderTest, places: np.ndarray, argument: int, values: np.ndarray, step: float, of: int
) -> list[np.ndarray]:
    """Return several finite differences, each (N,).

    They are central differences of order 2 and 4, forward and backward ones of order 2, and two that do not use the
    value at the place itself, where the function may jump.
    """
    moved = {}
    for steps in (-2, -1, 1, 2):
        there = places.copy()
        there[:, argument] += steps * step
        moved[steps] = law(there)[:, of]
    near, far = moved[1] - moved[-1], moved[2] - moved[-2]
    return [
        near / (2 * step),
        (8 * near - far) / (12 * step),
        (4 * moved[1] - moved[2] - 3 * values) / (2 * step),
        -(4 * moved[-1] - moved[-2] - 3 * values) / (2 * step),
        (moved[2] - moved[1]) / step,
        (moved[-1] - moved[-2]) / step,
    ]


@check("law.potential")
def potential(law: ForceLawUnderTest) -> Result:
    """The derivative of the law's potential is the force at rate zero, and this force does not depend on time."""
    if not law.claims["potential"]:
        raise Skip("it claims no potential")
    if not law.is_finite:
        raise Skip("it does not give finite numbers")
    at_rest, early = law.places.copy(), law.places.copy()
    at_rest[:, 1] = early[:, 1] = 0.0
    early[:, 2] = law.span[2, 0]
    values, first = law(at_rest), law(early)
    change = np.abs(values[:, 0] - first[:, 0])
    timed = change > ROUNDING * np.abs(first[:, 0]) + ROUNDING * AGREE * np.max(np.abs(first[:, 0]))
    if np.any(timed):
        place = at_rest[int(np.argmax(change))]
        return failed(f"it claims a potential, but its force at rest changes with time at {_at(place)}")
    if (jump := _jump(law)) is not None:
        return failed(f"its potential jumps at length {jump:g}")
    defects = _defects(law, early, 0, first[:, 3], first[:, 0], of=3)
    worst = int(np.argmax(defects))
    cause = f"the derivative of its potential differs from its force at length {early[worst, 0]:g}"
    return at_most(AGREE, cause, difference=float(defects[worst]))


def _jump(law: ForceLawUnderTest) -> float | None:
    """Return a length near which the potential is discontinuous: it changes by more than the force allows; or None."""
    low, high = law.span[0].tolist()
    lengths = np.linspace(low, high, 2 * FINE + 1)[1:-1]
    places = np.column_stack([lengths, np.zeros(len(lengths)), np.full(len(lengths), law.span[2, 0])])
    force, _, _, potential = law(places).T
    three = np.stack([force[:-2:2], force[1:-1:2], force[2::2]])
    h = lengths[2] - lengths[0]
    change = potential[2::2] - potential[:-2:2]
    excess = np.abs(change - h * three.mean(axis=0)) - h * np.ptp(three, axis=0)
    worst = int(np.argmax(excess))
    return float(lengths[2 * worst + 1]) if excess[worst] > AGREE * h * np.max(np.abs(force)) else None


@check("law.passivity")
def passivity(law: ForceLawUnderTest) -> Result:
    """The part of the force without a potential never adds energy, neither at samples nor at places that a random
    search finds.
    """
    if not law.claims["passive"]:
        raise Skip("it does not claim to be passive")
    if not law.is_finite:
        raise Skip("it does not give finite numbers")

    def supplied(places: np.ndarray) -> np.ndarray:
        """Return the power that the law supplies per size of the rate, as a share of the force (N,)."""
        at_rest = places * [1.0, 0.0, 1.0]
        force, stored = law(places)[:, 0], law(at_rest)[:, 0] if law.claims["potential"] else np.zeros(len(places))
        share = (stored - force) * np.sign(places[:, 1]) / np.maximum(np.abs(force) + np.abs(stored), 1e-300)
        return np.asarray(share)

    shares, place = _climb(supplied, law.places, law.span)
    return at_most(ROUNDING, f"it claims to be passive, but adds energy at {_at(place)}", share_of_force=shares)


def _climb(merit: Callable[[np.ndarray], np.ndarray], places: np.ndarray, span: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the largest value of a function that a random search finds, and its place.

    The search starts from some of the best samples among `places` (N, 3) and does not leave `span` (3, 2).
    """
    values = merit(places)
    best = np.argsort(-values)[:: max(1, len(values) // (8 * CLIMBERS))][:CLIMBERS]
    best[0] = np.argmax(values)
    here, there = values[best], places[best]
    generator = np.random.default_rng(8)
    for k in range(ROUNDS):
        reach = np.ptp(span, axis=1) * 10.0 ** (-5.0 * k / ROUNDS - 0.5)
        tried = np.clip(there + reach * generator.normal(size=there.shape), *span.T)
        found = merit(tried)
        there = np.where((found > here)[:, None], tried, there)
        here = np.fmax(found, here)
    top = int(np.argmax(here))
    return float(here[top]), there[top]


@check("law.states")
def states(law: ForceLawUnderTest) -> Result:
    """The rates of first-order states are finite over the range, and the states of a run converge with the step."""
    if not law.law.states:
        raise Skip("it has no first-order states")
    for name, rates in law.rates(law.places).items():
        wrong = ~np.isfinite(rates)
        if np.any(wrong):
            row = int(np.argmax(wrong))
            return failed(f"the rate of its state '{name}' is {rates[row]} at {_at(law.places[row])}")
    finals = []
    for step in STATE_STEPS:
        with simulate(_mass_on(law, step)) as run:
            require_complete(run, "a run with it", MbdkitError)
            finals.append([float(run.states[f"law.{state.name}"].value[-1]) for state in law.law.states])
    changes = np.abs(np.diff(np.array(finals), axis=0))
    size = np.maximum(np.max(np.abs(finals), axis=0), 1e-300)
    worst = int(np.argmax(changes[-1] / size))
    coarse, fine = (float(x) for x in changes[:, worst] / size[worst])
    if fine < ROUNDING or fine < coarse / 4:
        return passed(change=fine).within({"change": max(ROUNDING, coarse / 4)})
    name = law.law.states[worst].name
    return failed(f"its state '{name}' in a run does not converge with the step", coarse=coarse, fine=fine)


STATE_STEPS = 0.01, 0.005, 0.0025  #: Steps of the runs whose final states are compared [s].


def _mass_on(law: ForceLawUnderTest, step: float) -> RunSpec:
    """Return the spec of a run of a mass to which a force with this law is applied."""
    (low, high), (slowest, fastest), (start, _) = law.span.tolist()
    length = 0.8 if low < 0.8 - 0.1 * (high - low) and 0.8 + 0.1 * (high - low) < high else 0.5 * (low + high)
    speed = 0.9 if slowest < -0.9 and fastest > 0.9 else 0.3 * max(abs(slowest), abs(fastest))
    pathway = {"type": "coordinate", "coordinate": "x", "bodies": ["ground", "mass"]}
    model = {
        "name": "mechanism",
        "bodies": {"mass": {"mass": 20.0, "position": [length, 0.0], "velocity": [speed, 0.2]}},
        "forces": {"law": {"type": "law", "law": law.item.id, "pathway": pathway, **law.options}},
    }
    time = {"start": start, "end": start + 0.5, "step": step}
    return law.run_spec(model, {"name": "mbdkit:gauss", "stages": 2}, time)


@check("law.energy")
def energy(law: ForceLawUnderTest) -> Result:
    """The energy balance of a mass under a force with this law converges to zero with the step."""
    found = []
    for step in (0.02, 0.01, 0.005, 0.0025):
        with simulate(_mass_on(law, step)) as run:
            require_complete(run, "a run with it", MbdkitError)
            size = max(1.0, float(np.max(np.abs(run.energy.kinetic))))
            found.append(float(np.max(np.abs(run.energy.balance))) / size)
    figures = {"coarsest": found[0], "finest": found[-1]}
    if found[-1] < 1e-9 or found[-1] < found[0] / 8:
        return passed(**figures).within({"finest": max(1e-9, found[0] / 8)})
    if found[-1] < found[0] / 2:
        return warned("the energy balance converges slowly with the step; its force may not be smooth", **figures)
    return failed("the energy balance does not converge with the step", **figures)


@check("law.other-options")
def other_options(law: ForceLawUnderTest) -> Result:
    """Derivatives, potential and passivity hold for other values of each option within its bounds, too."""
    undefined = []

    def first_failure(name: str, chosen: dict[str, Any]) -> Result:
        other = ForceLawUnderTest(law.item, chosen, law.installed, RANDOM_OF_VARIANTS)
        if other.is_finite:
            results = (one.run(other) for one in (by_length, by_rate, potential, passivity))
            return next((result for result in results if result.outcome == "fail"), passed())
        undefined.append(name)
        return unclaimed()

    result = results_of_variants(law.item, law.options, first_failure)
    if undefined and result.outcome != "fail":
        return warned(f"with {listed(undefined, 'and')} its values are not finite; give the options bounds")
    return result


CHECKS = (options, finite, by_length, by_rate, potential, passivity, other_options, states, energy)
