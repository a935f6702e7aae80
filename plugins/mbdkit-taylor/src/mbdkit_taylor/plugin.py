"""What this part adds to mbdkit: the integrator `taylor`."""

from __future__ import annotations

from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.items import IntegratorPlugin
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return Taylor series."""
    return [
        IntegratorPlugin(
            name="taylor",
            summary="Taylor series of any order: explicit, fixed or adaptive steps, for trees of revolute joints.",
            options=Target("mbdkit_taylor.taylor:TaylorOptions"),
            create=Target("mbdkit_taylor.taylor:create"),
            claims=Target("mbdkit_taylor.taylor:claims"),
            references=Target("mbdkit_taylor.taylor:REFERENCES"),
            dense_output=True,
            order=50,
        )
    ]
