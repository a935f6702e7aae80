"""Lobatto methods for mbdkit, given by tableaus."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}

#: Properties of each of the methods, by the last letter of its name.
PROPERTIES = {"a": "symmetric", "b": "symmetric", "c": "L-stable", "d": "symmetric, symplectic"}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    code = "mbdkit_lobatto.tableaus"
    return [
        IntegratorPlugin(
            name=f"lobatto-iii{kind}",
            summary=f"Lobatto III{kind.upper()}: implicit, up to 6 stages, order 2 s - 2, {properties}, fixed steps.",
            options=Target(f"{code}:{'LobattoIIIBOptions' if kind == 'b' else 'LobattoOptions'}"),
            create=Target(f"{code}:create_{kind}"),
            claims=Target(f"{code}:claims_{kind}"),
            references=Target(f"{code}:REFERENCES"),
        )
        for kind, properties in PROPERTIES.items()
    ]
