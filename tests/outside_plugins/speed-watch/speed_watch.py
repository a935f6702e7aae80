"""An attribute of runs, a line of their summary, headlines, and a command."""

from typing import Annotated

import numpy as np
from typer import Argument

from mbdkit.plugin import Accessor, Command, Run, SummaryLine, Target, hookimpl, show
from mbdkit.plugin.seams import run_attribute, summary_lines


@run_attribute
def peak_speeds(run: Run):
    return {name: float(np.hypot(*body.velocity[:, :2].T).max()) for name, body in run.bodies.items()}


@summary_lines
def lines(run: Run):
    speeds = peak_speeds(run) if len(run.time) else {}
    return [("speed-watch", f"{name} reaches {speed:.3g} m/s") for name, speed in speeds.items()]


def fastest(file: Annotated[str, Argument()]) -> None:
    """Print the fastest body of an archive."""
    import mbdkit

    with mbdkit.load(file) as run:
        speeds = peak_speeds(run)
    show(max(speeds, key=speeds.__getitem__))


@hookimpl
def mbdkit_items():
    return [
        Accessor(
            name="peak_speeds", summary="Largest speeds [m/s].", of="Run", target=Target("speed_watch:peak_speeds")
        ),
        SummaryLine(name="speed-watch", summary="Largest speeds.", text=Target("speed_watch:lines")),
        Command(name="fastest", summary="Print the fastest body of an archive.", target=Target("speed_watch:fastest")),
    ]
