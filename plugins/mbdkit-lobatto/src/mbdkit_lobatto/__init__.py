"""Lobatto methods for mbdkit, given by tableaus."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the methods, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name="lobatto-iiia",
            summary="Lobatto IIIA: implicit, up to 6 stages, order 2 s - 2, symmetric, fixed steps.",
            options=Target("mbdkit_lobatto.tableaus:LobattoOptions"),
            create=Target("mbdkit_lobatto.tableaus:create_a"),
            claims=Target("mbdkit_lobatto.tableaus:claims_a"),
            references=Target("mbdkit_lobatto.tableaus:REFERENCES"),
        ),
        IntegratorPlugin(
            name="lobatto-iiib",
            summary="Lobatto IIIB: implicit, up to 6 stages, order 2 s - 2, symmetric, fixed steps.",
            options=Target("mbdkit_lobatto.tableaus:LobattoIIIBOptions"),
            create=Target("mbdkit_lobatto.tableaus:create_b"),
            claims=Target("mbdkit_lobatto.tableaus:claims_b"),
            references=Target("mbdkit_lobatto.tableaus:REFERENCES"),
        ),
        IntegratorPlugin(
            name="lobatto-iiic",
            summary="Lobatto IIIC: implicit, up to 6 stages, order 2 s - 2, L-stable, fixed steps.",
            options=Target("mbdkit_lobatto.tableaus:LobattoOptions"),
            create=Target("mbdkit_lobatto.tableaus:create_c"),
            claims=Target("mbdkit_lobatto.tableaus:claims_c"),
            references=Target("mbdkit_lobatto.tableaus:REFERENCES"),
        ),
        IntegratorPlugin(
            name="lobatto-iiid",
            summary="Lobatto IIID: implicit, up to 6 stages, order 2 s - 2, symmetric, symplectic, fixed steps.",
            options=Target("mbdkit_lobatto.tableaus:LobattoOptions"),
            create=Target("mbdkit_lobatto.tableaus:create_d"),
            claims=Target("mbdkit_lobatto.tableaus:claims_d"),
            references=Target("mbdkit_lobatto.tableaus:REFERENCES"),
        ),
    ]
