"""A direct-current motor, whose current is a first-order state, as a third party would write it."""

from __future__ import annotations

import sympy as sp
from pydantic import BaseModel

from mbdkit import ExpressionLaw, ForceLawPlugin

rate, time, voltage, resistance, inductance, constant, current = sp.symbols(
    "rate time voltage resistance inductance constant current"
)


class Motor(BaseModel):
    voltage: float = 12.0
    resistance: float = 1.0
    inductance: float = 0.1
    constant: float = 0.5
    current: float = 0.0


MOTOR = ForceLawPlugin(
    "motor",
    "A direct-current motor between two bodies.",
    Motor,
    ExpressionLaw(
        -constant * current,
        rates={"current": ((voltage - resistance * current - constant * rate) / inductance, "A")},
    ),
    ("@misc{test}",),
)

ALTERNATING = ForceLawPlugin(
    "alternating-motor",
    "The motor at an alternating voltage, with a resistance that grows with the current.",
    Motor,
    ExpressionLaw(
        -constant * current,
        rates={
            "current": (
                (voltage * sp.sin(5 * time) - resistance * (current + current**3 / 10) - constant * rate) / inductance,
                "A",
            )
        },
    ),
    ("@misc{test}",),
)
