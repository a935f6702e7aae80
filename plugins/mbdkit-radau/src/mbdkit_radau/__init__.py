"""Radau IIA of variable order for mbdkit: an implicit method with controlled steps on equations of index 1 to 3."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the method, whose code is imported when a spec names it."""
    return [
        IntegratorPlugin(
            name="radau-variable",
            summary="Radau IIA of variable order 5, 9, 13: implicit, L-stable, index 1 to 3, adaptive or fixed steps.",
            options=Target("mbdkit_radau.radau:RadauOptions"),
            create=Target("mbdkit_radau.radau:Radau"),
            claims=Target("mbdkit_radau.radau:claims"),
            references=Target("mbdkit_radau.coefficients:REFERENCES"),
            dense_output=True,
        )
    ]
