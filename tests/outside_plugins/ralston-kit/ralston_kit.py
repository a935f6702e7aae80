"""Ralston's explicit method of order 3, with the least bound of the error of three stages."""

from pydantic import BaseModel

import mbdkit

RALSTON = mbdkit.ButcherTableau(
    "ralston3",
    a=[[], ["1/2"], [0, "3/4"]],
    b=["2/9", "1/3", "4/9"],
    c=[0, "1/2", "3/4"],
    order=3,
    reference="Ralston (1962), doi:10.1090/S0025-5718-1962-0150954-0",
)
DENSE = ((1, -7 / 9), (0, 1 / 3), (0, 4 / 9))  # of order 2 within a step


class Options(BaseModel):
    pass


def create(options: Options) -> mbdkit.ExplicitRungeKutta:
    return mbdkit.ExplicitRungeKutta(RALSTON, mbdkit.EmbeddedPair.without_error(RALSTON, DENSE))


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "ralston3",
            "Ralston's method: explicit, order 3.",
            Options,
            create=create,
            claims=lambda options: mbdkit.Claims(order=3, stages=3, dense_order=2, states=True),
            dense_output=True,
        )
    ]
