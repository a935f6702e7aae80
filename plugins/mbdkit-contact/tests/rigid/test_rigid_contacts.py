"""Rigid contacts, event-driven and by time-stepping, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.rigid.scenes import FLOOR, G, ball, block, outline, run
from tests.rigid.states_of_contacts import gaps_in, rows_in

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.runs.preparation import caution
from mbdkit.spec import load_spec
from mbdkit_contact.kernels.active_set import new_active_set, solve_active_set
from mbdkit_contact.kernels.impacts import new_strike, stronge
from mbdkit_contact.kernels.mode_path import solve_by_path
from mbdkit_contact.kernels.pivoting import new_cones
from mbdkit_contact.rigid_contacts import RigidContacts
from mbdkit_report.pages.run_tables import run_tables
from tests.margins import assert_within
from tests.witness.pit import pit


@pytest.mark.parametrize(("e", "end"), [(0.5, 1.354570922957193), (0.8, 4.063712768871579)])
def test_a_ball_comes_to_rest_when_its_impacts_accumulate(e: float, end: float) -> None:
    # expected: sqrt(2 h / g), and that time (1 + e) / (1 - e)
    found = run(ball(e), 1.2 * end, 0.05)
    assert found.impacts.time[0] == pytest.approx(0.451523640985731, abs=1e-12)
    assert found.impacts.time[-1] == pytest.approx(end, abs=1e-9)
    assert found.impacts.normal_impulse[0] == pytest.approx(2.0 * (1 + e) * np.sqrt(2 * G), rel=1e-12)
    assert np.sum(found.impacts.energy_lost[:-1]) == pytest.approx(2.0 * G, rel=1e-11)
    assert found.contacts["floor"].normal_force[-1] == pytest.approx(2.0 * G, rel=1e-12)
    assert found["ball"].acceleration[-1] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert "an infinite sequence of impacts was cut off at 'floor'" in found.warnings[0]
    assert found.verdict == "unknown"


@pytest.mark.parametrize("height", [0.0, 0.2])
@pytest.mark.parametrize("method", [{"name": "gauss"}, {"name": "dopri5", "adaptive": True, "rtol": 1e-8}])
def test_a_ball_rests_and_rolls_where_rounding_errors_of_positions_hide_its_last_bounces(
    method: dict[str, object], height: float
) -> None:
    # expected: the speed of rolling after sliding, v / (1 + I / (m r^2)), 1000 km above the origin
    far, radius, inertia = 1e6, 0.1, 0.004
    ground = {"line": {"point": [0.0, far], "normal": [0.0, 1.0]}}
    floor = {"bodies": ["ground", "ball"], "shapes": [ground, {"circle": {"radius": radius}}]}
    start = {"position": [0.0, far + radius + height], "velocity": [0.5, 0.0]}
    model = {
        "name": "mechanism",
        "bodies": {"ball": {"mass": 1.0, "inertia": inertia, **start}},
        "contacts": {"floor": {**floor, "friction": 0.3, "restitution": 0.5}},
    }
    time = {"end": 1.0} if method.get("adaptive") else {"end": 1.0, "step": 0.005}
    spec = {"mbdkit": 1, "model": model, "contact": {"treatment": "event-driven"}, "integrator": method, "time": time}
    with mbdkit.run(spec) as found:
        assert found.status == "complete"
        rolling = 0.5 / (1.0 + inertia / radius**2)
        np.testing.assert_allclose(found["ball"].velocity[-1], [rolling, 0.0], atol=1e-9)
        assert found["ball"].position[-1, 1] - far == pytest.approx(radius, abs=1e-9)


def test_a_journal_that_falls_in_its_bearing_comes_to_rest_at_the_bottom() -> None:
    # expected: closed form of a ball that falls by the clearance, from the middle of the bearing
    clearance, e = 5e-4, 0.5
    fall = (2.0 * clearance / G) ** 0.5
    shapes = [{"hole": {"radius": 0.01}}, {"circle": {"radius": 0.01 - clearance}}]
    contacts = {"bearing": {"bodies": ["ground", "journal"], "shapes": shapes, "restitution": e, "friction": 0.3}}
    bodies = {"journal": {"mass": 1.0, "inertia": 1e-4}}
    with run({"name": "mechanism", "bodies": bodies, "contacts": contacts}, 0.06, 1e-3) as found:
        assert found.impacts.time[0] == pytest.approx(fall, abs=1e-12)
        assert found.impacts.time[-1] == pytest.approx(fall * (1 + e) / (1 - e), abs=1e-9)
        assert found["journal"].position[-1, 1] == pytest.approx(-clearance, abs=1e-9)
        assert found.contacts["bearing"].normal_force[-1] == pytest.approx(G, rel=1e-9)


def test_measures_do_not_interpolate_across_impacts() -> None:
    # expected: the parabolas between the impacts, of which each is half as fast as the one before
    measures = {"low": "min(ball.y)", "fast": "max(abs(ball.vy))", "area": "integral(ball.y - 0.1)"}
    found = run(ball(0.5), 2.0, 0.05, measures=measures)
    first = np.sqrt(2.0 / G)
    area = first * 2.0 / 3.0 + sum((G * first * 0.5**k) ** 3 / (1.5 * G**2) for k in range(1, 40))
    assert found.measures == pytest.approx({"low": 0.1, "fast": np.sqrt(2 * G), "area": area}, rel=1e-10)


def test_a_step_with_an_impact_has_no_overlap_that_its_ends_lack() -> None:
    """Between the ends of a step that contains an impact, positions of time-stepping methods are linear."""
    found = run(ball(0.5), 1.0, 0.01, "time-stepping", measures={"least": "min(contacts.floor.gap)"})
    assert found.measures["least"] == pytest.approx(found.contacts["floor"].gap.min(), abs=1e-12)
    assert "contact force of a step with an impact includes its impulse" in found.summary()


def test_simultaneous_impacts_lose_their_energy_once() -> None:
    # expected: m g h (1 - e^2) for each of two balls that fall side by side
    one = ball(0.5)
    bodies = {name: one["bodies"]["ball"] | {"position": [x, 1.1]} for name, x in (("left", -1.0), ("right", 1.0))}
    contacts = {f"{name} floor": one["contacts"]["floor"] | {"bodies": ["ground", name]} for name in bodies}
    impacts = run({"bodies": bodies, "contacts": contacts}, 0.6, 0.05).impacts
    assert len(impacts) == 2
    assert impacts.total_energy_lost == pytest.approx(2 * 1.5 * G, rel=1e-11)


def along(found: mbdkit.Run) -> np.ndarray:
    return found["block"].position @ [np.cos(np.radians(30.0)), np.sin(np.radians(30.0))]


def test_a_block_on_an_incline_stops_and_slides_back() -> None:
    # expected: decelerations g (sin 30 + mu cos 30) upwards, g (sin 30 - mu cos 30) downwards
    found = run(block(0.3), 1.0, 0.05)
    assert along(found)[-1] == pytest.approx(-0.362398577094839, abs=1e-12)
    assert found.contacts["incline.0"].mode[[2, -1]].tolist() == [2.0, 2.0]
    assert_within(found.energy.balance, 1e-12)


def test_a_block_with_more_friction_stays() -> None:
    found = run(block(0.7), 0.5, 0.05)
    rows = found.contacts["incline.0"], found.contacts["incline.1"]
    assert sum(row.friction_force[-1] for row in rows) == pytest.approx(4.905, abs=1e-10)
    assert [row.mode[-1] for row in rows] == [1.0, 1.0]
    assert all(row.friction_force[-1] <= 0.7 * row.normal_force[-1] * (1 + 1e-9) for row in rows)
    assert found["block"].velocity[-1] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_block_on_a_belt_sticks_and_slips() -> None:
    # expected: m = k = 1, v = 0.2, friction 1 N static and 0.5 N kinetic
    contact = {
        "bodies": ["belt", "block"],
        "shapes": [{"line": {"point": [0.0, 0.1], "normal": [0, 1]}}, {"point": [0.0, 0.0]}],
        "friction": {"static": 1.0 / G, "kinetic": 0.5 / G},
    }
    belt = {"mass": 1.0, "inertia": 1.0, "position": [0.0, -0.1]}
    spring = {"type": "spring-damper", "bodies": ["ground", "block"], "points": [[-10, 0], [0, 0]], "stiffness": 1.0}
    model = {
        "bodies": {"belt": belt, "block": {"mass": 1.0, "velocity": [0.2, 0.0]}},
        "joints": {
            "rail": {"type": "prismatic", "bodies": ["ground", "belt"], "points": [[0, -0.1], [0, 0]], "axis": [1, 0]},
            "motor": {"type": "driver", "bodies": ["ground", "belt"], "coordinate": "x", "motion": "0.2*t"},
        },
        "forces": {"spring": spring | {"free_length": 10.0}},
        "contacts": {"belt": contact},
    }
    found = run(model, 18.0, 0.05)
    slips = found.contacts["belt"].mode == 2.0
    changes = found.time[1:][np.diff(slips.astype(int)) != 0]
    # margin: resolution of the rows
    assert changes == pytest.approx([5.0, 8.902605407814523, 13.902605407814523, 17.805210815629046], abs=0.065)
    # slip ends where the spring has no force, since kinetic friction is half of static friction
    assert found["block"].position[-1, 0] == pytest.approx(0.2 * (18.0 - 17.805210815629046), abs=1e-10)


@pytest.mark.parametrize(("mu", "status"), [(1.33, "complete"), (1.34, "failed")])
def test_painleves_rod_has_no_solution_beyond_four_thirds(mu: float, status: str) -> None:
    # expected: at atan 2, a slender rod that slides towards its lean has no acceleration if mu > 4/3
    angle = float(np.arctan(2.0))
    rod = {"mass": 1.0, "inertia": 1.0 / 3.0, "position": [np.cos(angle), np.sin(angle)], "angle": angle}
    contact = {"bodies": ["ground", "rod"], "shapes": [FLOOR, {"point": [-1.0, 0.0]}], "friction": mu}
    model = {"bodies": {"rod": rod | {"velocity": [-1.0, 0.0]}}, "contacts": {"floor": contact}}
    if status == "failed":
        with pytest.raises(SpecError, match="Coulomb"):
            run(model, 0.001, 0.001)
    else:
        assert run(model, 0.001, 0.001).status == "complete"


def test_an_impact_that_would_gain_energy_follows_stronges_law() -> None:
    # Kane's paradox: with friction, Newton's law of impact can create energy
    angle = 1.0
    rod = {"mass": 1.0, "inertia": 1.0 / 12.0, "position": [0.0, float(0.5 * np.sin(angle) + 0.01)], "angle": angle}
    contact = {
        "bodies": ["ground", "rod"], "shapes": [FLOOR, {"point": [-0.5, 0.0]}], "restitution": 0.9, "friction": 0.9,
    }  # fmt: skip
    model = {"bodies": {"rod": rod | {"velocity": [1.0, -1.0]}}, "contacts": {"floor": contact}}
    found = run(model, 0.02, 0.002)
    assert np.all(found.impacts.energy_lost >= 0.0)
    assert any("would have created energy at 'floor'" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("treatment", "method"),
    [("event-driven", ""), ("time-stepping", "moreau-jean"), ("time-stepping", "nonsmooth-generalized-alpha")],
)
def test_a_pendulum_rebounds_from_a_wall_with_its_joint_closed(treatment: str, method: str) -> None:
    wall = {"line": {"point": [0.0, 0.0], "normal": [1.0, 0.0]}}
    contact = {"bodies": ["ground", "bob"], "shapes": [wall, {"point": [0.5, 0.0]}], "restitution": 0.5}
    model = {
        "bodies": {
            "rod": {"mass": 1.0, "inertia": 1.0 / 12.0, "position": [0.5, 0.0]},
            "bob": {"mass": 1.0, "inertia": 1.0 / 12.0, "position": [1.5, 0.0]},
        },
        "joints": {
            "pivot": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]},
            "elbow": {"type": "revolute", "bodies": ["rod", "bob"], "points": [[0.5, 0], [-0.5, 0]]},
        },
        "contacts": {"wall": contact},
    }
    found = run(model, 0.8, 0.0005 if treatment == "time-stepping" else 0.01, treatment, method)
    assert all(np.max(found.joints[name].misalignment) < 1e-12 for name in ("pivot", "elbow"))
    gap, lost = found.contacts["wall"].gap, found.energy.dissipated
    assert np.min(gap) > (-1e-12 if treatment == "event-driven" else -1e-5)
    assert lost[-1] > 0.1
    balance = found.energy.total + lost - found.energy.total[0]
    # of order one in time-stepping: 0.25, 0.12 and 0.06 J at steps of 1, 0.5 and 0.25 ms
    # margin: error of mbdkit's method at these steps
    assert_within(balance, 1e-8 if treatment == "event-driven" else 0.2)


@pytest.mark.parametrize("method", ["moreau-jean", "nonsmooth-generalized-alpha"])
def test_time_stepping_approaches_the_events_with_an_error_of_order_one(method: str) -> None:
    exact = run(ball(0.5), 2.0, 0.01)
    errors = []
    for step in (0.01, 0.005, 0.0025, 0.00125):
        found = run(ball(0.5), 2.0, step, "time-stepping", method)
        every = round(0.01 / step)
        gaps = found.contacts["floor"].gap[::every] - exact.contacts["floor"].gap
        errors.append(np.max(np.abs(gaps)) / step)
        assert found.contacts["floor"].normal_force[-1] == pytest.approx(2.0 * G, rel=1e-9)
        assert np.min(found.contacts["floor"].gap) > -1e-12
        # margin: error of mbdkit's method at these steps
        assert found.energy.dissipated[-1] == pytest.approx(2.0 * G, abs=0.5 * step)
    assert max(errors) < 2.0


@pytest.mark.parametrize("treatment", ["event-driven", "time-stepping"])
def test_a_plate_does_work_on_a_block_that_it_strikes(treatment: str) -> None:
    # expected: a plate of 3 kg rises with 1 m/s from 0.2537 s on and falls with 1 m/s from 0.5 s on; a block of 2 kg on
    # it takes its velocity, flies, and falls back onto it with 2 m/s less than the plate after 4 / g
    slab = {"mass": 2.0, "inertia": 1.0, "position": [0, 0.1]}
    motor = {"type": "driver", "bodies": ["ground", "plate"], "coordinate": "y"}
    guide = {"type": "prismatic", "bodies": ["ground", "plate"], "points": [[0, 0], [0, 0]], "axis": [0, 1]}
    model = {
        "bodies": {"plate": {"mass": 3.0, "inertia": 1.0}, "block": slab},
        "joints": {"guide": guide, "motor": motor | {"motion": "max(0, t - 0.2537) - 2*max(0, t - 0.5)"}},
        "contacts": {"c": {"bodies": ["plate", "block"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}]}},
    }
    found = run(model, 1.0, 0.01, treatment, impacts="allow")
    assert found.energy.dissipated[-1] == pytest.approx(0.5 * 2.0 * 1.0**2 + 0.5 * 2.0 * 2.0**2, rel=1e-9)
    assert found.energy.work[-1] == pytest.approx(5.0 + 2.5 - 5.0 * G * 0.2537, rel=1e-9)
    impacts = found.impacts
    drives = impacts.contact == "motor"
    assert impacts.time[drives] == pytest.approx([0.2537, 0.5])
    assert impacts.energy_lost[drives] == pytest.approx([-1.5, 0.0], abs=1e-12)
    if treatment == "event-driven":
        assert impacts.contact.tolist() == ["motor", "c", "motor", "c"]
        assert impacts.time[[1, 3]] == pytest.approx([0.2537, 0.5 + 4.0 / G], abs=1e-12)
        assert impacts.energy_lost[~drives] == pytest.approx([1.0, 4.0], rel=1e-9)
        pushes = impacts.reaction_impulse[:, impacts.joint == "motor", 1].ravel()
        assert pushes == pytest.approx([3.0, 2.0, -6.0, 4.0], rel=1e-9)


@pytest.mark.parametrize("method", ["dopri5", "rk4", "scipy-dop853"])
def test_events_of_a_gap_happen_once_when_a_contact_closes_and_once_when_it_opens(method: str) -> None:
    # expected: the fall of a ball from 0.5 m, without restitution; it is lifted where the load 20 t exceeds its weight
    bodies = {"ball": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 0.6]}}
    contact = {"bodies": ["ground", "ball"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}]}
    lift = {"type": "force", "body": "ball", "point": [0, 0], "value": [0.0, "20*max(t - 0.4, 0)"]}
    model = {"bodies": bodies, "contacts": {"floor": contact}, "forces": {"lift": lift}}
    found = run(model, 1.2, 0.01, method=method, events={"touch": {"when": "contacts.floor.gap"}})
    assert [event.direction for event in found.events] == [-1, 1]
    times = [event.time for event in found.events]
    assert times == pytest.approx([np.sqrt(2.0 * 0.5 / G), 0.4 + G / 20.0], abs=1e-5)


@pytest.mark.parametrize(("solve", "least"), [(solve_active_set, 80), (solve_by_path, 85)])
def test_solutions_from_a_guess_of_the_modes_satisfy_the_laws(solve: Any, least: int) -> None:
    """Coulomb's law in random systems, many of them with redundant contacts and from a wrong guess of the modes."""
    rng, solved = np.random.default_rng(5), 0
    for _ in range(100):
        k, n = int(rng.integers(1, 8)), 3 * int(rng.integers(1, 5))
        rows = rng.normal(size=(2 * k, n))
        cones, some = new_cones(k), new_active_set(k)
        cones.response[:], cones.free[:] = rows @ rows.T, rows @ rng.normal(size=n)
        cones.friction[:], some.modes[:] = rng.uniform(0.0, 0.5, k) * (rng.random(k) > 0.2), rng.integers(-2, 3, k)
        some.modes[some.modes == -1] = 1
        if not solve(some, cones, k):
            continue
        solved += 1
        (normal, tangent), after = cones.forces.reshape(2, k), cones.free + cones.response @ cones.forces
        size, most = max(1.0, np.max(np.abs(cones.free))), max(1.0, np.max(normal))
        assert np.all(normal >= 0.0)
        assert np.all(after[:k] > -1e-10 * size)
        assert_within(normal @ after[:k], 1e-10 * size * most)
        assert np.all(np.abs(tangent) <= cones.friction * normal + 1e-10 * most)
        assert np.all(tangent * after[k:] <= -cones.friction * normal * np.abs(after[k:]) + 1e-10 * size * most)
    assert solved > least


