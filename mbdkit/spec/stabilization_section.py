"""The key `stabilization` of a run spec: a name, or a mapping with a name and options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, GetJsonSchemaHandler, PlainSerializer, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import canonical, found
from mbdkit.base.text import did_you_mean, listed
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.spec.sections import Count, Positive, Section

ALPHA = 5.0
"""Default value of Baumgarte's alpha [1/s]."""


class NoStabilization(Section):
    """No stabilization: constraint drift is not corrected."""

    name: Literal["none"]


class Baumgarte(Section):
    """Baumgarte stabilization of the acceleration constraints: Phi'' + 2 alpha Phi' + beta^2 Phi = 0."""

    name: Literal["baumgarte"]
    alpha: Positive = ALPHA
    """Damping of the constraints [1/s]."""
    beta: Annotated[float, Field(ge=0)] = ALPHA
    """Natural frequency of the constraints [rad/s]; by default equal to `alpha`, which is critical damping."""

    @model_validator(mode="before")
    @classmethod
    def _critically_damped(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "beta" in data:
            return data
        alpha = data.get("alpha", ALPHA)
        return {**data, "beta": alpha if isinstance(alpha, int | float) and alpha > 0 else ALPHA}

    def chosen(self) -> Stabilization:
        """Return the stabilization in the form that the equations of motion use."""
        return Stabilization("baumgarte", alpha=self.alpha, beta=self.beta)


class Projection(Section):
    """Projection of positions and velocities onto the constraints after a step, closest in the mass norm."""

    name: Literal["projection"]
    every: Count = 1
    """Number of steps between projections."""
    bound: Positive | None = None
    """Project only if a position residual [m, rad] or a velocity residual [m/s, rad/s] exceeds this value."""
    symmetric: bool = False
    """Symmetric projection (Hairer 2000): perturb the state before each step by the same amount as it is projected
    after the step, which keeps a symmetric method reversible."""

    @model_validator(mode="after")
    def _consistent(self) -> Projection:
        if self.symmetric and self.every != 1:
            raise SpecError(
                f"should be 1 with `symmetric: true`, not {self.every}: without a projection in every step, the "
                "method is not reversible",
                key="every",
            )
        if self.symmetric and self.bound is not None:
            raise SpecError(
                "cannot be combined with `symmetric: true`: without a projection in every step, the method is "
                "not reversible",
                key="bound",
            )
        return self

    def chosen(self) -> Stabilization:
        """Return the stabilization in the form that the steppers use."""
        return Stabilization("projection", every=self.every, bound=self.bound, symmetric=self.symmetric)


NAMES = ("none", "baumgarte", "projection")


class _OrName:
    """Adds the name without options to the JSON schema."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [{"enum": list(NAMES), "type": "string"}, handler(core)]}


def _named(given: Any) -> Any:
    """Convert a name to a mapping with this name; raise SpecError if the value does not name a stabilization."""
    name = given.get("name") if isinstance(given, Mapping) else given
    if isinstance(name, str) and name in NAMES:
        return {"name": name} if given is name else given
    if isinstance(given, Mapping) and "name" not in given:
        raise SpecError(f"is missing: the name of the stabilization; known: {listed(NAMES)}", key="name")
    hint = did_you_mean(name, NAMES) if isinstance(name, str) else ""
    raise SpecError(
        f"should be {listed((repr(known) for known in NAMES), 'or')}, not {found(name)}{hint}",
        key="name" if isinstance(given, Mapping) else "",
    )


def _plainly(chosen: Any) -> Any:
    """Replace `NoStabilization` by the string ``none``."""
    return "none" if isinstance(chosen, NoStabilization) else chosen


Choice = Annotated[
    NoStabilization | Baumgarte | Projection,
    Field(discriminator="name"),
    BeforeValidator(_named),
    AfterValidator(_plainly),
    PlainSerializer(canonical),
    _OrName(),
]
"""Type of the key `stabilization` of a spec; its value is the string ``none``, or a model with options."""


UNSTABILIZED: Any = "none"
"""Default value of the key `stabilization`."""


def stabilization_of(choice: Any) -> Stabilization:
    """Return a validated choice in the form that the engine uses."""
    return choice.chosen() if isinstance(choice, Baumgarte | Projection) else NONE
