"""Inputs push a block on a rough floor: its path follows from Coulomb's law."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism

MASS, FRICTION = 2.0, 0.2
TABLE = [[0.0, 0.5], [10.0, -3.0]]
DRAG = FRICTION * MASS * 9.81


def block() -> Mechanism:
    m = Mechanism()
    m.body("block", mass=MASS, inertia=0.1, position=(0.0, 0.5))
    m.input("push", unit="N")
    m.force("hand", "block", value=("inputs.push", 0.0))
    square = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
    m.add(
        "contacts",
        "floor",
        bodies=("ground", "block"),
        shapes=[{"line": {"point": [0, 0], "normal": [0, 1]}}, {"polygon": square}],
        friction={"static": FRICTION, "kinetic": FRICTION},
        restitution=0.0,
    )
    return m


def exact() -> float:
    """Return where the block comes to rest: it slides on until friction and the input have stopped it, and sticks."""
    pushed, slowed = (10.0 - DRAG) / MASS, (3.0 + DRAG) / MASS
    speed = 0.5 * pushed
    return pushed * 0.5**2 / 2 + speed**2 / (2 * slowed)


@pytest.mark.parametrize(
    ("treatment", "integrator", "step", "tolerance"),
    [
        ("event-driven", {"name": "rk4"}, 0.01, 1e-12),
        ("event-driven", {"name": "gauss", "stages": 2}, 0.013, 1e-12),
        ("event-driven", {"name": "dop853", "adaptive": True}, None, 1e-12),
        ("event-driven", {"name": "scipy-radau"}, None, 1e-9),
        ("time-stepping", {"name": "moreau-jean"}, 0.001, 1e-5),
        ("time-stepping", {"name": "nonsmooth-generalized-alpha"}, 0.0013, 1e-5),
    ],
)
def test_a_pushed_block_slides_and_comes_to_rest(
    treatment: str, integrator: dict[str, Any], step: float | None, tolerance: float
) -> None:
    time = {"end": 1.0} if step is None else {"end": 1.0, "step": step}
    contact, inputs = {"treatment": treatment}, {"push": {"table": TABLE}}
    run = mbdkit.run(block(), integrator=integrator, time=time, inputs=inputs, contact=contact).check()
    assert run["block"].position[-1, 0] == pytest.approx(exact(), abs=tolerance)
    np.testing.assert_allclose(run["block"].velocity[-1], 0.0, atol=1e-12)
    assert run.inputs["push"].set.value.tolist() == TABLE[1]


def test_time_stepping_refuses_inputs_that_change_between_the_times_at_which_they_are_set() -> None:
    m = block()
    m.inputs["push"] = m.inputs["push"].model_copy(update={"hold": "linear"})
    with pytest.raises(mbdkit.SpecError, match=r"does not integrate first-order states \(inputs.push\)"):
        mbdkit.run(
            m,
            integrator={"name": "moreau-jean"},
            time={"end": 0.1, "step": 0.01},
            contact={"treatment": "time-stepping"},
        )
