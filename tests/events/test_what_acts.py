"""Events of force elements, markers, travels and drivers, at times that are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism

OMEGA = 5.0
TIME = {"end": 1.0, "step": 0.01}


def oscillator() -> Mechanism:
    """Return a block of 2 kg on a slide along x that swings as 0.3 cos(5 t), and a driven wheel."""
    m = Mechanism(gravity=(0.0, -9.81))
    m.body("block", mass=2.0, inertia=0.1, position=(0.3, 0.0))
    m.body("wheel", mass=1.0, inertia=0.5)
    m.prismatic("slide", m.ground, "block", points=((0.0, 0.0), (0.0, 0.0)), axis=(-1.0, 0.0))
    m.spring_damper(
        "spring", m.ground, "block", points=((-2.0, 0.0), (0.0, 0.0)), stiffness=2.0 * OMEGA**2, free_length=2.0
    )
    m.revolute("hub", m.ground, "wheel", at=(0.0, 0.0))
    m.driver("motor", m.ground, "wheel", coordinate="angle", motion="sin(2*t)")
    m.marker("corner", "block", point=(0.1, 0.2))
    m.marker("rim", "wheel", point=(1.0, 0.0))
    return m


EXPECTED = {
    "forces.spring.value": math.pi / 2 / OMEGA,  # 50 (x - 0), zero with x
    "forces.spring.length - 2.15": math.acos(0.5) / OMEGA,
    "forces.spring.rate + 1": math.asin(1 / 1.5) / OMEGA,  # x' = -1.5 sin(5 t)
    "forces.spring.potential - 0.5625": math.acos(0.5) / OMEGA,  # 25 x^2
    "forces.spring.power - 0.5": None,  # -F x' = 22.5 sin cos
    "markers.corner.x": math.acos(-1 / 3) / OMEGA,
    "markers.rim.y - 0.5": math.asin(math.pi / 6) / 2,
    "markers.rim.vx + 0.5": None,
    "slide.angle": math.pi / 2 / OMEGA,  # the axis points to -x: the travel is -x
    "joints.slide.angle + 0.15": math.acos(0.5) / OMEGA,
    "motor.driver_power": math.pi / 4,  # -0.5 * 4 sin(2t) * 2 cos(2t) changes sign with the cosine
    "hub.force_first_y - 9": None,
    "slide.force_second_y - 19.62": None,
}


@pytest.mark.parametrize("when", [when for when, time in EXPECTED.items() if time is not None])
def test_an_event_is_found_at_its_time(when: str) -> None:
    events = {"seen": {"when": when}}
    with mbdkit.run(oscillator(), integrator={"name": "gauss", "stages": 4}, time=TIME, events=events) as run:
        assert run.events[0].time == pytest.approx(EXPECTED[when], abs=1e-10)


def test_expressions_are_worth_what_is_recorded() -> None:
    from mbdkit.events.watch import values_at_start
    from mbdkit.runs.preparation import build
    from mbdkit.spec import load_spec

    wanted = {f"e{number}": {"when": when} for number, when in enumerate(EXPECTED)}
    sections = {"integrator": {"name": "gauss", "stages": 4}, "time": {"end": 0.01, "step": 0.01}, "events": wanted}
    spec = load_spec(oscillator(), (), **sections)
    values = values_at_start(spec.watched(), build(spec)[0])
    with mbdkit.run(spec) as run:
        spring, slide, hub = run.forces["spring"], run.joints["slide"], run.joints["hub"]
        rim, corner, motor = run.markers["rim"], run.markers["corner"], run.joints["motor"]
        recorded = [
            spring.value[0],
            spring.length[0] - 2.15,
            spring.rate[0] + 1,
            spring.potential[0] - 0.5625,
            spring.power[0] - 0.5,
            corner.position[0, 0],
            rim.position[0, 1] - 0.5,
            rim.velocity[0, 0] + 0.5,
            slide.angle[0],
            slide.angle[0] + 0.15,
            motor.driver_power[0],
            hub.reaction_force_first[0, 1] - 9,
            slide.reaction_force_second[0, 1] - 19.62,
        ]
        np.testing.assert_array_equal(list(values.values()), recorded)
