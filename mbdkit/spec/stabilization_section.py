"""What a spec says under `stabilization`: a name alone, or a name and its options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, GetJsonSchemaHandler, PlainSerializer, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.errors import SpecError
from mbdkit.spec.plain_data import canonical, found
from mbdkit.spec.sections import Count, Positive, Section
from mbdkit.text import did_you_mean, listed

ALPHA = 5.0
"""Baumgarte's alpha [1/s] where a spec names none."""


class NoStabilization(Section):
    """Nothing is done, and the drift of the method shows."""

    name: Literal["none"]


class Baumgarte(Section):
    """Constraints are pulled back at acceleration level: Phi'' + 2 alpha Phi' + beta^2 Phi = 0."""

    name: Literal["baumgarte"]
    alpha: Positive = ALPHA
    """Damping of the constraints [1/s]."""
    beta: Annotated[float, Field(ge=0)] = ALPHA
    """Natural frequency of the constraints [rad/s]; left out: equal to `alpha`, critical damping."""

    @model_validator(mode="before")
    @classmethod
    def _critically_damped(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "beta" in data:
            return data
        alpha = data.get("alpha", ALPHA)
        return {**data, "beta": alpha if isinstance(alpha, int | float) and alpha > 0 else ALPHA}

    def chosen(self) -> Stabilization:
        """Return it as the equations take it."""
        return Stabilization("baumgarte", alpha=self.alpha, beta=self.beta)


class Projection(Section):
    """Positions and velocities are moved onto the constraints after a step, by the least change in the mass metric."""

    name: Literal["projection"]
    every: Count = 1
    """Project after every so many steps."""
    bound: Positive | None = None
    """Project only where a constraint misses by more than this [m, rad], or by more than this in a second."""
    symmetric: bool = False
    """Move off the constraints before each step as far as back onto them after it (Hairer 2000), which keeps a
    symmetric method reversible."""

    @model_validator(mode="after")
    def _consistent(self) -> Projection:
        if self.symmetric and self.every != 1:
            raise SpecError(
                f"should be 1 with `symmetric: true`, not {self.every}: a step in between that is not projected "
                "would not be undone by a step back",
                key="every",
            )
        if self.symmetric and self.bound is not None:
            raise SpecError(
                "has no place beside `symmetric: true`: steps that are projected and steps that are not would "
                "not undo each other",
                key="bound",
            )
        return self

    def chosen(self) -> Stabilization:
        """Return it as the steppers take it."""
        return Stabilization("projection", every=self.every, bound=self.bound, symmetric=self.symmetric)


NAMES = ("none", "baumgarte", "projection")


class _OrName:
    """Tells in the JSON schema that a name may stand alone."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [{"enum": list(NAMES), "type": "string"}, handler(core)]}


def _named(given: Any) -> Any:
    """Return a name that stands alone as a mapping; raises SpecError for anything that names no stabilization."""
    name = given.get("name") if isinstance(given, Mapping) else given
    if isinstance(name, str) and name in NAMES:
        return {"name": name} if given is name else given
    if isinstance(given, Mapping) and "name" not in given:
        raise SpecError(f"is missing: it says which stabilization; known: {listed(NAMES)}", key="name")
    hint = did_you_mean(name, NAMES) if isinstance(name, str) else ""
    raise SpecError(
        f"should be {listed((repr(known) for known in NAMES), 'or')}, not {found(name)}{hint}",
        key="name" if isinstance(given, Mapping) else "",
    )


def _plainly(chosen: Any) -> Any:
    """Return ``none`` as the word that it is."""
    return "none" if isinstance(chosen, NoStabilization) else chosen


Choice = Annotated[
    NoStabilization | Baumgarte | Projection,
    Field(discriminator="name"),
    BeforeValidator(_named),
    AfterValidator(_plainly),
    PlainSerializer(canonical),
    _OrName(),
]
"""The type of the key `stabilization` of a spec; its value is the word ``none``, or a model with options."""


UNSTABILIZED: Any = "none"
"""What a spec that says nothing chooses."""


def stabilization_of(choice: Any) -> Stabilization:
    """Return a checked choice as the engine takes it."""
    return choice.chosen() if isinstance(choice, Baumgarte | Projection) else NONE
