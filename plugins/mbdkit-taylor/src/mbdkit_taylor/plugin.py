"""What this part adds to mbdkit: the integrator `taylor`."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

_HOME = "mbdkit_taylor.taylor"


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return Taylor series."""
    return [
        IntegratorPlugin(
            name="taylor",
            summary="Taylor series of any order: explicit, fixed or adaptive steps, for trees of revolute joints.",
            options=Target(f"{_HOME}:TaylorOptions", type),
            create=Target(f"{_HOME}:create"),
            claims=Target(f"{_HOME}:claims"),
            references=Target(f"{_HOME}:REFERENCES", tuple),
            dense_output=True,
            order=50,
        )
    ]
