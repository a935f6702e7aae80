"""The passive element of a Hill-type muscle for mbdkit: an example of a force law.

Beyond its optimal length the fibre force rises exponentially, up to the maximal isometric force at the strain `strain`;
beyond that it is linear, like Thelen's tendon beyond its toe region. A damper acts in parallel (Millard et al. 2013).
The tendon is rigid, as Millard et al. recommend for short tendons.
"""

from __future__ import annotations

from typing import Annotated

import sympy
from pydantic import BaseModel, ConfigDict, Field

import mbdkit

mbdkit_api = 1

REFERENCES = (
    """@article{zajac1989,
  author = {Zajac, Felix E.},
  title = {Muscle and tendon: properties, models, scaling, and application to biomechanics and motor control},
  journal = {Critical Reviews in Biomedical Engineering}, volume = {17}, pages = {359--411}, year = {1989}}""",
    """@article{thelen2003,
  author = {Thelen, Darryl G.},
  title = {Adjustment of muscle mechanics model parameters to simulate dynamic contractions in older adults},
  journal = {Journal of Biomechanical Engineering}, volume = {125}, pages = {70--77}, year = {2003},
  doi = {10.1115/1.1531112}}""",
    """@article{millard2013,
  author = {Millard, Matthew and Uchida, Thomas and Seth, Ajay and Delp, Scott L.},
  title = {Flexing computational muscle: modeling and simulation of musculotendon dynamics},
  journal = {Journal of Biomechanical Engineering}, volume = {135}, pages = {021005}, year = {2013},
  doi = {10.1115/1.4023390}}""",
)
FASTEST = 10.0
"""Maximal velocity of shortening by which damping is normalised, in optimal lengths a second (Zajac 1989)."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class MuscleOptions(BaseModel):
    """A muscle without activation."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)

    max_force: Positive
    """Maximal isometric force of the muscle, which the passive fibre reaches at `strain` [N]."""
    optimal_length: Positive
    """Length of the fibre up to which it is slack [m]."""
    tendon_length: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Length of the rigid tendon [m]; the pathway is as long as fibre and tendon together."""
    strain: Positive = 0.6
    """Strain of the fibre at its maximal isometric force (Thelen 2003: 0.6, and 0.5 in older adults)."""
    shape: Annotated[float, Field(gt=0, le=50)] = 5.0
    """Shape factor of the exponential (Thelen 2003: 5)."""
    damping: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.1
    """Damping force at ten optimal lengths a second, over the maximal isometric force (Millard et al. 2013: 0.1)."""


def passive_muscle() -> mbdkit.ExpressionLaw:
    """Return force and potential of the fibre in SymPy."""
    length, rate, force, optimal, tendon, strain, shape, damping = sympy.symbols(
        "length rate max_force optimal_length tendon_length strain shape damping", real=True
    )
    x = ((length - tendon) / optimal - 1) / strain  # 0 at the optimal length, 1 at the maximal force
    rise = sympy.exp(shape) - 1
    steepest = shape * sympy.exp(shape) / rise
    pull = sympy.Piecewise((0, x <= 0), ((sympy.exp(shape * x) - 1) / rise, x <= 1), (1 + steepest * (x - 1), True))
    at_one = 1 / shape - 1 / rise
    stored = sympy.Piecewise(
        (0, x <= 0),
        (((sympy.exp(shape * x) - 1) / shape - x) / rise, x <= 1),
        (at_one + (x - 1) + steepest * (x - 1) ** 2 / 2, True),
    )
    drag = damping * rate / (FASTEST * optimal)
    return mbdkit.ExpressionLaw(force * (pull + drag), force * strain * optimal * stored, passive=True)


@mbdkit.hookimpl
def mbdkit_force_laws() -> list[mbdkit.ForceLawPlugin]:
    """Register the law."""
    summary = "A muscle that is not activated: exponential toe, then straight, with a parallel damper."
    return [mbdkit.ForceLawPlugin("passive-muscle", summary, MuscleOptions, passive_muscle(), REFERENCES)]
