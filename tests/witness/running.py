"""How the tests in this room run mbdkit: by a spec of plain values, to a complete run."""

from __future__ import annotations

from typing import Any

import mbdkit


def run(
    model: dict[str, Any], integrator: dict[str, Any], end: float, step: float | None = None, every: int = 1
) -> mbdkit.Run:
    """Run `model` with `integrator` from t = 0 to `end` [s] with `step` [s] and return the complete run in memory."""
    time: dict[str, Any] = {"end": end}
    if step is not None:
        time["step"] = step
    result: mbdkit.Run = mbdkit.run(
        {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "output": {"every": every}}
    )
    result.check()
    return result


def gauss(stages: int) -> dict[str, Any]:
    """Return the integrator of Gauss collocation with `stages` stages."""
    return {"name": "gauss", "stages": stages}
