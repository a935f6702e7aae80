"""Who reaches an end position to 1e-6 m and to 1e-9 m first, on the double pendulum released from the horizontal?"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from tests.witness.double_pendulum import HORIZONTAL

from .contenders import END, Contender, all_contenders
from .timing import Timing, duration, take_turns

TARGETS = (1e-6, 1e-9)
REPEATS = 9
LIMIT = 8.0  # s, that a single run may take in the search
FACTOR = 1.06
SEPARATOR = " at "


def error(contender: Contender, steps: int) -> tuple[float, float]:
    """Return the seconds of a run and the distance [m] of its end from the reference digits."""
    taken, (x, y) = contender(steps)
    reference = HORIZONTAL.ends[HORIZONTAL.at(END), 1]
    return taken, math.hypot(x - reference[0], y - reference[1])


def seconds(contender: Contender, steps: int) -> float:
    """Return the seconds of a run."""
    return contender(steps)[0]


def cheapest(contender: Contender, start: int, target: float) -> int | None:
    """Return the least number of steps that meets `target`, with the next two finer runs; None if that is too long."""

    def grow(steps: int, factor: float) -> int:
        return max(steps + 1, round(steps * factor))

    def meets(steps: int) -> bool | None:
        taken, miss = error(contender, steps)
        return None if taken > LIMIT else miss <= target

    coarse = start
    while (met := meets(coarse)) is False:
        coarse = grow(coarse, 2.0)
    if met is None:
        return None
    steps = max(start, coarse // 2)
    while True:
        run, finer = [], steps
        for _ in range(3):
            run.append(meets(finer))
            if not run[-1]:
                break
            finer = grow(finer, FACTOR)
        if None in run:
            return None
        if all(run):
            return steps
        steps = grow(finer, FACTOR)


def race(console: Console) -> None:
    """Print time, steps and error of every contender at its cheapest setting for each target."""
    contenders = all_contenders()
    chosen: dict[str, int] = {}
    tasks: dict[str, Callable[[], float]] = {}
    for name, (contender, start) in contenders.items():
        for target in TARGETS:
            steps = cheapest(contender, start, target)
            if steps is not None:
                key = f"{name}{SEPARATOR}{target:.0e}"
                chosen[key] = steps
                tasks[key] = functools.partial(seconds, contender, steps)
    timings = take_turns(tasks, REPEATS)
    for target in TARGETS:
        _show(console, target, contenders, chosen, timings)


def _show(
    console: Console,
    target: float,
    contenders: dict[str, tuple[Contender, int]],
    chosen: dict[str, int],
    timings: dict[str, Timing],
) -> None:
    def key(name: str) -> str:
        return f"{name}{SEPARATOR}{target:.0e}"

    done = sorted((name for name in contenders if key(name) in timings), key=lambda name: timings[key(name)].median)
    best = min(timings[key(name)].median for name in done if name.startswith("mbdkit"))
    table = Table(title=f"Double pendulum from the horizontal, 5 s: end of rod 2 to {target:.0e} m")
    table.add_column("method")
    for heading in ("steps", "error [m]", "median", "least ... most", "our fastest / this", "our same method / this"):
        table.add_column(heading, justify="right")
    for name in done:
        timing, steps = timings[key(name)], chosen[key(name)]
        miss = error(contenders[name][0], steps)[1]
        shown = f"tol 1e-{steps / 10:g}" if "scipy" in name else str(steps)
        spread = f"{duration(timing.least)} ... {duration(timing.most)}"
        own = timings.get(key("mbdkit " + name.split()[1].rstrip(",")))
        same = "" if own is None or name.startswith("mbdkit") else f"{own.median / timing.median:.3f}"
        table.add_row(name, shown, f"{miss:.1e}", duration(timing.median), spread, f"{best / timing.median:.3f}", same)
    left = [name for name in contenders if name not in done]
    table.caption = f"medians of {REPEATS}, taking turns" + (
        f"; not within {LIMIT:g} s a run: {', '.join(left)}" if left else ""
    )
    console.print(table)
