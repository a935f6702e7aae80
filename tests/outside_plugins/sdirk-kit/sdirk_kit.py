"""The diagonally implicit method of Crouzeix with two stages, order 3: A-stable, but not L-stable."""

import mbdkit
from mbdkit.plugin import ImplicitOptions

G = "(1/2 + sqrt(3)/6)"
CROUZEIX = mbdkit.ButcherTableau(
    "crouzeix",
    a=[[G, 0], ["-sqrt(3)/3", G]],
    b=["1/2", "1/2"],
    c=[G, "1/2 - sqrt(3)/6"],
    order=3,
    reference="Crouzeix (1975)",
)


class Options(ImplicitOptions):
    pass


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "crouzeix",
            "Crouzeix's SDIRK method: two stages, order 3, A-stable.",
            Options,
            create=lambda options: options.method(CROUZEIX),
            claims=lambda options: mbdkit.Claims(order=3, stages=2, a_stable=True, states=True),
        )
    ]
