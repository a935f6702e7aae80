"""The packaged examples with contacts do what their comments say; see also `tests.models.test_examples`."""

import numpy as np
import pytest

from mbdkit.spec import example_names, load_spec
from tests.models.example_runs import of_all_bodies, ran


def test_the_examples_of_this_part_are_packaged():
    own = {"belt", "bouncing-ball", "sit-down", "slider-crank-clearance", "walker"}
    assert own <= set(example_names("run"))


def test_walker_walks_in_the_limit_cycle_of_its_source():
    # expected: Garcia et al. (1998), table 1, massless feet: step 3.812092 + 1.579129 slope^(2/3), stance angle
    # 0.970956 slope^(1/3) - 0.270837 slope, and what the slope gives is lost in each impact
    slope, legs = 0.009, ("left", "right")
    run = ran("walker")
    times, lost = run.impacts.time, run.impacts.energy_lost
    stride = run["right"].position[0, 0] + 2 * (run["left"].position[0, 0] - run["right"].position[0, 0])
    mass = sum(body.mass for body in load_spec("walker").mechanism().bodies.values())
    weight = mass * 9.81 * np.array([np.sin(slope), -np.cos(slope)])
    needed = of_all_bodies(run, "walker", "acceleration") - weight
    force = sum(run.ground_reactions[leg].force for leg in legs)
    np.testing.assert_allclose(force, needed, rtol=0, atol=1e-7)
    pressure = run.ground_reactions["left"].center_of_pressure
    stones = np.unique(np.round(pressure[np.isfinite(pressure[:, 0]), 0] / stride, 6))
    assert run.impacts.contact.tolist() == ["second.2", "third.2"]
    steps = np.diff([0.0, *times]) * np.sqrt(9.81)
    assert steps == pytest.approx(np.full(2, 3.812092 + 1.579129 * slope ** (2 / 3)), rel=1e-3)
    assert steps == pytest.approx(np.full(2, np.mean(steps)), rel=1e-6)
    assert 0.5 * stride == pytest.approx(np.sin(0.970956 * slope ** (1 / 3) - 0.270837 * slope), rel=5e-3)
    assert lost == pytest.approx(np.full(2, weight[0] * stride), rel=1e-5)
    assert stones == pytest.approx([0.0, 2.0], abs=1e-5)  # footfalls of the left foot
