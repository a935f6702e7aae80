"""`python -m tests.benchmarks.state_orders`: the orders of all methods on a mechanism with first-order states.

A leg swings under gravity, driven by a motor whose current is a first-order state, nonlinear and non-autonomous, and
the torque contains a second state, which filters the angle. The expected values are those of DOP853 in minimal
coordinates. Each order is fitted to the largest errors at half the time and at the end, of the smallest steps that are
above rounding errors. The third and fourth columns are the orders that the method claims for positions and velocities
of mechanisms without states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.spec import load_spec

END = 1.0
COUNTS = (2, 4, 6, 8, 10, 12, 14, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128, 192, 256)
"""Numbers of steps; all are even, so that half the time is the end of a step."""
FLOOR, CEILING = 1.5e-12, 1e-2
"""Errors below the first consist of rounding errors; those above the second say nothing about an order."""
FITTED = 4
"""Number of steps to which an order is fitted: the smallest ones whose errors are between these limits."""
LARGEST = 10
"""Orders above this one are shown, but not judged: too few steps are between long ones and rounding errors."""
LACK = 0.35
"""Largest difference between an order and the claimed one that is not marked."""
NAMES = "angle", "velocity", "states"

MODEL: dict[str, Any] = {
    "name": "mechanism",
    "bodies": {"leg": {"mass": 3.0, "inertia": 0.05, "position": [0.0, -0.2]}},
    "joints": {"hip": {"type": "revolute", "bodies": ["ground", "leg"], "points": [[0, 0], [0, 0.2]]}},
    "forces": {"motor": {"type": "torque", "body": "leg", "value": "2*states.i - 0.2*leg.angular_velocity + states.f"}},
    "states": {
        "i": {"rate": "6*sin(5*t) - 2*states.i - 0.1*states.i**3 - 0.4*leg.angular_velocity", "initial": 0.5},
        "f": {"rate": "3*(0.4*sin(leg.angle) - states.f)"},
    },
}


def rates(t: float, y: np.ndarray) -> list[float]:
    """Return the derivatives of angle, angular velocity and both states."""
    angle, speed, i, f = y
    torque = 2 * i - 0.2 * speed + f - 3 * 9.81 * 0.2 * np.sin(angle)
    return [
        speed,
        torque / (0.05 + 3 * 0.2**2),
        6 * np.sin(5 * t) - 2 * i - 0.1 * i**3 - 0.4 * speed,
        3 * (0.4 * np.sin(angle) - f),
    ]


def cases() -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Yield name, integrator and further sections of every case."""
    methods = [{"name": name} for name in ("rk-gill", "rk4", "dopri5", "dop853")]
    methods += [{"name": "gauss", "stages": stages} for stages in range(1, 7)]
    methods += [{"name": "gauss", "stages": 2, "stage_solver": "fixed-point"}]
    methods += [{"name": "radau-iia", "stages": stages} for stages in (2, 3, 5)]
    for method in methods:
        name = " ".join(str(value) for value in method.values())
        yield name, method, {}
        yield name, method, {"stabilization": "projection"}
        if "fixed-point" in name:
            continue
        if method["name"] == "gauss":
            yield name, method, {"stabilization": {"name": "projection", "symmetric": True}}
        if method["name"] == "radau-iia":
            for formulation in ("index-2", "index-3", "ggl"):
                yield name, method, {"formulation": formulation}


def errors(spec: dict[str, Any], exact: np.ndarray) -> np.ndarray:
    """Return the errors of angle, velocity and states; nan if the run fails."""
    run = mbdkit.run(spec)
    if run.status != "complete":
        return np.full(3, np.nan)
    rows = [len(run.time) // 2, -1]
    found = [run["leg"].angle, run["leg"].angular_velocity, *(run.states[name].value for name in "if")]
    lack = np.abs(np.array(found)[:, rows] - exact).max(axis=1)
    return np.array([lack[0], lack[1], lack[2:].max()])


def observed(integrator: dict[str, Any], sections: dict[str, Any], exact: np.ndarray) -> list[float]:
    """Return the orders of angle, velocity and states."""
    found: list[np.ndarray] = []
    for count in COUNTS:
        time = {"end": END, "step": END / count}
        found.append(errors({"mbdkit": 1, "model": MODEL, "integrator": integrator, "time": time, **sections}, exact))
        if found[-1].max() < FLOOR:
            break
    orders = []
    for column in np.array(found).T:
        some = [(math.log(n), math.log(x)) for n, x in zip(COUNTS, column, strict=False) if FLOOR < x < CEILING]
        orders.append(-float(np.polyfit(*zip(*some[-FITTED:], strict=True), 1)[0]) if len(some) > 2 else math.nan)
    return orders


def table() -> tuple[Table, int]:
    """Return the table, and the number of orders below those that are claimed."""
    exact = solve_ivp(
        rates, (0.0, END), [0.0, 0.0, 0.5, 0.0], method="DOP853", rtol=1e-13, atol=1e-15, t_eval=[END / 2, END],
        max_step=0.005,
    ).y  # fmt: skip
    shown, lacking = Table(title="observed orders with first-order states", width=100), 0
    for heading in ("method", "equations", "claimed q", "claimed v", *NAMES):
        shown.add_column(heading)
    for name, integrator, sections in cases():
        spec = load_spec({"mbdkit": 1, "model": MODEL, "integrator": integrator, "time": {"end": 1, "step": 0.1}})
        claimed = spec.claims.orders_on(sections.get("formulation", "index-1"))
        assert claimed is not None
        orders = observed(integrator, sections, exact)
        wanted = (claimed.positions, claimed.velocities, min(claimed.positions, claimed.velocities))
        marks = [
            " *" if p <= LARGEST and not order >= p - LACK else "" for order, p in zip(orders, wanted, strict=True)
        ]
        lacking += sum(map(bool, marks))
        told = " ".join(str(x if isinstance(x, str) else "symmetric projection") for x in sections.values())
        numbers = [f"{order:.2f}{mark}" for order, mark in zip(orders, marks, strict=True)]
        shown.add_row(name, told or "index-1", str(claimed.positions), str(claimed.velocities), *numbers)
    return shown, lacking


if __name__ == "__main__":
    console = Console()
    done, missing = table()
    console.print(done)
    console.print(f"{missing} orders are below the claimed ones (*); those above {LARGEST} are not judged")
    raise SystemExit(missing > 0)
