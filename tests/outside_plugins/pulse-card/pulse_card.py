"""A record of pulses that notebooks show as a table."""

from typing import NamedTuple

from mbdkit.plugin import HtmlView, Target, ViewItem, hookimpl
from mbdkit.plugin.reports import Table, View, columns_of, object_view


class Pulse(NamedTuple):
    """Time [s] and impulse [N s] of a pulse."""

    time: float
    impulse: float


class Pulses(HtmlView):
    """Pulses of a load."""

    def __init__(self, *pulses: Pulse) -> None:
        self.pulses = pulses


@object_view
def view(pulses: Pulses) -> View:
    table = Table("pulses", "Pulses", columns_of("time [s]; impulse [N s]"), pulses.pulses)
    return View("Pulses <of a load>", (f"{len(pulses.pulses)} pulses",), "", tables=(table,))


@hookimpl
def mbdkit_items():
    return [ViewItem(name="pulses", summary="Pulses.", of="pulse_card:Pulses", make=Target("pulse_card:view"))]
