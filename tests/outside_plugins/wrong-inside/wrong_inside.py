"""Kutta's method of order 3, which claims order 2 within steps, but interpolates linearly."""

from pydantic import BaseModel

import mbdkit

KUTTA = mbdkit.ButcherTableau(
    "kutta3-linear", a=[[], ["1/2"], [-1, 2]], b=["1/6", "2/3", "1/6"], c=[0, "1/2", 1], order=3, reference="Kutta"
)
DENSE = ((1 / 6,), (2 / 3,), (1 / 6,))


class Options(BaseModel):
    pass


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "kutta3-linear",
            "Kutta's method: explicit, order 3.",
            Options,
            create=lambda options: mbdkit.ExplicitRungeKutta(KUTTA, mbdkit.EmbeddedPair.without_error(KUTTA, DENSE)),
            claims=lambda options: mbdkit.Claims(order=3, stages=3, dense_order=2, states=True),
            dense_output=True,
        )
    ]
