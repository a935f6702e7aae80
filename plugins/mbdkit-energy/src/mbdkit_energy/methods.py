"""Options, claims and references of the energy-conserving methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit.plugin.seams import integrator_claims, integrator_method
from mbdkit_energy.line_integral import LineIntegral

REFERENCES_OF_DISCRETE_GRADIENT, REFERENCES_OF_HBVM = (
    tuple(Path(__file__).with_name(f"{name}.bib").read_text(encoding="utf-8").strip().split("\n\n"))
    for name in ("discrete-gradient", "hbvm")
)


class DiscreteGradientOptions(BaseModel):
    """Options of the discrete gradient: a limit of its iterations."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)

    adaptive: Literal[False] = False
    """Steps are fixed."""
    max_iterations: Annotated[int, Field(ge=2, le=1000)] = 50
    """Largest number of iterations in one step; a step that needs more has failed."""


class LineIntegralOptions(DiscreteGradientOptions):
    """Options of HBVM(k, s)."""

    s: Annotated[int, Field(ge=1, le=3)] = 1
    """Degree of the polynomials. The order is 2 s; friction in joints, which depends on multipliers between the ends of
    a step, lowers it if s > 1, to 2 for s = 2."""
    k: Annotated[int, Field(ge=3, le=20)] = 8
    """Number of nodes of the integrals over a step. Energy is conserved exactly by springs without free length and by
    other polynomial potentials of degree at most 2 k / s, and to rounding by others and by joints if k is large enough.
    """


@integrator_method
def create_discrete_gradient(options: DiscreteGradientOptions) -> LineIntegral:
    """Return the discrete gradient of Gonzalez."""
    return LineIntegral(1, 1, options.max_iterations, is_corrected=True)


@integrator_method
def create_hbvm(options: LineIntegralOptions) -> LineIntegral:
    """Return HBVM(k, s)."""
    return LineIntegral(options.k, options.s, options.max_iterations)


@integrator_claims
def claims_of_discrete_gradient(options: DiscreteGradientOptions) -> mbdkit.Claims:
    """Return the claims of the discrete gradient."""
    return _claims(1, 1)


@integrator_claims
def claims_of_hbvm(options: LineIntegralOptions) -> mbdkit.Claims:
    """Return the claims of HBVM(k, s)."""
    return _claims(options.k, options.s)


def _claims(k: int, s: int) -> mbdkit.Claims:
    return mbdkit.Claims(
        order=2 * s,
        multiplier_order=2 * s,
        stages=k,
        drift="none",
        constraints_hold=("position", "velocity"),
        needs=("accelerations", "tangents"),
        formulations=("index-3",),
        stabilizations=("none", "projection"),
        conserves=("energy",),
        dense_order=min(2 * s - 1, 4),
        a_stable=True,
    )
