"""The first number of every run: its largest kinetic energy."""

from mbdkit.plugin import HeadlineItem, Run, Target, hookimpl
from mbdkit.plugin.seams import run_headlines


@run_headlines
def largest(run: Run):
    label = "largest kinetic energy"
    value = float(run.energy.kinetic.max())
    yield {"label": label, "value": value, "unit": "J", "bar": (float("nan"),) * 2, "id": "energy-front"}


@hookimpl
def mbdkit_items():
    return [
        HeadlineItem(
            name="energy-front", summary="Largest energy.", take=Target("energy_front:largest"), group="energy"
        )
    ]
