"""Dry friction inside joints: the coefficients of a spec, and the formula of their force."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pydantic import model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.values import NotNegative, Positive


def regularised_friction(
    normal: Any, slip: Any, numbers: Sequence[Any], choose: Callable[[Any, Any, Any], Any], share: Any = None
) -> Any:
    """Return Coulomb's friction force, which opposes the slip velocity, regularised as in Simbody.

    The magnitude of the force is largest, `static` times the normal force, at the slip velocity `transition`. At larger
    slip velocities it approaches `kinetic` times the normal force.

    `normal`, `slip`: normal force [N] and slip velocity [m/s]: numbers, or symbols of any kind with the operators of
    numbers. `numbers`: the coefficients `static` and `kinetic`, and the slip velocity `transition` [m/s]. `choose`:
    function ``choose(x, a, b)`` that returns a where x > 0, else b. `share`: the share of the largest force at this
    slip velocity, from -1 to 1, if it is not to be chosen by the slip velocity.
    """
    static, kinetic, transition = numbers
    ratio = slip**2 / transition**2
    size = kinetic + 2 * (static - kinetic) / (1 + ratio)
    if share is None:
        share = choose(1 - ratio, slip / transition, choose(slip, 1, -1))
    return -normal * size * share


class JointFriction(StrictModel):
    """Coulomb friction in a joint, which opposes its motion in proportion to its reaction force."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("coefficient", "static", "kinetic")

    coefficient: NotNegative | None = None
    """Coefficient of friction, which is the same at rest and in motion."""
    static: NotNegative | None = None
    """Ratio of the largest friction force, which is reached at the transition speed, to the normal force. `static` and
    `kinetic` are an alternative to `coefficient`."""
    kinetic: NotNegative | None = None
    """Ratio of the friction force in fast motion to the normal force; requires `static`."""
    transition_speed: Positive = 0.01
    """Slip [m/s] at which the regularised friction force reaches its static value."""

    @model_validator(mode="after")
    def _has_coefficients(self) -> JointFriction:
        if self.coefficient is not None:
            for key in ("static", "kinetic"):
                if getattr(self, key) is not None:
                    raise SpecError("give either `coefficient` or `static` and `kinetic`", key=key)
            return self
        if self.static is None and self.kinetic is None:
            raise SpecError("is missing: give `coefficient`, or `static` and `kinetic`", key="coefficient")
        for key in ("static", "kinetic"):
            if getattr(self, key) is None:
                raise SpecError("is missing: `static` and `kinetic` belong together", key=key)
        static, kinetic = self.coefficients
        if kinetic > static:
            raise SpecError(f"should not be greater than `static`, {static:g}, but is {kinetic:g}", key="kinetic")
        return self

    @property
    def coefficients(self) -> tuple[float, float]:
        """Static and kinetic coefficient."""
        if self.coefficient is not None:
            return self.coefficient, self.coefficient
        assert self.static is not None
        assert self.kinetic is not None
        return self.static, self.kinetic


class PinFriction(JointFriction):
    """Friction of a pin in its bearing: a torque, coefficient times radius times reaction force."""

    radius: Positive
    """Radius of the pin [m]."""


class SlideFriction(JointFriction):
    """Friction of a slide in its guide: coefficient times the sum of the normal forces at both ends of the slide."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*JointFriction.ABSENT_BY_DEFAULT, "length")

    length: Positive | None = None
    """Length of the slide [m]; its middle is the second body's point. The moment of the joint acts as two opposite
    normal forces at the ends of the slide, each of them the moment divided by the length. By default, the moment causes
    no friction."""
