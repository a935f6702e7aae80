"""Energy-conserving methods for mbdkit, with multipliers, in fixed steps."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name="discrete-gradient",
            summary="Gonzalez's discrete gradient: implicit, index 3, order 2, conserves energy, fixed steps.",
            options=Target("mbdkit_energy.methods:DiscreteGradientOptions"),
            create=Target("mbdkit_energy.methods:create_discrete_gradient"),
            claims=Target("mbdkit_energy.methods:claims_of_discrete_gradient"),
            references=Target("mbdkit_energy.methods:REFERENCES_OF_DISCRETE_GRADIENT"),
            dense_output=True,
        ),
        IntegratorPlugin(
            name="hbvm",
            summary="HBVM(k, s): line integrals, implicit, index 3, order 2 s, conserves energy, fixed steps.",
            options=Target("mbdkit_energy.methods:LineIntegralOptions"),
            create=Target("mbdkit_energy.methods:create_hbvm"),
            claims=Target("mbdkit_energy.methods:claims_of_hbvm"),
            references=Target("mbdkit_energy.methods:REFERENCES_OF_HBVM"),
            dense_output=True,
        ),
    ]
