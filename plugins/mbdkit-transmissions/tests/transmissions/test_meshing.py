"""What is checked at the start is watched during the run: distances of gears, racks and belts, and ends of slots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit

BODY = {"mass": 1.0, "inertia": 0.01}
GAUSS = {"name": "gauss", "stages": 3}


def run(joint: dict[str, Any], *, second: dict[str, Any], moves: bool, **body: Any) -> mbdkit.Run:
    """Return a run in which `joint` connects a pinned body to one that is held by `second`, or moves freely."""
    model = {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"a": BODY, "b": {**BODY, **body}},
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0]},
            "G": {"bodies": ["a", "b"], **joint},
            **({} if moves else {"B": second}),
        },
    }
    spec = {"mbdkit": 1, "model": model, "integrator": GAUSS, "time": {"end": 0.5, "step": 0.01}}
    return mbdkit.run(spec, check=True)


PIN = {"type": "revolute", "bodies": ["ground", "b"], "at": [0.3, 0]}
SLIDE = {"type": "prismatic", "bodies": ["ground", "b"], "axis": [1, 0]}


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize(
    ("joint", "second", "body", "says"),
    [
        ({"type": "gear", "radii": [0.1, 0.2]}, PIN, {"position": [0.3, 0], "velocity": [0.2, 0]}, "0.4 m apart"),
        ({"type": "gear", "radii": [0.5, 0.2], "internal": True}, PIN, {"position": [0.3, 0], "velocity": [-0.1, 0]},
         "0.25 m apart"),
        ({"type": "belt", "radii": [0.1, 0.15]}, PIN, {"position": [0.3, 0], "velocity": [-0.4, 0]}, "0.1 m apart"),
        ({"type": "rack", "radius": 0.1, "points": [[0, 0], [0, -0.1]]}, {**SLIDE, "at": [0, 0.2]},
         {"position": [0, 0.2], "velocity": [0, 0.1]}, "0.15 m apart"),
    ],
)  # fmt: skip
def test_a_pair_whose_axes_part_is_doubtful(joint, second, body, says, moves):
    found = run(joint, second=second, moves=moves, **(body if moves else {**body, "velocity": [0, 0]}))
    doubts = [reason for reason in found.verdict_reasons if "joint 'G' has" in reason]
    assert bool(doubts) is moves
    if moves:  # the free body moves evenly, since nothing loads it
        assert says in doubts[0]
        assert found.verdict == "doubtful"


@pytest.mark.parametrize(("speed", "passes"), [(1.0, True), (-1.0, False)])
def test_a_pin_beyond_the_end_of_its_slot_is_doubtful(speed, passes):
    curve = {"y": {"table": [[-1.0, -0.5, 0.0, 0.3], [0.0, 0.0, 0.0, 0.0]]}}
    pin = {"mass": 1.0, "inertia": 1.0, "position": [0.0, 0.0], "velocity": [speed, 0.0]}
    joints = {"S": {"type": "slot", "bodies": ["ground", "p"], "curve": curve}}
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": {"p": pin}, "joints": joints}
    found = mbdkit.run({"mbdkit": 1, "model": model, "integrator": GAUSS, "time": {"end": 0.5, "step": 0.05}})
    np.testing.assert_allclose(found["p"].position[-1, 0], 0.5 * speed, rtol=1e-12)
    doubts = [reason for reason in found.verdict_reasons if "x = 0.5 m, beyond the end of the table" in reason]
    assert bool(doubts) is passes
