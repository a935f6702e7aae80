"""The point up to which an open run advances before it pauses."""

from __future__ import annotations

from bisect import bisect_left

from mbdkit.integrators.interface import Goal, Timetable, on_grid
from mbdkit.integrators.run.splitting import margin_of_stops

#: Largest distance from the end of a fixed step, as a share of the step, at which a time counts as equal to it.
ON_GRID = 1e-9


def goal_at(table: Timetable, t: float, passed: int, *, is_fixed: bool) -> Goal:
    """Return the goal of a run for a time [s].

    Parameters
    ----------
    table
        Times of the run; later times than its end stand for its end.
    t
        The time. Times that are equal up to rounding to the end of a fixed step or to a stop stand for these.
    passed
        Number of stops that the run has passed.
    is_fixed
        Whether steps have a fixed size.
    """
    if is_fixed:
        assert table.step is not None
        n = round((t - table.start) / table.step)
        end = table.start + n * table.step
        if n < table.steps and abs(end - t) <= ON_GRID * table.step:
            return Goal(end, end, n)
    close = margin_of_stops(table)
    if t >= table.end - close:
        return Goal(table.end, table.end)
    if table.interval is not None:
        t = on_grid(t, table.start, table.interval, table.end)
    number = bisect_left(table.stops, t - close, lo=passed)
    if number < len(table.stops) and table.stops[number] <= t + close:
        return Goal(table.stops[number], table.stops[number] - table.stop_margins[number])
    return Goal(t, t, pause=t)
