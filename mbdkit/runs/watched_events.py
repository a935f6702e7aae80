"""Detection of the events of a spec during a run."""

from __future__ import annotations

from mbdkit.engine.workspace import Workspace
from mbdkit.events.watch import Watch, Watched
from mbdkit.integrators.interface import Stepper
from mbdkit.spec import RunSpec


def watch_events(spec: RunSpec, workspace: Workspace, stepper: Stepper, *, all_events: bool = True) -> Watch:
    """Wrap a stepper so that it detects the events of a spec, or only those events that set states."""
    settings = spec.settings()
    events = [
        Watched(name, expression, spec.events[name].direction, spec.events[name].action, settings.get(name, {}))
        for name, expression in spec.watched().items()
        if all_events or name in settings
    ]
    return Watch(stepper, workspace, events)
