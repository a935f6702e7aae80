"""Generalized-alpha for mbdkit: an implicit method in fixed steps on the index-3 equations."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the method, whose code is imported when a spec names it."""
    return [
        IntegratorPlugin(
            name="generalized-alpha",
            summary="Generalized-alpha: implicit, index 3, order 2, adjustable high-frequency damping, fixed steps.",
            options=Target("mbdkit_generalized_alpha.generalized_alpha:GeneralizedAlphaOptions"),
            create=Target("mbdkit_generalized_alpha.generalized_alpha:GeneralizedAlpha"),
            claims=Target("mbdkit_generalized_alpha.generalized_alpha:claims"),
            references=Target("mbdkit_generalized_alpha.generalized_alpha:REFERENCES"),
        )
    ]
