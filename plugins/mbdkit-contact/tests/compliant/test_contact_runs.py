"""Runs with contacts: against SciPy and closed forms, and what archives, measures, events and pictures have of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import mbdkit
import mbdkit_contact
from mbdkit.archive.run import Run
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report.pages.run_tables import run_tables
from tests.margins import assert_within

G = 9.81
STIFF = {"stiffness": 1e9, "transition_speed": 1e-3}
DOPRI5 = {"name": "dopri5", "adaptive": True, "rtol": 1e-12, "atol": 1e-13}


def ball(**compliance: Any) -> Mechanism:
    m = Mechanism()
    m.body("ball", mass=1.0, position=(0.0, 1.0))
    m.contact(
        "floor", "ground", "ball", shapes=[{"line": {"normal": (0, 1)}}, {"point": (0, 0)}], compliance=compliance
    )
    return m


def run(m: Mechanism, end: float, integrator: dict[str, Any] = DOPRI5, step: float | None = None, **more: Any) -> Run:
    time = {"end": end} if step is None else {"end": end, "step": step}
    return mbdkit.run({"mbdkit": 1, "model": m.to_spec(), "time": time, "integrator": integrator, **more})


def test_a_bouncing_ball_moves_as_scipy_integrates_it(tmp_path: Path) -> None:
    # expected: DOP853 of SciPy on the equation of motion, with steps that do not jump over impacts
    def slope(t: float, y: np.ndarray) -> list[float]:
        force = 1e6 * max(0.0, -y[0]) ** 1.5 * max(0.0, 1.0 - 0.15 * y[1])
        return [y[1], force - G]

    wanted = solve_ivp(slope, (0.0, 1.5), [1.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-14, max_step=2e-3).y[:, -1]
    more: dict[str, Any] = {
        "measures": {"peak": "max(contacts.floor.normal_force)", "overlap": "-min(contacts.floor.gap)"},
        "events": {"touch": {"when": "contacts.floor.gap", "direction": "falling"}},
    }
    with run(ball(stiffness=1e6, dissipation=0.1), 1.5, **more) as done:
        height, speed = done["ball"].position[-1, 1], done["ball"].velocity[-1, 1]
        # two impacts enlarge errors: 6e-10 to 8e-10 on four processors, of which rounding in DOP853 is 2e-10
        np.testing.assert_allclose([height, speed], wanted, rtol=0, atol=3e-9)
        assert done.events.time[0] == pytest.approx(math.sqrt(2.0 / G), abs=1e-10)  # 0.451523640985731 s
        assert_within(done.energy.balance, 1e-9)  # what the impacts take is in the work
        assert done.energy.total[-1] < 0.9 * done.energy.total[0]
        floor, acceleration = done.contacts["floor"], done["ball"].acceleration[:, 1]
        np.testing.assert_allclose(floor.normal_force, acceleration + G, rtol=1e-12, atol=1e-11)
        np.testing.assert_array_equal(floor.mode == 0, floor.normal_force == 0)
        assert done.measures["peak"] >= floor.normal_force.max()
        assert floor.bodies == ("ground", "ball")
        assert "floor overlaps by up to" in done.summary()
    path = tmp_path / "ball.h5"
    spec = {"mbdkit": 1, "model": ball(stiffness=1e6).to_spec(), "time": {"end": 0.5}, "integrator": DOPRI5}
    mbdkit.run(spec, archive=path).close()
    with mbdkit.load(path) as stored:
        assert stored.contacts["floor"].gap[0] == 1.0
        assert stored.array("contacts/mode").shape == (len(stored.time), 1)


def test_the_largest_contact_force_does_not_depend_on_the_recorded_times() -> None:
    """The ball touches the floor between the recorded times. Without dissipation, it stops where m g (h + x) is
    the energy 2/5 k x^(5/2) of H. Hertz's law.
    """
    overlap = brentq(lambda x: 0.4 * 1e6 * x**2.5 - G * (1.0 + x), 1e-4, 0.1)
    force = "contacts.floor.normal_force"
    peaks = {"peak": f"max({force})", "upward": "max(ground_reactions.ball.force_y)", "magnitude": f"max(abs({force}))"}
    done = run(ball(stiffness=1e6), 1.0, output={"interval": 0.25}, measures=peaks)
    assert done.contacts["floor"].normal_force.max() == 0.0
    np.testing.assert_allclose(list(done.measures.values()), 1e6 * overlap**1.5, rtol=1e-7)


@pytest.mark.parametrize("dissipation", [0.0, 0.3])
def test_the_energy_lost_in_contacts_is_measured_as_the_guide_says(dissipation: float) -> None:
    # expected: friction stops the slip of a sliding ball, which takes 2/7 of the kinetic energy of its translation
    m = Mechanism()
    m.body("ball", mass=1.0, inertia=0.4 * 0.1**2, position=(0.0, 0.4), velocity=(0.3, 0.0))
    shapes = [{"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.1}}]
    m.contact("floor", "ground", "ball", shapes=shapes, friction=0.3, compliance=STIFF | {"dissipation": dissipation})
    guide = Path(mbdkit_contact.__file__).with_name("guide") / "contact.md"
    section = guide.read_text(encoding="utf-8").partition("## Energy lost in contacts")[2].partition("```yaml")[2]
    done = run(m, 0.35, **yaml.safe_load(section.partition("```")[0]))
    assert done.contacts["floor"].mode[-1] == 0
    lost, by_friction = done.measures["lost"], done.measures["by_friction"]
    assert lost == pytest.approx(done.energy.total[0] - done.energy.total[-1], abs=1e-9)
    assert by_friction == pytest.approx(0.5 * 0.3**2 * 2 / 7, rel=0.01)
    assert (lost == pytest.approx(by_friction, abs=1e-9)) == (dissipation == 0.0)


@pytest.mark.parametrize("treatment", ["compliant", "event-driven"])
def test_runs_list_the_times_at_which_a_contact_begins_rolls_and_ends(treatment: str) -> None:
    # expected: a fall from 50 mm, slip until 2/7 v0/(mu g), and a force that lifts the ball when it equals the weight
    m = Mechanism()
    m.body("ball", mass=1.0, inertia=0.4 * 0.1**2, position=(0.0, 0.15), velocity=(2.0, 0.0))
    m.force("crane", "ball", value=[0.0, "max(0, 100*(t - 0.4))"])
    shapes = [{"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.1}}]
    compliance = {"law": "linear", "stiffness": 1e6, "dissipation": 1e5, "transition_speed": 1e-3}
    kept = {"compliance": compliance} if treatment == "compliant" else {}
    m.contact("floor", "ground", "ball", shapes=shapes, friction=0.2, **kept)
    method = {"name": "radau-iia", "stages": 3, "adaptive": True} if kept else {"name": "dop853"}
    more = {"contact": {"treatment": treatment}, "events": {"rolls": {"when": "contacts.floor.mode - 1.5"}}}
    done = run(m, 0.55, method, step=0.01, **more)
    changes = done.contacts["floor"].transitions
    assert [(one.before, one.after) for one in changes] == [("open", "slip"), ("slip", "stick"), ("stick", "open")]
    times = [math.sqrt(0.1 / G), 2 / 7 * 2.0 / (0.2 * G), 0.4 + G / 100]
    # margin: resolution of the rows
    assert [one.time for one in changes] == pytest.approx(times, abs=1e-3 if kept else 0.012)  # of the rows
    assert done.events.time[done.events.direction < 0] == pytest.approx(times[1:2], abs=1e-3 if kept else 1e-9)
    (table,) = (one for one in run_tables(done) if one.name == "transitions")
    assert table.rows == tuple(("floor", *one) for one in changes)


def test_stiff_contacts_tend_to_a_rigid_impact() -> None:
    """Without dissipation, the ball is at its first height after 2 sqrt(2 h/g) and the duration of the contact, which
    H. Hertz found to be proportional to k^(-2/5); until then it still rises, at a speed proportional to this duration.
    """
    speeds = [run(ball(stiffness=k), 2.0 * math.sqrt(2.0 / G))["ball"].velocity[-1, 1] for k in (1e6, 1e8, 1e10)]
    assert speeds[0] / speeds[1] == pytest.approx(100**0.4, rel=0.01)
    assert speeds[1] / speeds[2] == pytest.approx(100**0.4, rel=0.01)


def incline(friction: float, transition: float) -> Mechanism:
    """A block of 1 kg on an incline of 30 degrees that moves upwards at 2 m/s."""
    m, turn = Mechanism(), math.pi / 6
    normal, stiffness = (-math.sin(turn), math.cos(turn)), 1e5
    depth = G * math.cos(turn) / stiffness
    position, velocity = (-depth * normal[0], -depth * normal[1]), (2.0 * math.cos(turn), 2.0 * math.sin(turn))
    m.body("block", mass=1.0, position=position, velocity=velocity)
    law = {"law": "linear", "stiffness": stiffness, "dissipation": 600.0, "transition_speed": transition}
    shapes = [{"line": {"normal": normal}}, {"point": (0, 0)}]
    m.contact("slope", "ground", "block", shapes=shapes, friction=friction, compliance=law)
    return m


def test_a_block_on_an_incline_slides_as_with_coulomb_friction_as_the_transition_speed_falls() -> None:
    # expected: closed form with friction 0.3: it stops at 0.268322655232618 s, slides back, and is there after 1 s; the
    # path is 0.899 m long
    wanted, errors = -0.362398577094839, []
    for transition in (0.04, 0.02, 0.01):
        done = run(incline(0.3, transition), 1.0, {"name": "radau-iia"}, 2e-3)
        x, y = done["block"].position[-1]
        errors.append(abs(x * math.cos(math.pi / 6) + y * math.sin(math.pi / 6) - wanted))
    assert ", slips 0.9 m" in done.summary()
    assert errors[2] < 0.002
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=0.03)


def test_a_block_on_a_rough_incline_sticks() -> None:
    # expected: friction of 0.7 holds it with m g sin(30 degrees) = 4.905 N, and it creeps at that share of the speed
    with run(incline(0.7, 0.01), 0.5, {"name": "radau-iia"}, 2e-3) as done:
        slope = done.contacts["slope"]
        assert slope.friction_force[-1] == pytest.approx(4.905, rel=1e-9)
        assert slope.slip[-1] == pytest.approx(-0.01 * math.tan(math.pi / 6) / 0.7, rel=1e-6)
        assert slope.mode[-1] == 1


def test_a_pendulum_whose_pin_has_clearance_moves_as_scipy_integrates_it() -> None:
    # expected: DOP853 of SciPy; the eccentric journal presses against the wall with Lankarani and Nikravesh's force
    mass, inertia, arm, room, radius, stiffness, mu, transition = 2.0, 0.05, 0.3, 0.02, 0.015, 1e7, 0.2, 0.05
    factor = 0.75 * (1.0 - 0.8**2) / 0.5

    def slope(t: float, y: np.ndarray) -> list[float]:
        px, py = -arm * math.sin(y[2]), arm * math.cos(y[2])  # from the centre of mass to the journal
        ex, ey = y[0] + px, y[1] + py
        distance = math.hypot(ex, ey)
        depth, fx, fy, moment = distance - (room - radius), 0.0, 0.0, 0.0
        if depth > 0.0:
            ux, uy = ex / distance, ey / distance
            cx, cy = px + (radius - depth / 2) * ux, py + (radius - depth / 2) * uy
            vx, vy = y[3] - y[5] * cy, y[4] + y[5] * cx
            push = stiffness * depth**1.5 * max(0.0, 1.0 + factor * (vx * ux + vy * uy))
            slip = vx * -uy + vy * ux
            drag = -push * mu * max(-1.0, min(1.0, slip / transition))
            fx, fy = -push * ux - drag * uy, -push * uy + drag * ux
            moment = cx * fy - cy * fx
        return [*y[3:], fx / mass, fy / mass - G, moment / inertia]

    start = [0.0, -arm * math.cos(0.5), 0.5]
    start[0] = arm * math.sin(0.5)  # the journal is in the middle
    accurate: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "max_step": 5e-4}
    given = solve_ivp(slope, (0.0, 0.5), [*start, 0.0, 0.0, 0.0], **accurate)
    m = Mechanism()
    m.body("arm", mass=mass, inertia=inertia, position=(start[0], start[1]), angle=0.5)
    law = {"law": "lankarani-nikravesh", "stiffness": stiffness, "impact_speed": 0.5, "transition_speed": transition}
    shapes = [{"hole": {"radius": room}}, {"circle": {"center": (0.0, arm), "radius": radius}}]
    m.contact("pin", "ground", "arm", shapes=shapes, friction=mu, restitution=0.8, compliance=law)
    with run(m, 0.5) as done:
        x, y, angle = given.y[:3, -1]
        np.testing.assert_allclose([*done["arm"].position[-1], done["arm"].angle[-1]], [x, y, angle], atol=1e-9)
        eccentricity = math.hypot(x - arm * math.sin(angle), y + arm * math.cos(angle))
        assert done.contacts["pin"].gap[-1] == pytest.approx(room - radius - eccentricity, abs=1e-9)


@pytest.mark.parametrize(("integrator", "order"), [({"name": "rk4"}, 4), ({"name": "gauss", "stages": 2}, 4)])
def test_methods_keep_their_order_in_a_smooth_contact(integrator: dict[str, Any], order: int) -> None:
    m = Mechanism()
    m.body("ball", mass=1.0, inertia=0.01, position=(0.0, 0.098), velocity=(0.4, -0.1), angular_velocity=1.0)
    law = {"law": "smooth-sphere-half-space", "stiffness": 1e5, "dissipation": 1.0, "transition_speed": 2.0}
    shapes = [{"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.1}}]
    m.contact("floor", "ground", "ball", shapes=shapes, friction=0.5, compliance=law)
    ends = [run(m, 0.1, integrator, 0.1 / n)["ball"].position[-1] for n in (100, 200, 1600)]
    errors = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)
