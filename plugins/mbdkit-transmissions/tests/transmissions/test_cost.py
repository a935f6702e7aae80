"""The cost of a constraint row that is a function of the pose, beside a built-in row of the same equation."""

from __future__ import annotations

import pytest

import mbdkit
from mbdkit import Mechanism

METHODS = ({"name": "rk4"}, {"name": "gauss", "stages": 2})


def chain(bodies: int, kind: str) -> Mechanism:
    """Return bodies at unit distances, which are free, or held by joints or by functions."""
    m, last = Mechanism(), "ground"
    for i in range(bodies):
        body = m.body(f"b{i}", mass=1.0, inertia=0.1, position=(i + 1.0, 0.0))
        if kind == "distance":
            m.distance(f"d{i}", last, body, points=((0, 0), (0, 0)), length=1.0)
        elif kind == "coupling":
            m.coupling(f"d{i}", last, body, equation="sqrt(x*x + y*y) - 1", unit="m")
        last = body
    return m


def test_both_rows_give_the_same_motion():
    spans = {"integrator": METHODS[0], "time": {"end": 0.5, "step": 0.005}}
    ends = [mbdkit.run(chain(4, kind), **spans)["b3"].position[-1] for kind in ("distance", "coupling")]
    assert ends[0] == pytest.approx(ends[1], abs=1e-13)


@pytest.mark.benchmark
def test_cost():
    """Print the shortest of 12 times per step, and the cost of a row without that of a free body."""
    for method in METHODS:
        for bodies in (1, 10, 40):
            spans = {"integrator": method, "time": {"end": 0.3, "step": 0.001}, "output": {"every": 300}}
            free, built_in, function = (
                1e6 / 300 * min(mbdkit.run(chain(bodies, kind), **spans).stats["wall_s"] for _ in range(12))
                for kind in ("free", "distance", "coupling")
            )
            rows = (function - free) / (built_in - free)
            print(f"{method['name']}, {bodies} rows: {free:.2f}, {built_in:.2f}, {function:.2f} us a step; {rows:.2f}")
