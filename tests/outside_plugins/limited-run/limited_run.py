"""A kind of specs: a run with a limit of the misalignment of its joints."""

from mbdkit.plugin import Positive, RunSpec, SpecKind, Target, hookimpl, loaded
from mbdkit.plugin.seams import spec_loader


class Spec(RunSpec):
    """A run spec with the section `closed_within`, the largest misalignment of a joint [m]."""

    closed_within: Positive


@spec_loader
def load(source, assignments=()):
    return loaded("limited-run", Spec, source, assignments, {})


@hookimpl
def mbdkit_items():
    return [
        SpecKind(
            name="limited-run",
            summary="A run whose misalignment has a limit.",
            marker="closed_within",
            command="mbdkit run",
            load=Target("limited_run:load"),
            run_kind="limited-run",
            model=Target("limited_run:Spec"),
        )
    ]
