"""A force law: soft tissue that stiffens exponentially (Fung 1967)."""

import sympy
from pydantic import BaseModel, Field

import mbdkit

length, force, exponent, free_length = sympy.symbols("length force exponent free_length", real=True)
x = length - free_length
FUNG = mbdkit.ExpressionLaw(
    force * (sympy.exp(exponent * x) - 1),
    force * (sympy.exp(exponent * x) / exponent - x),
    valid_range={"length": (0.0, 1.0)},
)


class Options(BaseModel):
    force: float = Field(5.0, ge=0, le=1e4, description="Scale of the force [N].")
    exponent: float = Field(10.0, gt=0.1, le=30, description="Exponent of stiffening [1/m].")
    free_length: float = Field(0.1, ge=0, le=1, description="Length without force [m].")


@mbdkit.hookimpl
def mbdkit_force_laws():
    return [mbdkit.ForceLawPlugin("fung", "Tissue that stiffens exponentially.", Options, FUNG)]
