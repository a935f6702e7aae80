"""Dry friction below its transition speed is viscous, and a run says so."""

from __future__ import annotations

import pytest

import mbdkit
from tests.runs.slow_pin import pin


def test_friction_of_a_pin_that_turns_more_slowly_than_its_transition_speed_is_doubtful() -> None:
    # expected: the slip decays exponentially from a share x = 0.8 of the transition speed, so that the work of friction
    # is x/2 = 40 % of that of Coulomb friction
    run = mbdkit.run(pin(0.01))
    (told,) = run.verdict_reasons
    assert run.verdict == "doubtful"
    assert "joint 'knee' is weaker than Coulomb friction, because 100% of its path" in told
    assert "transition speed of 0.01 m/s (fastest slip 0.008 m/s, at 1 rad/s), and lacks 60% of its work" in told
    assert "lower model.joints.knee.friction.transition_speed" in told


def test_friction_that_reaches_its_transition_speed_until_the_stop_is_not_told() -> None:
    # expected: Coulomb friction of 0.64 N m stops the body after J w^2 / (2 M)
    run = mbdkit.run(pin(1e-4))
    assert run.warnings == []
    assert run["leg"].angle[-1] == pytest.approx(0.46 / (2 * 0.64), rel=1e-3)


def test_a_step_that_fails_where_a_joint_stops_advises_adaptive_steps() -> None:
    run = mbdkit.run(pin(1e-5))
    assert "use an implicit method with `adaptive: true`" in run.status_reason


@pytest.mark.parametrize(("share", "count"), [(0.5, 1), (1.5, 0)], ids=["sticks", "slides"])
def test_a_compliant_contact_that_creeps_instead_of_sticking_is_doubtful(share: float, count: int) -> None:
    # expected: below the friction of 0.5 m g, a block creeps by share * 0.01 m/s * 3 s, 1.5 % of the size of 1 m
    shapes = [{"line": {"normal": [0, 1]}}, {"circle": {"radius": 0.1}}]
    compliance = {"stiffness": 1e6, "dissipation": 1.0}
    model = {
        "name": "mechanism",
        "bodies": {"block": {"mass": 1.0, "inertia": 0.01, "position": [0, 0.0999]}},
        "joints": {"upright": {"type": "driver", "bodies": ["ground", "block"], "coordinate": "angle", "motion": 0}},
        "contacts": {
            "floor": {"bodies": ["ground", "block"], "shapes": shapes, "friction": 0.5, "compliance": compliance}
        },
        "forces": {"push": {"type": "force", "body": "block", "value": [share * 0.5 * 9.81, 0]}},
    }
    integrator, time = {"name": "radau-iia"}, {"end": 3.0, "step": 0.005}
    run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time})
    assert ["contact 'floor' is weaker than Coulomb" in one for one in run.warnings] == [True] * count
