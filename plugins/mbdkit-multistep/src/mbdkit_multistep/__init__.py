"""Linear multistep methods of variable order and step for mbdkit: BDF on index 1, 2 and ggl, Adams on index 1."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}

#: One line on each of the methods, by its name.
SUMMARIES = {
    "bdf": "Backward differentiation formulas of order 1 to 5: implicit, index 1, 2 and ggl, adaptive steps.",
    "adams": "Adams-Bashforth-Moulton of order 1 to 12: explicit (PECE), index 1, adaptive steps.",
}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name=name,
            summary=summary,
            options=Target(f"mbdkit_multistep.{name}:{name.capitalize()}Options"),
            create=Target(f"mbdkit_multistep.{name}:{name.capitalize()}"),
            claims=Target(f"mbdkit_multistep.{name}:claims"),
            references=Target(f"mbdkit_multistep.{name}:REFERENCES"),
            dense_output=True,
        )
        for name, summary in SUMMARIES.items()
    ]
