"""Error bars of runs with rigid contacts, against motions by SciPy and closed forms, and doubts about their bodies."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar
from tests.rigid.scenes import FLOOR, outline, run

import mbdkit
from mbdkit import Mechanism
from mbdkit.archive.headlines import headlines
from mbdkit.spec import example_names, load_spec
from mbdkit_contact.contact_criteria import rolling_point_masses
from tests.margins import assert_within
from tests.witness.bouncing import Discs, compared


@pytest.mark.parametrize(("method", "seed"), [("rk-gill", 0), ("dop853", 2)])
def test_estimated_errors_of_event_driven_runs_are_the_true_ones(method: str, seed: int) -> None:
    found = compared(Discs.drawn(np.random.default_rng(seed)), method, end=1.0)
    assert found.impacts >= 2
    assert found.known == 1.0
    assert len(found.ratios) > 50
    assert np.all((found.ratios > 0.8) & (found.ratios < 1.12))


def checked(model: dict[str, Any], treatment: str, method: str, step: float, end: float) -> mbdkit.Run:
    return run(model, end, step, treatment, method, measures={"height": "final(body.y)"}, check=True)


def test_errors_of_time_stepping_are_known_from_an_event_driven_run() -> None:
    floor = {"bodies": ["ground", "body"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}], "restitution": 0.5}
    model = {"bodies": {"body": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 1.1]}}, "contacts": {"floor": floor}}
    found = checked(model, "time-stepping", "moreau-jean", 0.004, 0.6)
    first = np.sqrt(2.0 / 9.81)
    after = 0.6 - first
    true = 0.1 + 0.5 * 9.81 * first * after - 0.5 * 9.81 * after**2
    assert found.accuracy is not None
    assert found.accuracy.is_complete
    error = abs(found.array("trajectory/position")[-1, 0, 1] - true)
    assert 0.2 * error <= found.accuracy.position_error[-1, 0, 1] <= 5.0 * error


def test_errors_of_the_largest_normal_force_of_event_driven_runs_are_the_true_ones() -> None:
    # a rod of 1 m and 3 kg slides on a floor without friction: (I + m h^2) w' = m h w^2 s/2 - m g h with h = cos(a)/2
    def rates(_: float, y: np.ndarray) -> list[float]:
        h, s = 0.5 * np.cos(y[0]), 0.5 * np.sin(y[0])
        return [y[1], 3.0 * h * (s * y[1] ** 2 - 9.81) / (0.25 + 3.0 * h**2)]

    motion = solve_ivp(rates, (0.0, 0.5), [0.6, 2.0], "DOP853", rtol=1e-12, atol=1e-12, dense_output=True).sol

    def pull(t: float) -> float:
        y = motion(t)
        return -3.0 * (9.81 + 0.5 * (np.cos(y[0]) * rates(t, y)[1] - np.sin(y[0]) * y[1] ** 2))

    true = -minimize_scalar(pull, bounds=(0.05, 0.25), method="bounded", options={"xatol": 1e-9}).fun
    rod = {"mass": 3.0, "inertia": 0.25, "position": [0.0, 0.5 * np.sin(0.6)], "angle": 0.6, "angular_velocity": 2.0}
    rod["velocity"] = [0.0, np.cos(0.6)]
    floor = {"bodies": ["ground", "body"], "shapes": [FLOOR, {"point": [-0.5, 0.0]}]}
    found = run({"bodies": {"body": rod}, "contacts": {"floor": floor}}, 0.5, 0.01, method="rk4", check=True)
    (largest,) = headlines(found)
    error = largest.bar.upper
    assert 0.0 < error < 1e-7 * true
    assert abs(largest.value - true) == pytest.approx(error, rel=0.12)


def test_errors_are_unknown_after_contacts_that_close_at_once() -> None:
    # the corners of a box reach the floor together; which is first decides how it rebounds
    floor = {"bodies": ["ground", "body"], "shapes": [FLOOR, outline(0.2, 0.05)], "restitution": 0.5}
    model = {"bodies": {"body": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 0.3]}}, "contacts": {"floor": floor}}
    found = checked(model, "event-driven", "rk4", 0.01, 0.4)
    assert found.accuracy is not None
    # margin: resolution of the rows
    assert found.accuracy.known_until == pytest.approx(np.sqrt(2 * 0.25 / 9.81), abs=0.01)
    assert "contacts that affect each other close at once, in an unknown order" in found.accuracy.method
    assert np.isnan(found.measure_errors["height"])


def test_largest_forces_have_no_bar_after_contacts_that_close_at_once() -> None:
    found = mbdkit.run("slider-crank-guide", check=True)
    assert found.accuracy is not None
    assert not found.accuracy.is_complete
    force = [one for one in headlines(found) if one.quantity == "contacts.normal_force"]
    assert len(force) == 2
    assert not any(one.bar.is_known for one in force)


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
    treatment = {"treatment": "event-driven", "rest_energy": rest_energy}
    found = run(
        {"bodies": {"puck": puck}, "contacts": {"floor": floor}}, 0.8, 0.04, contact=treatment,
        measures={"x": "final(puck.x)"}, check=rest_energy > 1e-9,
    )  # fmt: skip
    assert found.measures["x"] == pytest.approx(thrown(0.8), rel=1e-12)
    if rest_energy > 1e-9:
        assert found.accuracy is not None
        assert found.accuracy.known_until < 0.6
        assert np.isnan(found.measure_errors["x"])
        assert "bounces below contact.rest_energy are left out" in found.accuracy.method


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
    more = {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 0.3, "step": step}}
    found = mbdkit.run({"mbdkit": 1, "model": model}, **more, check=True)
    depth = brentq(lambda d: 9.81 * (height + d) - 0.4 * stiffness * d**2.5, 1e-4, 0.1)
    (force,) = headlines(found)
    # margin: an error bar of mbdkit, which is the deviation itself for small steps
    assert_within(force.value - stiffness * depth**1.5, 1.01 * force.bar.upper)
    assert found.verdict == verdict
    assert ("largest normal force of contact 'floor'" in " ".join(found.verdict_reasons)) == (verdict != "good")


def test_no_packaged_example_has_one() -> None:
    assert not [finding for name in example_names("run") for finding in rolling_point_masses(load_spec(name))]


@pytest.mark.parametrize(("inertia", "friction", "count"), [(None, 0.3, 1), (0.004, 0.3, 0), (None, 0.0, 0)])
def test_friction_that_cannot_turn_a_disc_without_inertia_is_told(
    inertia: float | None, friction: float, count: int
) -> None:
    m = Mechanism()
    m.body("disc", mass=1.0, inertia=inertia, position=(0, 0.1))
    m.contact(
        "floor", m.ground, "disc", shapes=[{"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.1}}], friction=friction
    )
    spec: Any = SimpleNamespace(mechanism=lambda: m)
    told = [finding.sentence for finding in rolling_point_masses(spec)]
    assert len(told) == count
    assert all("the friction of contact 'floor' does not turn its circle of 0.1 m" in text for text in told)