def test_a_pile_of_many_circles_is_not_lifted_by_the_projection_of_overlaps() -> None:
    # expected: conservation of energy. Overlaps of falling bodies are of order 1 in the step; bodies at rest have none
    found = mbdkit.run(pit(10, 10), time={"end": 0.15, "step": 0.001}, output={"every": 25})
    gap, force = found.array("contacts/gap")[-1], found.array("contacts/normal_force")[-1]
    assert np.sum(np.abs(gap) < 1e-5) > 100
    assert np.max(gap[force > 0.0]) < G * 0.001**2  # none pushes from farther than a body falls in a step
    # margin: error of mbdkit's method at these steps
    assert_within(found.energy.balance, 0.01 * found.energy.dissipated[-1])


def _by_stronge(response: np.ndarray, before: np.ndarray, friction: float, e: float) -> np.ndarray:
    strike = new_strike(1)
    strike.cones.response[:], strike.cones.friction[:] = response, friction
    strike.before[:], strike.restitution[:] = before, e
    stronge(strike)
    return strike.impulses


def test_stronges_impact_never_gains_energy() -> None:
    random = np.random.default_rng(5)
    for _ in range(300):
        rows = random.normal(size=(2, 3))
        response, before = rows @ rows.T, rows @ random.normal(size=3)
        before[0] = -abs(before[0])
        mu, e = random.uniform(0.0, 1.5), random.uniform(0.0, 1.0)
        impulse = _by_stronge(response, before, mu, e)
        assert impulse @ (before + 0.5 * response @ impulse) <= 1e-12
        assert abs(impulse[1]) <= mu * impulse[0] + 1e-12
        smooth = _by_stronge(response, before, 0.0, e)
        assert (before + response @ smooth)[0] == pytest.approx(-e * before[0], abs=1e-12)


