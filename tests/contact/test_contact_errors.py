"""Error bars of runs with rigid contacts, against motions by SciPy and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdkit
from mbdkit.archive.headlines import headlines
from tests.witness.bouncing import Discs, compared

FLOOR = {"line": {"normal": [0.0, 1.0]}}


@pytest.mark.parametrize(("method", "seed"), [("rk-gill", 0), ("dop853", 2)])
def test_estimated_errors_of_event_driven_runs_are_the_true_ones(method: str, seed: int) -> None:
    found = compared(Discs.drawn(np.random.default_rng(seed)), method, end=1.0)
    assert found.impacts >= 2
    assert found.known == 1.0
    assert len(found.ratios) > 50
    assert np.all((found.ratios > 0.8) & (found.ratios < 1.12))


def checked(model: dict[str, Any], treatment: str, method: str, step: float, end: float) -> mbdkit.Run:
    return mbdkit.run(
        {"mbdkit": 1, "model": {"name": "mechanism"} | model},
        integrator={"name": method},
        time={"end": end, "step": step},
        contact={"treatment": treatment},
        measures={"height": "final(body.y)"},
        check=True,
    )


def test_errors_of_time_stepping_are_known_from_an_event_driven_run() -> None:
    floor = {"bodies": ["ground", "body"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}], "restitution": 0.5}
    model = {"bodies": {"body": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 1.1]}}, "contacts": {"floor": floor}}
    run = checked(model, "time-stepping", "moreau-jean", 0.004, 0.6)
    first = np.sqrt(2.0 / 9.81)
    after = 0.6 - first
    true = 0.1 + 0.5 * 9.81 * first * after - 0.5 * 9.81 * after**2
    assert run.accuracy is not None
    assert run.accuracy.is_complete
    error = abs(run.array("trajectory/position")[-1, 0, 1] - true)
    assert 0.2 * error <= run.accuracy.position_error[-1, 0, 1] <= 5.0 * error


def test_errors_are_unknown_after_contacts_that_close_at_once() -> None:
    # the corners of a box reach the floor together; which is first decides how it rebounds
    box = [[-0.2, -0.05], [0.2, -0.05], [0.2, 0.05], [-0.2, 0.05]]
    floor = {"bodies": ["ground", "body"], "shapes": [FLOOR, {"polygon": box}], "restitution": 0.5}
    model = {"bodies": {"body": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 0.3]}}, "contacts": {"floor": floor}}
    run = checked(model, "event-driven", "rk4", 0.01, 0.4)
    assert run.accuracy is not None
    assert run.accuracy.known_until == pytest.approx(np.sqrt(2 * 0.25 / 9.81), abs=0.01)
    assert "contacts that affect each other close at once, in an unknown order" in run.accuracy.method
    assert np.isnan(run.measure_errors["height"])


def thrown(end: float, *, speed: float = 3.0, height: float = 0.2, e: float = 0.4, mu: float = 0.3) -> float:
    """Return how far a point mass gets that is thrown onto a floor: parabolas between infinitely many impacts."""
    g, time, x, rate, fall = 9.81, 0.0, 0.0, speed, np.sqrt(2 * 9.81 * height)
    flight = fall / g
    while flight > 1e-17:
        x, time = x + rate * flight, time + flight
        rate, fall, flight = rate - mu * (1 + e) * fall, e * fall, 2 * e * fall / g
    slides = min(end - time, rate / (mu * g))
    return float(x + rate * slides - mu * g * slides**2 / 2)


@pytest.mark.parametrize("rest_energy", [1e-12, 1e-4])
def test_the_friction_of_an_infinite_sequence_of_impacts_does_not_depend_on_where_it_is_cut(rest_energy: float) -> None:
    floor = {"bodies": ["ground", "puck"], "shapes": [FLOOR, {"point": [0, 0]}], "friction": 0.3, "restitution": 0.4}
    puck = {"mass": 4.0, "position": [0.0, 0.2], "velocity": [3.0, 0.0]}
    run = mbdkit.run(
        {"mbdkit": 1, "model": {"name": "mechanism", "bodies": {"puck": puck}, "contacts": {"floor": floor}}},
        integrator={"name": "dop853"},
        time={"end": 0.8, "step": 0.04},
        contact={"treatment": "event-driven", "rest_energy": rest_energy},
        measures={"x": "final(puck.x)"},
        check=rest_energy > 1e-9,
    )
    assert run.measures["x"] == pytest.approx(thrown(0.8), rel=1e-12)
    if rest_energy > 1e-9:
        assert run.accuracy is not None
        assert run.accuracy.known_until < 0.6
        assert np.isnan(run.measure_errors["x"])
        assert "bounces below contact.rest_energy are left out" in run.accuracy.method


@pytest.mark.parametrize(("step", "verdict"), [(0.003, "good"), (0.006, "doubtful"), (0.02, "bad")])
def test_errors_of_the_largest_normal_force_of_a_compliant_contact_count_in_the_verdict(
    step: float, verdict: str
) -> None:
    """A ball falls on a floor; at the turn, its weight has done the work of the force k d^1.5."""
    height, stiffness = 0.2, 1e6
    floor = {"bodies": ["ground", "body"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}]}
    floor["compliance"] = {"stiffness": stiffness}
    body = {"mass": 1.0, "inertia": 0.004, "position": [0.0, 0.1 + height]}
    model = {"name": "mechanism", "bodies": {"body": body}, "contacts": {"floor": floor}}
    run = mbdkit.run(
        {"mbdkit": 1, "model": model},
        integrator={"name": "gauss", "stages": 2},
        time={"end": 0.3, "step": step},
        check=True,
    )
    depth = brentq(lambda d: 9.81 * (height + d) - 0.4 * stiffness * d**2.5, 1e-4, 0.1)
    (force,) = headlines(run)
    assert abs(force.largest - stiffness * depth**1.5) <= 1.01 * (force.error - force.missed)
    assert run.verdict == verdict
    assert ("largest normal force of contact 'floor'" in " ".join(run.verdict_reasons)) == (verdict != "good")
