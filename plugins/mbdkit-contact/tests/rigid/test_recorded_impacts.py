"""Impulses and energies of impacts that event-driven runs record, and impulses that joints share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.rigid.random_contacts import PILES, STEP, computed, drawn
from tests.rigid.scenes import FLOOR, G, run

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit_contact.events_of_contacts import ContactEvents
from mbdkit_contact.kernels.event_bundle import KEPT_STRIKES, MORE_ROOM
from tests.margins import assert_within


@pytest.mark.parametrize("method", ["rk4", "dopri5", "gauss", "scipy-dop853"])
def test_a_sliding_point_loses_the_energy_of_each_impact_until_their_infinite_sequence_ends(method: str) -> None:
    # expected: impacts at t_n = t_0 (1 + 2 e + ... + 2 e^n) with t_0^2 = 2 h / g and normal velocities e^n g t_0, and
    # friction impulses of mu times the normal ones. At the end of the sequence, there is an impact without impulses.
    height, e, mu, slip, mass = 0.5, 0.25, 0.3, 6.0, 2.0
    bodies = {"b": {"mass": mass, "position": [0.0, height], "velocity": [slip, 0.0]}}
    contact = {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0.0, 0.0]}], "restitution": e, "friction": mu}
    found = run({"bodies": bodies, "contacts": {"floor": contact}}, 1.0, 0.05, method=method)
    fall, n = math.sqrt(2.0 * height / G), np.arange(len(found.impacts.time) - 1)
    times = fall * (1.0 + 2.0 * e * (1.0 - e**n) / (1.0 - e))
    normal = mass * (1.0 + e) * G * fall * e**n
    slips = slip - mu * np.cumsum([0.0, *normal]) / mass
    lost = 0.5 * mass * ((1.0 - e * e) * (G * fall * e**n) ** 2 + slips[:-1] ** 2 - slips[1:] ** 2)
    close = {"rel": 1e-6, "abs": 1e-12}
    assert found.impacts.time == pytest.approx([*times, fall * (1.0 + e) / (1.0 - e)], abs=1e-9)
    assert found.impacts.normal_impulse == pytest.approx([*normal, 0.0], **close)
    assert found.impacts.tangential_impulse == pytest.approx([*-mu * normal, 0.0], **close)
    assert found.impacts.energy_lost == pytest.approx([*lost, 0.0], **close)
    assert_within(found.energy.balance, 1e-6)


def test_impacts_record_no_impulses_that_are_rounding_errors() -> None:
    # expected: an impulse changes the velocity of its contact by more than 1e-10 of the largest velocity so far, and
    # the effective mass of a contact is more than a tenth of that of a body. In this pile, contacts that stay closed
    # have impulses of 1e-16 N s at impacts of others.
    model = drawn(1, PILES)
    found = computed(model, "event-driven", STEP, end=0.45)
    masses = [body["mass"] for body in model["bodies"].values()]
    speed = math.sqrt(2.0 * np.max(found.energy.kinetic) / sum(masses))
    impulses = found.impacts.normal_impulse
    assert len(impulses) > 10
    assert np.min(impulses[impulses != 0.0]) > 1e-12 * min(masses) * speed


def events_of_a_ball() -> ContactEvents:
    bodies = {"b": {"mass": 1.0, "position": [0.0, 0.0]}}
    contacts = {"floor": {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0.0, 0.0]}]}}
    model = {"name": "mechanism", "bodies": bodies, "contacts": contacts}
    spec = {"mbdkit": 1, "model": model, "contact": {"treatment": "event-driven"}, "integrator": {"name": "rk4"}}
    return ContactEvents(EquationsOfMotion.of(mbdkit.RunSpec(**spec, time={"end": 1.0, "step": 0.1}).mechanism()))


def test_impacts_without_impulses_make_room_for_more_when_there_is_none_left() -> None:
    events = events_of_a_ball()
    room = len(events.bundle.closed.chosen)
    events.bundle.known.number[:] = 0, KEPT_STRIKES
    events.bundle.reason[0] = MORE_ROOM
    events.resume()
    assert events.bundle.known.number.tolist() == [0, 0]
    assert events.impacts == []
    assert len(events.bundle.closed.chosen) == room


TILT = np.radians(30.0)


def impulses_of(found: mbdkit.Run) -> dict[str, np.ndarray]:
    """Return the impulses (2,) of all joints on their second bodies at the first impact [N s]."""
    impacts = found.impacts
    return {str(name): impacts.reaction_impulse[0, i] for i, name in enumerate(impacts.joint)}


def test_two_pins_in_one_place_share_the_impulse_of_a_rod_that_strikes() -> None:
    # expected: a rod that is released from the horizontal and strikes the floor at 30 degrees, by its angular momentum
    # about the pins; each pin has half of what its linear momentum asks of both
    mass, length, e = 2.0, 0.6, 0.5
    about_pins, rate = mass * length**2 / 3.0, np.sqrt(3.0 * G * np.sin(TILT) / length)
    pin: dict[str, Any] = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0.0, length * np.sin(TILT)]}
    model = {
        "bodies": {
            "rod": {"mass": mass, "inertia": mass * length**2 / 12.0, "position": [length / 2, length * np.sin(TILT)]}
        },
        "joints": {"first": pin, "second": pin},
        "contacts": {
            "tip": {"bodies": ["ground", "rod"], "shapes": [FLOOR, {"point": [length / 2, 0.0]}], "restitution": e}
        },
    }
    found = run(model, 0.5, 0.01)
    push = about_pins * (1.0 + e) * rate / (length * np.cos(TILT))
    gain = mass * (1.0 + e) * rate * length / 2 * np.array([np.sin(TILT), np.cos(TILT)])
    assert found.impacts.normal_impulse[0] == pytest.approx(push, rel=1e-9)
    for impulse in impulses_of(found).values():
        assert impulse == pytest.approx(0.5 * (gain - [0.0, push]), rel=1e-9)


def test_pins_at_both_ends_of_a_bar_share_the_impulse_along_it_equally() -> None:
    # expected: a disc that falls on a bar at 30 degrees and rolls on from there. The lever rule determines the impulses
    # of both pins across the bar. Along it, momenta determine only their sum
    half, place, radius, drop = 0.5, 0.2, 0.1, 0.3
    along, across = np.array([np.cos(TILT), np.sin(TILT)]), np.array([-np.sin(TILT), np.cos(TILT)])
    start = place * along + radius * across + np.array([0.0, drop])
    model = {
        "bodies": {
            "bar": {"mass": 1.0, "inertia": 0.1, "angle": float(TILT)},
            "disc": {"mass": 3.0, "inertia": 1.5 * radius**2, "position": start.tolist()},
        },
        "joints": {
            "low": {"type": "revolute", "bodies": ["ground", "bar"], "at": (-half * along).tolist()},
            "high": {"type": "revolute", "bodies": ["ground", "bar"], "at": (half * along).tolist()},
        },
        "contacts": {
            "top": {"bodies": ["bar", "disc"], "shapes": [FLOOR, {"circle": {"radius": radius}}], "friction": 5.0}
        },
    }
    found = run(model, 0.5, 0.01)
    momentum = 3.0 * np.sqrt(2.0 * G * drop)
    push, rub = momentum * np.cos(TILT), momentum * np.sin(TILT) / 3.0  # a disc keeps 2/3 of its speed
    shares = {"low": 0.5 * (1.0 - place / half), "high": 0.5 * (1.0 + place / half)}
    for name, impulse in impulses_of(found).items():
        assert impulse == pytest.approx(shares[name] * push * across + 0.5 * rub * along, rel=1e-9)
