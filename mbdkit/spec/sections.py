"""The sections of a run spec that are the same for every model and method: time, output, limits."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from mbdkit.errors import SpecError
from mbdkit.mechanism.checks import check_name
from mbdkit.strict_model import StrictModel

QUANTITIES = ("constraints", "energy", "joints")


def _whole(value: Any) -> Any:
    """Take 1e6 for 1000000: people write large counts so."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, BeforeValidator(_whole), Field(ge=1, le=2**53)]
Positive = Annotated[float, Field(gt=0)]


class Section(StrictModel):
    """Base of the sections of a spec."""


class Time(Section):
    """When the run starts and ends, and its step; exactly one of `end` and `steps`."""

    start: float = 0.0
    """Start time [s]."""
    end: float | None = None
    """End time [s]; the run ends there exactly."""
    steps: Count | None = None
    """Number of steps of length `step`, instead of `end`."""
    step: Positive | None = None
    """Step [s]; an adaptive method takes it as its first step and can do without."""

    @model_validator(mode="after")
    def _consistent(self) -> Time:
        if self.end is not None and self.steps is not None:
            raise PydanticCustomError("mbdkit", "takes exactly one of `end` and `steps`, not both")
        if self.end is None and self.steps is None:
            raise PydanticCustomError("mbdkit", "needs `end` (a time in seconds) or `steps` (a number of steps)")
        if self.steps is not None and self.step is None:
            raise PydanticCustomError("mbdkit", "`steps` needs `step` (the length of one step in seconds) beside it")
        if self.end is not None and self.end <= self.start:
            raise SpecError(f"must be later than the start at {self.start!r}, not {self.end!r}", key="end")
        if not math.isfinite(self.final - self.start):
            raise PydanticCustomError("mbdkit", "is too long to be held in double precision")
        largest = max(abs(self.start), abs(self.final))
        if self.step is not None and largest + self.step / 2 == largest:
            raise SpecError(f"{self.step!r} is too small: the time would not move in double precision", key="step")
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
    """What is recorded, and how often; the start and the end always are."""

    every: Count | None = None
    """Record every so many steps; 1 unless `interval` is given."""
    interval: Positive | None = None
    """Record at this interval [s] instead; needs a method with dense output."""
    quantities: Literal["all"] | tuple[Literal["constraints", "energy", "joints"], ...] = "all"
    """Groups recorded beside trajectory, steps and stats."""

    @model_validator(mode="before")
    @classmethod
    def _normal(cls, data: Any) -> Any:
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
        """The groups recorded beside trajectory, steps and stats."""
        return frozenset(QUANTITIES if self.quantities == "all" else self.quantities)


class Event(Section):
    """What to watch for while the run goes on: an expression that crosses zero.

    Expressions are of t and of NAME.x, .y, .angle, .vx, .vy, .angular_velocity, .ax, .ay, .angular_acceleration of
    bodies, NAME.force, .force_x, .force_y, .torque, .misalignment, .angle of joints, and energy.kinetic, .potential,
    .total. What a body and a joint are both called is told apart as bodies.NAME and joints.NAME; names with other
    characters stand in quotes, as in joints["J 1"].force.
    """

    when: str
    """What crosses zero: an expression over the run, such as "knee.angle - 1.2"."""
    direction: Literal["any", "rising", "falling"] = "any"
    """Which crossings count: those from below, from above, or both."""
    action: Literal["note", "stop"] = "note"
    """Whether the crossing is noted, or ends the run as well, which is complete then."""


def named_events(events: dict[str, Event]) -> dict[str, Event]:
    """Return the events if their names are sane; raises SpecError."""
    for name in events:
        check_name(name, name)
    return events


class Limits(Section):
    """What stops a run early."""

    wall_time: Positive | None = None
    """Longest time that the run may take [s]; none by default."""
    max_steps: Count = 10_000_000
    """Largest number of steps."""
