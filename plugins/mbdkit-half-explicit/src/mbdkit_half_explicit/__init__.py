"""Half-explicit Runge-Kutta methods for mbdkit, on the index-2 equations, in fixed or adaptive steps."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}

#: What each of the methods is.
KINDS = {
    "hem4": "half-explicit, index 2, 5 stages, order 4",
    "hem5": "half-explicit, index 2, 8 stages, order 5",
    "phem56": "partitioned half-explicit, index 2, 6 stages, order 5",
}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    code = "mbdkit_half_explicit.methods"
    return [
        IntegratorPlugin(
            name=name,
            summary=f"{name.upper()}: {kind}, fixed or adaptive steps.",
            options=Target("mbdkit.plugin.methods:ControlledOptions"),
            create=Target(f"{code}:create_{name}"),
            claims=Target(f"{code}:claims_of_{name}"),
            references=Target(f"{code}:REFERENCES_OF_{name.upper()}"),
            dense_output=True,
        )
        for name, kind in KINDS.items()
    ]
