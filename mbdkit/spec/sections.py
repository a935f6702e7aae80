"""Sections of a run spec that do not depend on plugins: time, output, events, limits and stabilization."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, GetJsonSchemaHandler, PlainSerializer, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import LONGEST_TITLE, canonical, value_text
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import did_you_mean, listed
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.mechanism.checks import check_name
from mbdkit.mechanism.state_values import OuterExpression
from mbdkit.quantities.entries import ChosenGroup
from mbdkit.quantities.table import quantities_of_events

QUANTITIES = get_args(ChosenGroup)


def whole(value: object) -> object:
    """Convert floats with integer values to int, because large counts are often written as 1e6."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


LARGEST_COUNT = 2**53

Count = Annotated[int, BeforeValidator(whole), Field(ge=1, le=LARGEST_COUNT)]
Positive = Annotated[float, Field(gt=0)]


class Section(StrictModel):
    """Base class of the sections of a spec."""


class Time(Section):
    """Start time, end time and step of the run; give exactly one of `end` and `steps`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("stops",)

    start: float = 0.0
    """Start time [s]."""
    end: float | None = None
    """End time [s]; the last step ends exactly at this time."""
    steps: Count | None = None
    """Number of steps of length `step`, instead of `end`."""
    step: Positive | None = None
    """Step [s]; for an adaptive method, the first step (optional)."""
    stops: tuple[float, ...] = ()
    """Further times at which steps end [s], within the run."""

    @model_validator(mode="after")
    def _consistent(self) -> Time:
        if self.end is not None and self.steps is not None:
            raise PydanticCustomError(
                "mbdkit",
                "takes exactly one of `end` and `steps`, not both; null removes a key, as in --set time.steps=null",
            )
        if self.end is None and self.steps is None:
            raise PydanticCustomError("mbdkit", "needs `end` (a time in seconds) or `steps` (a number of steps)")
        if self.steps is not None and self.step is None:
            raise PydanticCustomError("mbdkit", "`steps` also needs `step` (the length of one step in seconds)")
        if self.end is not None and self.end <= self.start:
            raise SpecError(f"must be later than the start at {self.start!r}, not {self.end!r}", key="end")
        if not math.isfinite(self.final - self.start):
            raise PydanticCustomError("mbdkit", "is too long for double precision")
        for index, stop in enumerate(self.stops):
            if not self.start <= stop <= self.final:
                outside = f"should be within the run, from {self.start:g} s to {self.final:g} s, not {stop!r}"
                raise SpecError(outside, key=f"stops[{index}]")
        largest = max(abs(self.start), abs(self.final))
        if self.step is not None and largest + self.step / 2 == largest:
            raise SpecError(
                f"{self.step!r} is too small: adding it to the time has no effect in double precision", key="step"
            )
        return self

    @property
    def final(self) -> float:
        """The end time [s], from `end` or from `steps`."""
        if self.end is not None:
            return self.end
        assert self.steps is not None
        assert self.step is not None
        return self.start + self.steps * self.step

    @property
    def count(self) -> int | None:
        """Number of steps of a fixed-step method, the last one possibly shorter; None without a step."""
        if self.steps is not None:
            return self.steps
        if self.step is None:
            return None
        return max(1, math.ceil((self.final - self.start) / self.step - 1e-9))


class Output(Section):
    """Recorded quantities and the recording interval; the start and the end of the run are always recorded."""

    every: Count | None = None
    """Number of steps between records; 1 unless `interval` is given."""
    interval: Positive | None = None
    """Time between records [s], instead of `every`; requires a method with dense output. As any row, one at an impact
    or another instant with two sides holds the limit from before; see the page `events`."""
    quantities: Literal["all"] | tuple[ChosenGroup, ...] = "all"
    """Groups of quantities recorded in addition to trajectory, steps and stats."""

    @model_validator(mode="before")
    @classmethod
    def _normal(cls, data: object) -> object:
        if not isinstance(data, dict):
            return data
        data = dict(data)
        if data.get("every") is None and data.get("interval") is None:
            data["every"] = 1
        wanted = data.get("quantities")
        if isinstance(wanted, list) and all(isinstance(word, str) for word in wanted):
            groups = tuple(sorted(set(wanted)))
            data["quantities"] = "all" if groups == QUANTITIES else groups
        return data

    @model_validator(mode="after")
    def _consistent(self) -> Output:
        if self.every is not None and self.interval is not None:
            raise PydanticCustomError("mbdkit", "takes either `every` or `interval`, not both")
        return self

    @property
    def recorded(self) -> frozenset[str]:
        """Groups of quantities recorded in addition to trajectory, steps and stats."""
        return frozenset(QUANTITIES if self.quantities == "all" else self.quantities)


class Event(Section):
    """An event: a zero crossing of an expression during the run.

    If a body and a joint have the same name, write bodies.NAME or joints.NAME. Names with characters other than
    letters, digits and underscores must be quoted, as in joints["J 1"].force.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("set",)

    when: str
    """Expression whose zero crossings are the event, such as "knee.angle - 1.2"."""
    direction: Literal["any", "rising", "falling"] = "any"
    """Crossings to detect: `rising` (negative to positive), `falling` (positive to negative), or `any`."""
    action: Literal["note", "stop"] = "note"
    """`note` records the crossing; `stop` also ends the run, which then counts as complete."""
    set: dict[str, OuterExpression] = Field(default_factory=dict)
    """New values of first-order states at the crossing, by name, as numbers or expressions of the state before the
    crossing and of named parameters, such as `{i: 0}` or `{w: "-0.8*states.w"}`. The key of a state of an element or
    controller, or of an output of a controller, is "NAME.STATE" or "NAME.OUTPUT"."""

    @model_validator(mode="after")
    def _goes_on(self) -> Event:
        if self.set and self.action == "stop":
            raise PydanticCustomError("mbdkit", "sets states of a run that it stops; leave out `set` or `action: stop`")
        return self


