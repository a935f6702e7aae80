"""What every force law owes: derivatives, potential and passivity that agree with it, and energy that adds up."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from mbdkit.engine.jit.law_compiler import bind_law
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.items import ForceLawPlugin
from mbdkit.simulation import simulate
from mbdkit.spec.law_options import law_element
from mbdkit.spec.run_spec import spec_type
from mbdkit.testing.check import Skip, check
from mbdkit.testing.options_under_test import validated
from mbdkit.testing.outcome import Finding, failed, passed, warned
from mbdkit.text import listed

LENGTHS = tuple(np.linspace(0.15, 2.05, 39))
RATES = (-3.0, -1.0, -0.1, 0.0, 0.1, 1.0, 3.0)
TIMES = (0.0, 0.3, 1.7)
AGREE = 1e-5
"""Share of its size by which a derivative may differ from differences."""
SMALL = 1e-5
"""Difference [m, m/s] by which derivatives are taken."""


@dataclass
class LawSubject:
    """A force law with options, ready to be tried.

    Parameters
    ----------
    item
        The law in the registry.
    options
        Its options as an element of type ``law`` would give them.
    installed
        The registry in which specs look it up.
    """

    item: Registered
    options: dict[str, Any]
    installed: Registry
    _bound: Any = field(default=None, repr=False)

    @property
    def plugin(self) -> ForceLawPlugin:
        """The law as its plugin registered it."""
        plugin = self.item.plugin
        assert isinstance(plugin, ForceLawPlugin)
        return plugin

    @property
    def claims(self) -> dict[str, bool]:
        """Whether it says that it has a potential, and that it is passive."""
        law = self.plugin.law
        return {"potential": law.potential not in (None, False), "passive": law.passive}

    @cached_property
    def compiled(self) -> tuple[Any, np.ndarray]:
        """The machine code of the law and what it reads."""
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
        """The law over the range of lengths, rates and times."""
        return {at: self(*at) for at in product(LENGTHS, RATES, TIMES)}

    @property
    def scale(self) -> float:
        """The largest force in the range, 1 N at least."""
        return max(1.0, max(abs(float(value[0])) for value in self.samples.values()))


@check("law.options")
def options(subject: LawSubject) -> Finding:
    """Its options survive the way to JSON and back, and each says what it is."""
    model = subject.plugin.options
    chosen = validated(model, subject.options)
    if model.model_validate_json(chosen.model_dump_json()) != chosen:
        return failed("its options come back from JSON changed")
    described = model.model_json_schema().get("properties", {})
    if silent := [name for name, info in described.items() if not info.get("description")]:
        return warned(f"{listed(silent, 'and')} have no description: write a docstring below each option")
    return passed(options=len(described))


@check("law.finite")
def finite(subject: LawSubject) -> Finding:
    """It gives four finite numbers at every length, rate and time of the range, and the same ones again."""
    for at, value in subject.samples.items():
        if not np.all(np.isfinite(value)):
            return failed(f"it gives {value.tolist()} at length {at[0]:g}, rate {at[1]:g}, time {at[2]:g}")
        if not np.array_equal(value, subject(*at)):
            return failed(f"asked twice at length {at[0]:g}, rate {at[1]:g}, time {at[2]:g} it gives two answers")
    return passed(places=len(subject.samples))


@check("derivatives.length")
def by_length(subject: LawSubject) -> Finding:
    """Its derivative by length agrees with differences of its force."""
    return _derivative(subject, 0)


@check("derivatives.rate")
def by_rate(subject: LawSubject) -> Finding:
    """Its derivative by rate agrees with differences of its force."""
    return _derivative(subject, 1)


def _derivative(subject: LawSubject, argument: int) -> Finding:
    """Compare with the nearer of one-sided and central differences, so that a corner may have either slope."""
    worst, where = 0.0, (0.0, 0.0, 0.0)
    for at, value in subject.samples.items():
        if not np.all(np.isfinite(value)):
            raise Skip("it does not give finite numbers")
        defect = min(abs(slope - value[1 + argument]) for slope in _slopes(subject, at, argument, 0))
        size = max(subject.scale, abs(float(value[1 + argument])))
        if defect / size > worst:
            worst, where = float(defect / size), at
    name = ("length", "rate")[argument]
    if worst > AGREE:
        return failed(
            f"its derivative by {name} is not that of its force at length {where[0]:g}, rate {where[1]:g}, "
            f"time {where[2]:g}",
            difference=worst,
        )
    return passed(difference=worst)


def _slopes(subject: LawSubject, at: tuple[float, float, float], argument: int, of: int) -> Iterator[float]:
    """Give central, forward and backward differences of second order of one result of the law by one argument."""

    def value(steps: int) -> float:
        moved = list(at)
        moved[argument] += steps * SMALL
        return float(subject(*moved)[of])

    here, ahead, behind = value(0), (value(1), value(2)), (value(-1), value(-2))
    yield (ahead[0] - behind[0]) / (2 * SMALL)
    yield (4 * ahead[0] - ahead[1] - 3 * here) / (2 * SMALL)
    yield -(4 * behind[0] - behind[1] - 3 * here) / (2 * SMALL)


@check("law.potential")
def potential(subject: LawSubject) -> Finding:
    """The slope of its potential is its force at rate zero, on which time has no influence."""
    if not subject.claims["potential"]:
        raise Skip("it claims no potential")
    worst, where = 0.0, 0.0
    for length in LENGTHS:
        forces = [float(subject(length, 0.0, time)[0]) for time in TIMES]
        if np.ptp(forces) > AGREE * subject.scale:
            return failed(f"it claims a potential, but its force at rest changes with time at length {length:g}")
        defect = min(abs(slope - forces[0]) for slope in _slopes(subject, (length, 0.0, 0.0), 0, 3)) / subject.scale
        if defect > worst:
            worst, where = defect, length
    if worst > AGREE:
        return failed(f"the slope of its potential is not its force at length {where:g}", difference=worst)
    return passed(difference=worst)


@check("law.passivity")
def passivity(subject: LawSubject) -> Finding:
    """What it does not store it takes from the motion, never gives to it."""
    if not subject.claims["passive"]:
        raise Skip("it does not claim to be passive")
    stores = subject.claims["potential"]
    worst, where = 0.0, (0.0, 0.0, 0.0)
    for at, value in subject.samples.items():
        stored = float(subject(at[0], 0.0, at[2])[0]) if stores else 0.0
        given = -(float(value[0]) - stored) * at[1] / subject.scale
        if given > worst:
            worst, where = given, at
    if worst > AGREE:
        return failed(
            f"it claims to be passive, but feeds the motion at length {where[0]:g}, rate {where[1]:g}, "
            f"time {where[2]:g}",
            power=worst * subject.scale,
        )
    return passed()


@check("law.energy")
def energy(subject: LawSubject) -> Finding:
    """A mass that it holds gains what energy it gives, the better the finer the step."""
    spec = spec_type(subject.installed)
    pathway = {"type": "two-points", "bodies": ["ground", "mass"], "points": [[0.0, 0.0], [0.0, 0.0]]}
    model = {
        "name": "mechanism",
        "bodies": {"mass": {"mass": 20.0, "position": [0.8, 0.1], "velocity": [0.2, 0.9]}},
        "forces": {"law": {"type": "law", "law": subject.item.id, "pathway": pathway, **subject.options}},
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
        return passed(**figures)
    if found[-1] < found[0] / 2:
        return warned("energy adds up better with the step, but slowly: a force that is not smooth?", **figures)
    return failed("energy does not add up better with the step", **figures)


CHECKS = (options, finite, by_length, by_rate, potential, passivity, energy)
