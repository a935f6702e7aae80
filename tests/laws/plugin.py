"""A plugin with force laws, as a third party would write it; some of them wrong on purpose."""

from __future__ import annotations

import math
from typing import Any

import numba
import sympy as sp
from pydantic import BaseModel, Field, field_validator

from mbdkit import ExpressionLaw, ForceLawPlugin, FunctionLaw, hookimpl

from .motor import ALTERNATING, MOTOR

length, rate, time = sp.symbols("length rate time")
stiffness, damping, free, cubic = sp.symbols("stiffness damping free cubic")


class Linear(BaseModel):
    stiffness: float = 0.0
    damping: float = 0.0
    free: float = 0.0


class Duffing(BaseModel):
    stiffness: float = 0.0
    cubic: float = Field(0.0, ge=0.0, description="Cubic stiffness [N/m^3].")
    damping: float = 0.0


class Nothing(BaseModel):
    pass


class Named(BaseModel):
    length: float = 1.0


class Weights(BaseModel):
    weights: list[float]


class Inverse(BaseModel):
    compliance: float = 0.0

    @field_validator("compliance")
    @classmethod
    def _is_not_small(cls, compliance: float) -> float:
        if 1 / compliance > 1e9:
            raise ValueError("is too small")
        return compliance


def linear(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    stretch = length - p[2]
    return p[0] * stretch + p[1] * rate, p[0], p[1], p[0] * stretch * stretch / 2


@numba.njit
def duffing(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    k, c3, c = p[0], p[1], p[2]
    force = k * length + c3 * length**3 + c * rate * abs(rate)
    return force, k + 3 * c3 * length**2, 2 * c * abs(rate), k * length**2 / 2 + c3 * length**4 / 4


def pump(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    force = math.sin(3 * time) * length + 0.2 * math.sin(rate)
    return force, math.sin(3 * time), 0.2 * math.cos(rate), 0.0


def polynomial(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    force = slope = potential = 0.0
    for i in range(len(p) - 1, -1, -1):
        slope = slope * length + force
        force = force * length + p[i]
        potential = potential * length + p[i] / (i + 1)
    return force, slope, 0.0, potential * length


def without_derivatives(length: float, rate: float, time: float, p: Any) -> float:
    return -length


def not_compilable(length: float, rate: float, time: float, p: Any) -> Any:
    return open("force.txt").read(), 0.0, 0.0, 0.0


def not_numbers(length: float, rate: float, time: float, p: Any) -> Any:
    return "force", 0.0, 0.0, 0.0


def not_finite(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    return math.sqrt(0.5 - time), 0.0, 0.0, 0.0


def no_slope(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    return length, math.sqrt(0.5 - time), 0.0, 0.0


def no_potential(length: float, rate: float, time: float, p: Any) -> tuple[float, float, float, float]:
    return length, 1.0, 0.0, math.sqrt(0.5 - time)


def fail(options: Any) -> list[float]:
    raise ZeroDivisionError("no parameters today")


def plugin(name: str, options: type[BaseModel], law: Any) -> ForceLawPlugin:
    return ForceLawPlugin(name, f"The law {name}", options, law, ("@misc{test}",))


LAWS = [
    ALTERNATING,
    MOTOR,
    plugin(
        "linear-sympy",
        Linear,
        ExpressionLaw(stiffness * (length - free) + damping * rate, stiffness * (length - free) ** 2 / 2, passive=True),
    ),
    plugin("linear-numba", Linear, FunctionLaw(linear, potential=True, passive=True)),
    plugin(
        "duffing-sympy",
        Duffing,
        ExpressionLaw(
            stiffness * length + cubic * length**3 + damping * rate * sp.Abs(rate),
            stiffness * length**2 / 2 + cubic * length**4 / 4,
            passive=True,
        ),
    ),
    plugin("duffing-numba", Duffing, FunctionLaw(duffing, potential=True, passive=True)),
    plugin("pump-sympy", Nothing, ExpressionLaw(sp.sin(3 * time) * length + sp.sin(rate) / 5)),
    plugin("pump-numba", Nothing, FunctionLaw(pump)),
    plugin("polynomial", Weights, FunctionLaw(polynomial, potential=True, parameters=lambda o: o.weights)),
    plugin("lambda", Linear, FunctionLaw(lambda s, v, t, p: (p[0] * s, p[0], 0.0, p[0] * s * s / 2), potential=True)),
    plugin("without-derivatives", Nothing, FunctionLaw(without_derivatives)),
    plugin("not-compilable", Nothing, FunctionLaw(not_compilable)),
    plugin("not-numbers", Nothing, FunctionLaw(not_numbers)),
    plugin("not-finite", Nothing, FunctionLaw(not_finite)),
    plugin("no-slope", Nothing, FunctionLaw(no_slope)),
    plugin("no-potential", Nothing, FunctionLaw(no_potential, potential=True)),
    plugin(
        "hertz",
        Linear,
        ExpressionLaw(stiffness * length ** sp.Rational(3, 2), stiffness * length ** sp.Rational(5, 2) * 2 / 5),
    ),
    plugin("bessel", Nothing, ExpressionLaw(sp.besselj(0, length))),
    plugin("named-length", Named, ExpressionLaw(length)),
    plugin("not-smooth", Nothing, ExpressionLaw(sp.Function("f")(length))),
    plugin("not-an-expression", Nothing, ExpressionLaw(lambda: "length")),
    plugin("unknown-symbol", Linear, ExpressionLaw(sp.Symbol("stifness") * length)),
    plugin("wrong-potential", Linear, ExpressionLaw(stiffness * length, stiffness * length**2)),
    plugin("timed-potential", Linear, ExpressionLaw(stiffness * length * time, stiffness * length**2 / 2)),
    plugin("inverse", Inverse, ExpressionLaw(length / sp.Symbol("compliance"))),
    plugin("no-parameters", Nothing, FunctionLaw(linear, parameters=fail)),
]


@hookimpl
def mbdkit_force_laws() -> list[ForceLawPlugin]:
    return LAWS
