"""Options and coefficients of the built-in controllers of adaptive steps, and their use by methods."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, ClassVar, cast

from pydantic import BaseModel, Field

from mbdkit.base.bibliography import entry
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_filter import StepFilter, step_filter
from mbdkit.methods.step_methods import ExternalMethod
from mbdkit.registry.item_options import is_of_item, item_of
from mbdkit.registry.items import StepControl
from mbdkit.registry.manager import use

SODERLIND = entry(__file__, "soderlind2003")
GUSTAFSSON = entry(__file__, "gustafsson1991")
PREDICTIVE = entry(__file__, "gustafsson1994")
OF_FILTERS, OF_PI, OF_PREDICTIVE = (SODERLIND,), (GUSTAFSSON, SODERLIND), (PREDICTIVE, SODERLIND)

Number = Annotated[float, Field(allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class StepControlOptions(StrictModel):
    """Options of every built-in controller."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("safety", "limits")

    safety: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] = 0.9
    """Size of steps as a share of that at which the estimated error equals the tolerance."""
    limits: tuple[Limit, Limit] = (0.2, 6.0)
    """Smallest and largest ratio of the sizes of two consecutive steps; the first is below 1, the second above."""

    def filter(self, errors: tuple[float, ...], ratios: tuple[float, ...] = ()) -> StepFilter:
        """Return the controller with these coefficients and options."""
        try:
            return StepFilter(errors, ratios, self.safety, self.limits)
        except PluginError as error:
            raise SpecError(str(error)) from None


class PIOptions(StepControlOptions):
    """A proportional-integral controller."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*StepControlOptions.ABSENT_BY_DEFAULT, "integral", "proportional")

    integral: Number = 0.3
    """Integral gain times the order k of the error estimate."""
    proportional: Number = 0.4
    """Proportional gain times k."""


class PIDOptions(PIOptions):
    """A proportional-integral-derivative controller; by default the low-pass filter H312PID."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*PIOptions.ABSENT_BY_DEFAULT, "derivative")

    integral: Number = 2 / 9
    """Integral gain times the order k of the error estimate."""
    proportional: Number = -2 / 9
    """Proportional gain times k."""
    derivative: Number = 1 / 18
    """Derivative gain times k."""


class H211bOptions(StepControlOptions):
    """The low-pass filter H211b."""

    b: Annotated[float, Field(gt=1, allow_inf_nan=False)] = 4.0
    """Parameter b: larger values give smoother step sizes, which follow the motion more slowly; 2 to 8 are usual."""


class H312bOptions(StepControlOptions):
    """The low-pass filter H312b."""

    b: Annotated[float, Field(gt=2, allow_inf_nan=False)] = 8.0
    """Parameter b: larger values give smoother step sizes, which follow the motion more slowly; 4 to 16 are usual."""


@step_filter
def deadbeat(options: StepControlOptions) -> StepFilter:
    """Return the elementary controller, which corrects the whole error in one step."""
    return options.filter((1.0,))


@step_filter
def pi(options: PIOptions) -> StepFilter:
    """Return a proportional-integral controller; by default PI.3.4 (Soderlind 2003, table III)."""
    return options.filter((options.integral + options.proportional, -options.proportional))


@step_filter
def pid(options: PIDOptions) -> StepFilter:
    """Return a proportional-integral-derivative controller."""
    integral, proportional, derivative = options.integral, options.proportional, options.derivative
    return options.filter((integral + proportional + derivative, -(proportional + 2.0 * derivative), derivative))


@step_filter
def predictive(options: StepControlOptions) -> StepFilter:
    """Return the predictive controller PC11 of RADAU5 (Hairer and Wanner 1996, IV.8)."""
    return options.filter((2.0, -1.0), (-1.0,))


@step_filter
def h211b(options: H211bOptions) -> StepFilter:
    """Return the filter H211b (Soderlind 2003, table III)."""
    weight = 1.0 / options.b
    return options.filter((weight, weight), (weight,))


@step_filter
def h312b(options: H312bOptions) -> StepFilter:
    """Return the filter H312b (Soderlind 2003, table III)."""
    weight = 1.0 / options.b
    return options.filter((weight, 2.0 * weight, weight), (3.0 * weight, weight))


@step_filter
def h321(options: StepControlOptions) -> StepFilter:
    """Return the filter H321 (Soderlind 2003, table III)."""
    return options.filter((1 / 3, 1 / 18, -5 / 18), (-5 / 6, -1 / 6))


KEY = "integrator.step_control"  #: The key of a run spec that chooses a controller.


def controlled(method: Method, options: BaseModel, name: str) -> Method:
    """Return a method with the controller that its options choose, or the method itself if they choose none.

    Parameters
    ----------
    method
        The method, which is not changed.
    options
        Options of the integrator.
    name
        Name of the integrator for error messages.

    Raises
    ------
    SpecError
        If the steps of the method are fixed, or a library chooses them.
    PluginError
        If a plugin fails to return the coefficients of its controller.
    """
    chosen = getattr(options, "step_control", None)
    if not isinstance(chosen, BaseModel) or not is_of_item(type(chosen)):
        return method
    tolerances = method.traits.tolerances
    if isinstance(method, ExternalMethod):
        raise SpecError(f"the library of '{name}' chooses its steps, so that no other controller can be used", key=KEY)
    if tolerances is None:
        remedy = "; add `adaptive: true`" if "adaptive" in type(options).model_fields else ""
        raise SpecError(f"'{name}' takes fixed steps, which no controller chooses{remedy}", key=KEY)
    item = item_of(chosen)
    create = cast("Callable[[BaseModel], StepFilter]", cast(StepControl, item.plugin).create)
    with SpecError.locate(KEY):
        control = use(item, lambda: create(chosen), StepFilter)
    new = copy.copy(method)
    vars(new).pop("traits", None)  # which some classes keep
    vars(new)["tolerances"] = replace(tolerances, control=control)
    return new
