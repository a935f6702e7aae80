"""What a program has set in an open simulation, from which the run can be repeated without it."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.engine.compiled_mechanism import CompiledInput
from mbdkit.engine.input_schedule import InputSchedule, Setting
from mbdkit.spec import RunSpec


class InputHistory:
    """The values of inputs that a program has set, and the times at which steps ended for it.

    - `inputs`: the inputs of the mechanism.
    - `given`: their schedules in the spec, as far as the spec has them; the program cannot set these inputs.
    - `start`: start of the run [s].
    - `pauses`: times at which steps of an adaptive method have ended for the program [s].
    """

    def __init__(self, inputs: Sequence[CompiledInput], given: Sequence[InputSchedule], start: float):
        self._inputs, self._given, self._start = tuple(inputs), tuple(given), start
        self._pending: dict[int, float] = {}
        # points of the table of each input, and the inputs that change linearly until the next call
        self._times: list[list[float]] = [[] for _ in inputs]
        self._values: list[list[float]] = [[] for _ in inputs]
        self._ramps: set[int] = set()
        self.pauses: list[float] = []

    def set(self, number: int, value: float) -> None:
        """Let an input have a value from the next advance on; raise SpecError if it cannot have it."""
        item = self._inputs[number]
        try:
            given = float(value)
        except (TypeError, ValueError, OverflowError):
            raise self._refused(item, f"should be a number, not {value!r}") from None
        if not math.isfinite(given):
            raise self._refused(item, f"should be a finite number, not {given!r}")
        if item.bounds is not None and not item.bounds[0] <= given <= item.bounds[1]:
            low, high = item.bounds
            raise self._refused(item, f"{given!r} {item.unit} is outside of its bounds, {low!r} to {high!r}")
        if self._given and self._given[number].times:
            raise self._refused(item, "follows the table of the spec, so that a program cannot set it")
        self._pending[number] = given

    def _refused(self, item: CompiledInput, message: str) -> SpecError:
        return SpecError(message, key=f"inputs.{quoted(item.name)}")

    def value(self, number: int) -> float | None:
        """Return the value that an input was set to; None if the program has not set it."""
        if number in self._pending:
            return self._pending[number]
        return self._values[number][-1] if self._values[number] else None

    @property
    def is_pending(self) -> bool:
        """Whether first-order states of inputs change before the next step."""
        return bool(self._pending or self._ramps)

    def changes(self, now: float, until: float) -> dict[int, float]:
        """Return the first-order states that change now [s], by index; linear inputs reach their values at `until`."""
        changed: dict[int, float] = {}
        for number in sorted({*self._pending, *self._ramps}):
            item, times, values = self._inputs[number], self._times[number], self._values[number]
            before = values[-1] if values else item.initial
            after = self._pending.get(number, before)
            was_ramp = number in self._ramps
            self._ramps.discard(number)
            if after == before and not was_ramp:
                continue
            changed[item.state] = before if item.is_linear else after
            if not item.is_linear:
                times.append(now)
                values.append(after)
                continue
            changed[item.slope] = 0.0
            if after != before:
                if not times or times[-1] != now:
                    times.append(now)
                    values.append(before)
                times.append(until)
                values.append(after)
                changed[item.slope] = (after - before) / (until - now)
                self._ramps.add(number)
        self._pending.clear()
        return changed

    def start_schedules(self) -> tuple[InputSchedule, ...]:
        """Return the schedules that determine the inputs at the start of the run."""
        given = self._given or (InputSchedule(),) * len(self._inputs)
        return tuple(
            InputSchedule((self._start,), (values[0],), (self._slope(number),))
            if times and times[0] == self._start
            else given[number]
            for number, (times, values) in enumerate(zip(self._times, self._values, strict=True))
        )

    def _slope(self, number: int) -> float:
        times, values = self._times[number], self._values[number]
        is_ramp = self._inputs[number].is_linear and len(times) > 1
        return (values[1] - values[0]) / (times[1] - times[0]) if is_ramp else 0.0

    def recorded_spec(self, spec: RunSpec, end: float, step: float | None) -> RunSpec:
        """Return the spec of the run, which ends at `end` [s], with what was set; `step` is its first step."""
        tables = {
            item.name: {"table": [times, values]}
            for item, times, values in zip(self._inputs, self._times, self._values, strict=True)
            if times
        }
        time = spec.time
        stops = sorted({stop for stop in (*time.stops, *self.pauses) if stop < end})
        if not tables and end == time.final and stops == sorted(time.stops):
            return spec
        kept = {name: value for name, value in (("start", time.start), ("step", step)) if value is not None}
        given = spec.sections()
        sections = {"inputs": {**given["inputs"], **tables}, "time": {**kept, "end": end, "stops": stops}}
        return type(spec)(**(given | sections))

    def settings(self, after: int, end: float, *, is_over: bool) -> list[Setting]:
        """Return what was set before `end` [s] in order of time, without the first `after` settings.

        If the run is over, these are followed by the last values of inputs that change linearly at its end.
        """
        found, last = [Setting(self._start, number, self._at_start(number)) for number in range(len(self._inputs))], []
        for number, item in enumerate(self._inputs):
            points = self._times[number], self._values[number]
            of_program = InputSchedule.of(*points, is_linear=item.is_linear)
            schedule = of_program if of_program.times or not self._given else self._given[number]
            settings = zip(schedule.times, schedule.values, strict=True)
            found += [Setting(t, number, value) for t, value in settings if self._start < t < end]
            index = bisect_left(schedule.times, end) - 1
            if is_over and index >= 0 and schedule.slopes[index]:
                last.append(Setting(end, number, schedule.at(index, end)))
        return [*sorted(found, key=lambda setting: (setting.time, setting.number)), *last][after:]

    def _at_start(self, number: int) -> float:
        schedule = self.start_schedules()[number]
        index = schedule.last(self._start)
        return self._inputs[number].initial if index < 0 else schedule.at(index, self._start)

    def stored(self) -> dict[str, list[Any]]:
        """Return the history as plain data; what is pending is part of it."""
        return {
            "times": [[*times] for times in self._times],
            "values": [[*values] for values in self._values],
            "ramps": sorted(self._ramps),
            "pauses": [*self.pauses],
            "pending": [[number, value] for number, value in self._pending.items()],
        }

    def restore(self, stored: Mapping[str, list[Any]]) -> None:
        """Return to a stored history; raise LookupError, TypeError or ValueError if it is not valid."""
        times, values = ([[float(x) for x in row] for row in stored[name]] for name in ("times", "values"))
        if [*map(len, times)] != [*map(len, values)] or len(times) != len(self._inputs):
            raise ValueError("it has other inputs")
        self._times, self._values = times, values
        self._ramps = {int(number) for number in stored["ramps"]}
        self.pauses = [float(t) for t in stored["pauses"]]
        self._pending = {int(number): float(value) for number, value in stored["pending"]}
