"""Options, claims and references of the energy-conserving methods."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit.plugin.seams import integrator_claims, integrator_method
from mbdkit_energy.line_integral import LineIntegral

REFERENCES_OF_DISCRETE_GRADIENT = (
    """@article{gonzalez1996,
  author = {Gonzalez, Oscar},
  title = {Time integration and discrete {H}amiltonian systems},
  journal = {Journal of Nonlinear Science}, volume = {6}, pages = {449--467}, year = {1996},
  doi = {10.1007/BF02440162}}""",
    """@article{gonzalez1999,
  author = {Gonzalez, Oscar},
  title = {Mechanical systems subject to holonomic constraints: differential-algebraic formulations and conservative
    integration},
  journal = {Physica D}, volume = {132}, pages = {165--174}, year = {1999},
  doi = {10.1016/S0167-2789(99)00054-8}}""",
)
ASCHER_PETZOLD = """@article{ascher1991,
  author = {Ascher, Uri M. and Petzold, Linda R.},
  title = {Projected implicit {R}unge-{K}utta methods for differential-algebraic equations},
  journal = {SIAM Journal on Numerical Analysis}, volume = {28}, pages = {1097--1120}, year = {1991},
  doi = {10.1137/0728059}}"""
REFERENCES_OF_HBVM = (
    """@article{brugnano2010,
  author = {Brugnano, Luigi and Iavernaro, Felice and Trigiante, Donato},
  title = {{H}amiltonian boundary value methods (energy preserving discrete line integral methods)},
  journal = {Journal of Numerical Analysis, Industrial and Applied Mathematics}, volume = {5}, pages = {17--37},
  year = {2010}}""",
    r"""@article{brugnano2018,
  author = {Brugnano, Luigi and Gurioli, Gianmarco and Iavernaro, Felice and Weinm{\"u}ller, Ewa B.},
  title = {Line integral solution of {H}amiltonian systems with holonomic constraints},
  journal = {Applied Numerical Mathematics}, volume = {127}, pages = {56--77}, year = {2018},
  doi = {10.1016/j.apnum.2017.12.014}}""",
    ASCHER_PETZOLD,
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
