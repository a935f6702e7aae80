"""Requirements on every force law: consistent derivatives, potential, passivity and energy balance."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.engine.jit.law_compiler import bind_law
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.items import ForceLawPlugin
from mbdkit.runs.simulation import simulate
from mbdkit.spec.choices import law_element
from mbdkit.spec.run_spec import spec_type
from mbdkit.testing.check import Skip, check
from mbdkit.testing.check_result import Result, failed, passed, warned
from mbdkit.testing.options_under_test import options_result, validated, variants

LENGTHS = tuple(np.linspace(0.15, 2.05, 39))
RATES = (-3.0, -1.0, -0.1, 0.0, 0.1, 1.0, 3.0)
TIMES = (0.0, 0.3, 1.7)
AGREE = 1e-5
"""Largest relative difference between a derivative and finite differences."""
SMALL = 1e-5
"""Step of the finite differences [m, m/s]."""


@dataclass
class ForceLawUnderTest:
    """A force law with options.

    Parameters
    ----------
    options
        Its options, as in an element of type ``law``.
    """

    item: Registered
    options: dict[str, Any]
    installed: Registry
    _bound: Any = field(default=None, repr=False)

    @property
    def plugin(self) -> ForceLawPlugin:
        """The plugin item."""
        plugin = self.item.plugin
        assert isinstance(plugin, ForceLawPlugin)
        return plugin

    @property
    def claims(self) -> dict[str, bool]:
        """Whether it claims a potential and passivity."""
        law = self.plugin.law
        return {"potential": law.potential not in (None, False), "passive": law.passive}

    @cached_property
    def compiled(self) -> tuple[Any, np.ndarray]:
        """The machine code of the law and its numeric options."""
        pathway = {"type": "two-points", "bodies": ["ground", "mass"], "points": [[0.0, 0.0], [0.0, 0.0]]}
        element = validated(law_element(self.item), {"law": self.item.id, "pathway": pathway, **self.options})
        bound, numbers = bind_law(self.plugin.law, element, self.item.id)
        return bound, np.array(numbers)

    def __call__(self, length: float, rate: float, time: float) -> np.ndarray:
        """Return force, derivatives by length and rate, and potential."""
        bound, numbers = self.compiled
        out = np.zeros(4)
        real = ctypes.POINTER(ctypes.c_double)
        function = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.c_double, real, real)(bound.address)
        function(length, rate, time, numbers.ctypes.data_as(real), out.ctypes.data_as(real))
        return out

    @cached_property
    def samples(self) -> dict[tuple[float, float, float], np.ndarray]:
        """Values of the law over the range of lengths, rates and times."""
        return {at: self(*at) for at in product(LENGTHS, RATES, TIMES)}

    @property
    def scale(self) -> float:
        """The largest force in the range, at least 1 N."""
        return max(1.0, max(abs(float(value[0])) for value in self.samples.values()))


@check("law.options")
def options(law: ForceLawUnderTest) -> Result:
    """Its options round-trip through JSON and have descriptions."""
    return options_result(law.plugin.options, law.options)


@check("law.finite")
def finite(law: ForceLawUnderTest) -> Result:
    """Its values are finite and repeatable over the range of lengths, rates and times."""
    for at, value in law.samples.items():
        if not np.all(np.isfinite(value)):
            return failed(f"it gives {value.tolist()} at length {at[0]:g}, rate {at[1]:g}, time {at[2]:g}")
        if not np.array_equal(value, law(*at)):
            return failed(f"two evaluations at length {at[0]:g}, rate {at[1]:g}, time {at[2]:g} differ")
    return passed(places=len(law.samples))


@check("derivatives.length")
def by_length(law: ForceLawUnderTest) -> Result:
    """Its derivative by length agrees with finite differences of its force."""
    return _derivative(law, 0)


@check("derivatives.rate")
def by_rate(law: ForceLawUnderTest) -> Result:
    """Its derivative by rate agrees with finite differences of its force."""
    return _derivative(law, 1)


def _derivative(law: ForceLawUnderTest, argument: int) -> Result:
    """Compare with the closest of one-sided and central differences: where the slope is discontinuous, either one is
    correct.
    """
    worst, where = 0.0, (0.0, 0.0, 0.0)
    for at, value in law.samples.items():
        if not np.all(np.isfinite(value)):
            raise Skip("it does not give finite numbers")
        defect = min(abs(slope - value[1 + argument]) for slope in _slopes(law, at, argument, 0))
        size = max(law.scale, abs(float(value[1 + argument])))
        if defect / size > worst:
            worst, where = float(defect / size), at
    name = ("length", "rate")[argument]
    if worst > AGREE:
        return failed(
            f"its derivative by {name} differs from that of its force at length {where[0]:g}, rate {where[1]:g}, "
            f"time {where[2]:g}",
            difference=worst,
        )
    return passed(difference=worst).within({"difference": AGREE})


def _slopes(law: ForceLawUnderTest, at: tuple[float, float, float], argument: int, of: int) -> Iterator[float]:
    """Yield central, forward and backward second-order differences of a result of the law by an argument."""

    def value(steps: int) -> float:
        moved = list(at)
        moved[argument] += steps * SMALL
        return float(law(*moved)[of])

    here, ahead, behind = value(0), (value(1), value(2)), (value(-1), value(-2))
    yield (ahead[0] - behind[0]) / (2 * SMALL)
    yield (4 * ahead[0] - ahead[1] - 3 * here) / (2 * SMALL)
    yield -(4 * behind[0] - behind[1] - 3 * here) / (2 * SMALL)


@check("law.potential")
def potential(law: ForceLawUnderTest) -> Result:
    """The derivative of its potential is its force at rate zero, which does not depend on time."""
    if not law.claims["potential"]:
        raise Skip("it claims no potential")
    worst, where = 0.0, 0.0
    for length in LENGTHS:
        forces = [float(law(length, 0.0, time)[0]) for time in TIMES]
        if np.ptp(forces) > AGREE * law.scale:
            return failed(f"it claims a potential, but its force at rest changes with time at length {length:g}")
        defect = min(abs(slope - forces[0]) for slope in _slopes(law, (length, 0.0, 0.0), 0, 3)) / law.scale
        if defect > worst:
            worst, where = defect, length
    if worst > AGREE:
        return failed(f"the derivative of its potential differs from its force at length {where:g}", difference=worst)
    return passed(difference=worst).within({"difference": AGREE})


@check("law.passivity")
def passivity(law: ForceLawUnderTest) -> Result:
    """The part of its force without potential never adds energy to the motion."""
    if not law.claims["passive"]:
        raise Skip("it does not claim to be passive")
    stores = law.claims["potential"]
    worst, where = 0.0, (0.0, 0.0, 0.0)
    for at, value in law.samples.items():
        stored = float(law(at[0], 0.0, at[2])[0]) if stores else 0.0
        given = -(float(value[0]) - stored) * at[1] / law.scale
        if given > worst:
            worst, where = given, at
    if worst > AGREE:
        return failed(
            f"it claims to be passive, but adds energy at length {where[0]:g}, rate {where[1]:g}, time {where[2]:g}",
            power=worst * law.scale,
        )
    return passed(power=worst * law.scale).within({"power": AGREE * law.scale})


@check("law.energy")
def energy(law: ForceLawUnderTest) -> Result:
    """The energy balance of a mass on it converges to zero with the step."""
    spec = spec_type(law.installed)
    pathway = {"type": "two-points", "bodies": ["ground", "mass"], "points": [[0.0, 0.0], [0.0, 0.0]]}
    model = {
        "name": "mechanism",
        "bodies": {"mass": {"mass": 20.0, "position": [0.8, 0.1], "velocity": [0.2, 0.9]}},
        "forces": {"law": {"type": "law", "law": law.item.id, "pathway": pathway, **law.options}},
    }
    found = []
    for step in (0.02, 0.01, 0.005, 0.0025):
        data: dict[str, Any] = {
            "mbdkit": 1,
            "model": model,
            "integrator": {"name": "mbdkit:gauss", "stages": 2},
            "time": {"end": 0.5, "step": step},
            "limits": {"wall_time": 40},
        }
        given = spec(**data)
        with simulate(given, notify=lambda message: None) as run:
            if run.status != "complete":
                return failed(f"a run with it did not complete: {run.status_reason}".rstrip("."))
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
    tried, undefined = 0, []
    for name, chosen in variants(law.item, law.options):
        other = ForceLawUnderTest(law.item, chosen, law.installed)
        try:
            if not all(np.all(np.isfinite(value)) for value in other.samples.values()):
                undefined.append(name)
                continue
        except SpecError:  # values that the law refuses
            continue
        tried += 1
        for one in (by_length, by_rate, potential, passivity):
            result = one.run(other)
            if result.outcome == "fail":
                return failed(f"with {name}: {result.cause}; if that is not meant, give the option bounds")
    if undefined:
        return warned(f"with {listed(undefined, 'and')} its values are not finite; give the options bounds")
    if not tried:
        raise Skip("none of its options has another value to try")
    return passed(variants=tried)


CHECKS = (options, finite, by_length, by_rate, potential, passivity, other_options, energy)