FALLING = {"mbdkit": 1, "model": {"name": "mechanism"} | ball(0.5), "integrator": {"name": "rk4"}}
FALLING |= {"contact": {"treatment": "event-driven"}, "time": {"end": 1, "step": 0.1}}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"contact": {"treatment": "time-stepping"}}, "time-stepping needs the integrator moreau-jean"),
        ({"accuracy": 1e-6}, "`accuracy` is not available for runs with rigid contacts"),
        ({"stabilization": "projection"}, "every step projects joints and contacts"),
    ],
)
def test_what_rigid_contacts_need_is_said(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        mbdkit.run(FALLING | change)


def test_gradients_and_equilibria_refuse_rigid_contacts() -> None:
    with pytest.raises(SpecError, match="gradients of runs do not include event-driven and time-stepping contacts"):
        mbdkit.gradient(FALLING, ["final(ball.y)"], ["model.bodies.ball.mass"])
    with pytest.raises(SpecError, match="at rest needs compliant contacts"):
        mbdkit.equilibrium(FALLING)


def test_other_states_are_refused_by_time_stepping() -> None:
    states = {"states": {"charge": {"initial": 1.0, "rate": "-states.charge"}}}
    stepped = {"integrator": {"name": "moreau-jean"}, "contact": {"treatment": "time-stepping"}}
    with pytest.raises(SpecError, match=r"moreau-jean does not integrate first-order states \(charge\)"):
        mbdkit.run(FALLING | stepped | {"model": FALLING["model"] | states})


def test_impacts_are_kept_where_a_load_changes() -> None:
    model = ball(0.5)
    table = {"table": [[0.0, 0.7, 2.0], [0.0, 1.0, 1.0]], "interpolation": "linear"}
    model["forces"] = {"wind": {"type": "force", "body": "ball", "value": [table, 0.0]}}
    found = run(model, 1.0, 0.05)
    assert found.impacts.time == pytest.approx([0.451523640985731, 0.903047281971462], abs=1e-11)
    assert found.contacts["floor"].mode.tolist() == [0.0] * 21


def test_shapes_that_overlap_at_the_start_are_refused() -> None:
    model = ball(0.5)
    model["bodies"]["ball"]["position"] = [0.0, 0.09]
    with pytest.raises(SpecError, match=r"the shapes of 'floor' overlap by 0\.01 m at the start"):
        run(model, 1.0, 0.01)


def test_a_block_that_rocks_comes_to_rest_on_both_corners() -> None:
    # its corners strike in turn without end, without restitution; expected: rest, with all energy lost
    side, tilt = 0.2, 0.05
    place = {"position": [side * (np.cos(tilt) - np.sin(tilt)), side * (np.sin(tilt) + np.cos(tilt))], "angle": tilt}
    body = {"mass": 1.0, "inertia": 2 * side**2 / 3.0} | {name: np.asarray(x).tolist() for name, x in place.items()}
    contact = {"bodies": ["ground", "block"], "shapes": [FLOOR, outline(side, side)], "friction": 5.0}
    found = run({"bodies": {"block": body}, "contacts": {"floor": contact}}, 0.5, 0.05)
    rows = found.contacts["floor.0"], found.contacts["floor.1"]
    assert [row.mode[-1] for row in rows] == [1.0, 1.0]
    assert [row.normal_force[-1] for row in rows] == pytest.approx([G / 2, G / 2], rel=1e-9)
    assert found.energy.dissipated[-1] == pytest.approx((place["position"][1] - side) * G, rel=1e-9)
    ratios = np.sqrt(found.impacts.energy_lost[1:5] / found.impacts.energy_lost[:4])
    assert ratios == pytest.approx(1.0 - 1.5 * np.sin(np.pi / 4) ** 2, rel=1e-9)  # Housner
    assert any("an infinite sequence of impacts was cut off" in text for text in found.warnings)


def test_impulses_of_joints_balance_the_momenta_of_all_bodies_at_an_impact() -> None:
    """A driven rod carries a second one, which strikes the floor with friction.

    The momenta are those of two runs, which end just before and after the impact.
    """
    rod = {"mass": 2.0, "inertia": 0.06}
    floor = {"line": {"point": [0.0, -0.5], "normal": [0.0, 1.0]}}
    contact = {"bodies": ["ground", "lower"], "shapes": [floor, {"point": [0.3, 0.0]}]}
    model = {
        "name": "mechanism",
        "bodies": {"upper": {**rod, "position": [0.3, 0.0]}, "lower": {**rod, "position": [0.9, 0.0]}},
        "joints": {
            "hip": {"type": "revolute", "bodies": ["ground", "upper"], "at": [0.0, 0.0]},
            "motor": {"type": "driver", "bodies": ["ground", "upper"], "coordinate": "angle", "motion": "0.1*sin(3*t)"},
            "knee": {"type": "revolute", "bodies": ["upper", "lower"], "at": [0.6, 0.0]},
        },
        "contacts": {"heel": contact | {"restitution": 0.4, "friction": 0.3}},
    }
    whole = run(model, 0.6, 0.01)
    impacts = whole.impacts
    time, near = impacts.time[0], 1e-8
    before, after = (run(model, end, 0.01) for end in (time - near, time + near))
    heel = np.array([impacts.tangential_impulse[0], impacts.normal_impulse[0]])
    own = {name: impacts.reaction_impulse[0, impacts.joint == name][0] for name in impacts.joint}
    torque = dict(zip(impacts.joint, impacts.reaction_torque_impulse[0], strict=True))
    assert np.hypot(*own["knee"]) > 1.0
    loads = {  # impulses on each body, and the points at which they act
        "upper": ([own["hip"], own["motor"], -own["knee"]], [[-0.3, 0.0], [-0.3, 0.0], [0.3, 0.0]], torque["motor"]),
        "lower": ([own["knee"], heel], [[-0.3, 0.0], [0.3, 0.0]], 0.0),
    }
    for name, (impulses, points, moment) in loads.items():
        gain = after[name].velocity[-1] - before[name].velocity[-1]
        assert 2.0 * gain == pytest.approx(np.sum(impulses, axis=0), abs=2e-6)
        c, s = np.cos(after[name].angle[-1]), np.sin(after[name].angle[-1])
        arms = np.array(points) @ [[c, s], [-s, c]]
        turn = sum(arm[0] * one[1] - arm[1] * one[0] for arm, one in zip(arms, impulses, strict=True))
        change = after[name].angular_velocity[-1] - before[name].angular_velocity[-1]
        assert 0.06 * change == pytest.approx(turn + moment, abs=2e-6)
    assert torque["hip"] == torque["knee"] == pytest.approx(0.0, abs=1e-12)
    table = next(one for one in run_tables(whole) if one.name == "impulses")
    assert [row[0] for row in table.rows] == ["hip", "motor", "knee"]
    sizes = np.linalg.norm(impacts.reaction_impulse[:, 2], axis=1)
    assert table.rows[2][2:4] == (np.max(sizes), impacts.time[np.argmax(sizes)])


def test_gaps_that_are_not_evaluated_are_above_their_bounds() -> None:
    """Polygons and a circle off the centres of their bodies, and a line on one of them."""
    random = np.random.default_rng(3)
    bodies = {f"b{i}": {"mass": 1.0, "inertia": 0.1, "position": [0.08 * i, 0.0]} for i in range(8)}
    shapes = {name: {"polygon": [[0.1, -0.2], [0.14, -0.2], [0.1, -0.17]]} for name in bodies}
    shapes["b2"] = {"circle": {"center": [0.1, -0.2], "radius": 0.02}}
    line = {"line": {"point": [3.0, 0.0], "normal": [-1.0, 0.2]}}
    wall = {"bodies": ["b0", "b1"], "shapes": [line, shapes["b1"]]}
    contacts = {"all": {"among": list(bodies), "shapes": shapes}, "wall": wall}
    model = {"name": "mechanism", "bodies": bodies, "contacts": contacts}
    spec = {"mbdkit": 1, "model": model, "contact": {"treatment": "event-driven"}, "integrator": {"name": "rk4"}}
    equations = EquationsOfMotion.of(mbdkit.RunSpec(**spec, time={"end": 1.0, "step": 0.1}).mechanism())
    contacts = RigidContacts(equations)
    reach, far, touch, q = contacts.reach, 0, 0, equations.q0.copy()
    for _ in range(200):
        q = q + random.uniform(-1e-2, 1e-2, len(q))
        found, exact = gaps_in(contacts.shapes, q, reach), rows_in(contacts.shapes, q, 0.0 * q).gap
        is_near, overlaps = found <= reach, exact <= 0.0
        assert np.array_equal(found[is_near], exact[is_near])
        assert np.all(is_near[overlaps])
        far, touch = far + int(np.sum(found != exact)), touch + int(np.sum(overlaps))
    assert far > 1000
    assert touch > 10


@pytest.mark.parametrize(("inertia", "time", "speed"), [(0.4, 2 / 7, 5 / 7), (0.5, 1 / 3, 2 / 3)], ids=["ball", "disc"])
def test_a_body_that_slides_begins_to_roll(inertia: float, time: float, speed: float) -> None:
    # expected: v = v0 - mu g t and r omega = mu g t/inertia are equal when the body begins to roll
    body = {"mass": 1.0, "inertia": inertia * 0.1**2, "position": [0.0, 0.1], "velocity": [2.0, 0.0]}
    contact = {"bodies": ["ground", "body"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}], "friction": 0.2}
    event = {"when": "abs(contacts.floor.slip) - 1e-6", "direction": "falling"}
    events = {"rolls": event, "mode": {"when": "contacts.floor.mode - 1.5"}}
    found = run({"bodies": {"body": body}, "contacts": {"floor": contact}}, 0.4, 0.05, events=events)
    # slip is linear in time, with the slope mu g (1 + 1/inertia): 1e-6 m/s is reached that much earlier
    early = 1e-6 / (0.2 * G * (1 + 1 / inertia))
    assert found.events.of_name("rolls").time == pytest.approx([time * 2.0 / (0.2 * G) - early], abs=1e-9)
    assert found.events.of_name("mode").time == pytest.approx([time * 2.0 / (0.2 * G)], abs=1e-9)  # not at the start
    assert found["body"].velocity[-1, 0] == pytest.approx(speed * 2.0, abs=1e-9)
    assert not found.warnings


def test_an_event_on_the_sign_of_a_slip_is_warned_about() -> None:
    spec = load_spec("belt", (), events={"slips": {"when": 'contacts["belt.3"].slip'}})
    assert "event 'slips' watches the sign of contacts[\"belt.3\"].slip" in "".join(map(str, caution(spec)))
