"""Options of the built-in integrators, as a spec writes them under ``integrator:``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class Options(BaseModel):
    """Base of all options: strict, frozen, no unknown keys."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)


class ExplicitOptions(Options):
    """An explicit method of fixed order has nothing to choose."""


class ImplicitOptions(Options):
    """How the stage equations of an implicit method are solved."""

    stage_solver: Literal["newton", "fixed-point"] = "newton"
    """Simplified Newton with exact tangents, or fixed-point iteration on the stage accelerations."""
    tolerance: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None = None
    """Stop when the stage accelerations change by less than this, relative to their size; left out: at stagnation."""
    max_iterations: Annotated[int, Field(ge=2, le=10_000)] = 50
    """Iterations in one step after which the stage equations count as unsolved."""


class GaussOptions(ImplicitOptions):
    """Gauss-Legendre collocation."""

    stages: Annotated[int, Field(ge=1, le=6)] = 2
    """Number of stages s; the order is 2 s."""


class RattleOptions(Options):
    """How the positions of a step are found that meet the constraints."""

    tolerance: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None = None
    """Stop when positions are expected to change by less than this, relative to their size; left out: at stagnation."""
    max_iterations: Annotated[int, Field(ge=2, le=10_000)] = 50
    """Iterations in one step after which its equations count as unsolved."""


class PairOptions(RattleOptions):
    """A pair of Lobatto IIIA and IIIB."""

    stages: Literal[2, 3] = 3
    """Number of stages s; the order is 2 s - 2. Two stages make RATTLE."""


class RadauOptions(ImplicitOptions):
    """Radau IIA collocation."""

    stages: Literal[2, 3, 5] = 3
    """Number of stages s; the order is 2 s - 1."""


class AdaptiveOptions(Options):
    """A method of SciPy that controls its own error."""

    rtol: Annotated[float, Field(ge=2.3e-14, lt=1, allow_inf_nan=False)] = 1e-8
    """Relative error tolerance of a step; SciPy takes none below 100 roundings, 2.3e-14."""
    atol: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1e-10
    """Absolute error tolerance of a step [m, rad, m/s, rad/s]."""