Event.__doc__ = f"{inspect.cleandoc(Event.__doc__ or '')} Expressions may contain t; {quantities_of_events()}."


def named_events(events: dict[str, Event]) -> dict[str, Event]:
    """Return the events unchanged if their names are valid; otherwise raise SpecError."""
    for name in events:
        check_name(name, name)
    return events


class Meta(Section):
    """What catalogues show of an archive, besides the title of the spec."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("description", "creator", "license")

    description: Annotated[str, Field(max_length=LONGEST_TITLE)] = ""
    """What the run shows, in one or a few sentences; by default, its model and its method."""
    creator: Annotated[str, Field(max_length=LONGEST_TITLE)] = ""
    """Who made the run, such as `Ada Lovelace <https://orcid.org/0000-0000-0000-0000>`; unnamed by default."""
    license: Annotated[str, Field(max_length=LONGEST_TITLE)] = ""
    """Licence of the results: an SPDX identifier such as `CC-BY-4.0`, or an address; none by default."""


GradientMode = Literal["auto", "forward", "adjoint"]


class Gradients(Section):
    """Derivatives of all measures with respect to parameters."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("mode",)

    parameters: list[str] = Field(min_length=1)
    """Names of `parameters`, or key paths of numbers such as `model.bodies.rod.mass`."""
    mode: GradientMode = "auto"
    """How they are computed: `forward` carries the derivatives with respect to all parameters through every step;
    `adjoint` carries those of each measure back from the end to the start, which costs a few runs for any number of
    parameters, and refuses what it does not support; `auto` chooses by cost."""


class Limits(Section):
    """Limits that stop a run early."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("misalignment", "energy_jump", "law_range")

    wall_time: Positive | None = None
    """Largest elapsed real time of the run [s]; unlimited by default. The same limit applies to all comparison runs of
    a check together; the pilot runs of `accuracy` are not limited."""
    max_steps: Count = 10_000_000
    """Largest number of steps."""
    misalignment: Positive = 1.0
    """Largest misalignment of a joint, as a share of the mechanism's size (for an angle: in radians). A run in which a
    joint exceeds this limit stops with the reason `fell-apart`."""
    energy_jump: Positive | None = None
    """Largest change of the energy balance in one step, as a share of the largest kinetic energy so far; a run that
    exceeds it stops with the reason `energy-jump`. Unlimited by default."""
    law_range: Literal["warn", "stop"] = "warn"
    """What happens if a run leaves the range in which a force law is valid: `warn` continues the run with a warning and
    the verdict `doubtful`; `stop` stops it with the reason `out-of-range`."""


ALPHA = 5.0  #: Default value of Baumgarte's alpha [1/s].


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
    def _critically_damped(cls, data: object) -> object:
        if not isinstance(data, dict) or "beta" in data:
            return data
        alpha = data.get("alpha", ALPHA)
        return {**data, "beta": alpha if isinstance(alpha, int | float) and alpha > 0 else ALPHA}

    def chosen(self) -> Stabilization:
        """Return the stabilization in the form that the equations of motion use."""
        return Stabilization("baumgarte", alpha=self.alpha, beta=self.beta)


class Projection(Section):
    """Projection of positions and velocities after a step to the closest ones, in the mass norm, that satisfy the
    constraints.
    """

    name: Literal["projection"]
    every: Count = 1
    """Number of steps between projections."""
    bound: Positive | None = None
    """Project only if a position residual [m, rad] or a velocity residual [m/s, rad/s] exceeds this value."""
    symmetric: bool = False
    """Symmetric projection (Hairer 2000): perturbs the state before each step by the same amount by which it is
    projected after the step, so that a symmetric method remains reversible."""

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


@dataclass(frozen=True)
class OrName:
    """Adds the name alone, without options, to the JSON schema. `names`: the names that may stand alone."""

    names: tuple[str, ...]

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [{"enum": list(self.names), "type": "string"}, handler(core)]}


def named(given: object, names: Sequence[str], what: str) -> object:
    """Convert a name to a mapping with this name; raise SpecError if the value does not name one of `what`."""
    name = given.get("name") if isinstance(given, Mapping) else given
    if isinstance(name, str) and name in names:
        return {"name": name} if given is name else given
    if isinstance(given, Mapping) and "name" not in given:
        raise SpecError(f"is missing; it should be the name of a {what}: {listed(names, 'or')}", key="name")
    hint = did_you_mean(name, names) if isinstance(name, str) else ""
    message = f"should be {listed((repr(known) for known in names), 'or')}, not {value_text(name)}{hint}"
    raise SpecError(message, key="name" if isinstance(given, Mapping) else "")


def _plainly(chosen: object) -> object:
    return "none" if isinstance(chosen, NoStabilization) else chosen


#: Type of the key `stabilization` of a spec; its value is the string ``none``, or a model with options.
StabilizationChoice = Annotated[
    NoStabilization | Baumgarte | Projection,
    Field(discriminator="name"),
    BeforeValidator(lambda given: named(given, NAMES, "stabilization")),
    AfterValidator(_plainly),
    PlainSerializer(canonical),
    OrName(NAMES),
]


UNSTABILIZED: Any = "none"  #: Default value of the key `stabilization`.


def stabilization_of(choice: object) -> Stabilization:
    """Return a validated choice in the form that the engine uses."""
    return choice.chosen() if isinstance(choice, Baumgarte | Projection) else NONE
