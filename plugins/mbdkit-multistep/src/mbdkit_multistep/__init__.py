"""Linear multistep methods of variable order and step for mbdkit: BDF on index 1, 2 and ggl, Adams on index 1."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name="bdf",
            summary="Backward differentiation formulas of order 1 to 5: implicit, index 1, 2 and ggl, adaptive steps.",
            options=Target("mbdkit_multistep.bdf:BdfOptions"),
            create=Target("mbdkit_multistep.bdf:Bdf"),
            claims=Target("mbdkit_multistep.bdf:claims"),
            references=Target("mbdkit_multistep.bdf:REFERENCES"),
            dense_output=True,
        ),
        IntegratorPlugin(
            name="adams",
            summary="Adams-Bashforth-Moulton of order 1 to 12: explicit (PECE), index 1, adaptive steps.",
            options=Target("mbdkit_multistep.adams:AdamsOptions"),
            create=Target("mbdkit_multistep.adams:Adams"),
            claims=Target("mbdkit_multistep.adams:claims"),
            references=Target("mbdkit_multistep.adams:REFERENCES"),
            dense_output=True,
        ),
    ]
