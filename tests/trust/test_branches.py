"""Runs through singular positions: right, stopped, or flagged.

Expected: the cranks of the parallel linkages of `n-four-bar` stay parallel, so that all crank angles are equal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.slow_cases import slow
from tests.trust.flat_linkages import angle_between_cranks, flat_linkage

from .mechanisms import spec

ADAPTIVE = [
    ("dop853", {}), ("dopri5", {}),
    ("gauss", {"stages": 3}), ("radau-iia", {"stages": 3}), ("radau-iia", {"stages": 5}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "options", "n"),
    [*((*method, 1) for method in ADAPTIVE), *((*method, 2) for method in ADAPTIVE[:4]), *slow((*ADAPTIVE[4], 2))],
    ids=str,
)
def test_no_adaptive_run_leaves_its_branch_without_a_word(name: str, options: dict[str, Any], n: int) -> None:
    for rtol in (1e-4, 1e-6, 1e-8):
        run = flat_linkage(n, {"name": name, "adaptive": True, "rtol": rtol, **options})
        if run.status == "complete" and run.verdict in ("good", "unknown"):
            assert angle_between_cranks(run, n) < 0.05


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_dop853_passes_flat_positions_by_projections_that_are_counted(rtol: float) -> None:
    run = flat_linkage(2, {"name": "dop853", "adaptive": True, "rtol": rtol})
    run.check()
    assert angle_between_cranks(run, 2) < 0.05
    assert 0 < run.stats["projections"] < 0.5 * run.stats["steps"]


SLIDER = {
    "name": "mechanism", "gravity": [0.0, -9.81],
    "bodies": {
        "crank": {
            "mass": 1.426381237221054, "inertia": 0.11886510310175451,
            "position": [0.4609899031839262, 0.1936189793446768],
            "angle": 0.3976339291005861, "velocity": [1.642203403369396, -3.9099430773256234],
            "angular_velocity": -8.481624110030953,
        },
        "rod": {
            "mass": 1.6417345587627405, "inertia": 0.13681121323022838,
            "position": [1.3829697095517786, 0.1936189793446768], "angle": -0.3976339291005861,
            "velocity": [4.926610210108189, -3.9099430773256234], "angular_velocity": 8.481624110030953,
        },
        "sl": {
            "mass": 1.1693474735134624, "inertia": 1.0, "position": [1.8439596127357047, 0],
            "velocity": [6.568813613477584, 0],
        },
    },
    "joints": {
        "O": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], [-0.5, 0]]},
        "P": {"type": "revolute", "bodies": ["crank", "rod"], "points": [[0.5, 0], [-0.5, 0]]},
        "Q": {"type": "revolute", "bodies": ["rod", "sl"], "points": [[0.5, 0], [0, 0]]},
        "S": {"type": "prismatic", "bodies": ["ground", "sl"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
    },
}  # fmt: skip
"""A slider-crank with a crank as long as its rod, which is flat when both lie on the guide."""


@pytest.mark.parametrize("step", [0.00237, 0.00263, 0.0033])
def test_a_fixed_step_that_leaves_the_branch_is_flagged(step: float) -> None:
    # at 4.91 s the slider stops in the flat position; with the first step, crank and rod then turn together
    run = mbdkit.run(spec(SLIDER, {"name": "gauss", "stages": 2}, 5.0, step))
    is_right = abs(run["crank"].angle[-1] + run["rod"].angle[-1]) < 1e-3
    assert run.status == "failed" or run.verdict == "bad" or is_right
    if run.status == "complete" and not is_right:
        assert any("stabilization: projection" in reason for reason in run.verdict_reasons)


@pytest.mark.parametrize("speed", [1.5528041141845734, 0.773471146358595])
@pytest.mark.parametrize(("name", "stages"), [("radau-iia", 3), ("gauss", 3)])
def test_fixed_steps_through_flat_positions_are_right_or_flagged_or_stopped(
    speed: float, name: str, stages: int
) -> None:
    start = {"speed": speed, "angle": np.pi / 2}
    for step in (0.01161, 0.00475):
        run = flat_linkage(1, {"name": name, "stages": stages}, step, model=start)
        if run.status == "complete" and run.verdict in ("good", "unknown"):
            assert angle_between_cranks(run, 1) < 0.05


def test_a_swing_over_an_upright_position_is_no_turn_of_the_branch() -> None:
    # fast, but far from singular: joints of an open chain cannot become dependent
    run = mbdkit.run(
        spec({"name": "double-pendulum", "rates": [12.0, -9.0]}, {"name": "gauss", "stages": 3}, 5.0, 0.005)
    )
    run.check()
    assert run.verdict == "unknown"
