"""Half-explicit Runge-Kutta methods for mbdkit, on the index-2 equations, in fixed or adaptive steps."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name="hem4",
            summary="HEM4: half-explicit, index 2, 5 stages, order 4, fixed or adaptive steps.",
            options=Target("mbdkit.plugin.methods:ControlledOptions"),
            create=Target("mbdkit_half_explicit.methods:create_hem4"),
            claims=Target("mbdkit_half_explicit.methods:claims_of_hem4"),
            references=Target("mbdkit_half_explicit.methods:REFERENCES_OF_HEM4"),
            dense_output=True,
        ),
        IntegratorPlugin(
            name="hem5",
            summary="HEM5: half-explicit, index 2, 8 stages, order 5, fixed or adaptive steps.",
            options=Target("mbdkit.plugin.methods:ControlledOptions"),
            create=Target("mbdkit_half_explicit.methods:create_hem5"),
            claims=Target("mbdkit_half_explicit.methods:claims_of_hem5"),
            references=Target("mbdkit_half_explicit.methods:REFERENCES_OF_HEM5"),
            dense_output=True,
        ),
        IntegratorPlugin(
            name="phem56",
            summary="PHEM56: partitioned half-explicit, index 2, 6 stages, order 5, fixed or adaptive steps.",
            options=Target("mbdkit.plugin.methods:ControlledOptions"),
            create=Target("mbdkit_half_explicit.methods:create_phem56"),
            claims=Target("mbdkit_half_explicit.methods:claims_of_phem56"),
            references=Target("mbdkit_half_explicit.methods:REFERENCES_OF_PHEM56"),
            dense_output=True,
        ),
    ]
