"""Lobatto methods for mbdkit, given by tableaus."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = 1


def _integrator(kind: str, summary: str, options: str = "LobattoOptions") -> IntegratorPlugin:
    home = "mbdkit_lobatto.tableaus"
    return IntegratorPlugin(
        name=f"lobatto-iii{kind}",
        summary=f"Lobatto III{kind.upper()}: implicit, up to 6 stages, order 2 s - 2, {summary}, fixed steps.",
        options=Target(f"{home}:{options}", type),
        create=Target(f"{home}:create_{kind}"),
        claims=Target(f"{home}:claims_{kind}"),
        references=Target(f"{home}:REFERENCES", tuple),
    )


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    return [
        _integrator("a", "symmetric"),
        _integrator("b", "symmetric", "LobattoIIIBOptions"),
        _integrator("c", "L-stable"),
        _integrator("d", "symmetric, symplectic"),
    ]
