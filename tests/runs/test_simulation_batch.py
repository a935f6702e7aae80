"""Batches of simulations have the bits of single runs, and follow states that are set between their steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism, RunSpec, SpecError
from mbdkit.plugin.equations import Starts
from mbdkit.plugin.runs import SimulationBatch, why_not_batched
from mbdkit.plugin.specs import load_spec
from tests.engine.random_mechanisms import chain, loop, tree

NUMBER = 11
"""More simulations than any vector has lanes."""


def with_forces(rng: np.random.Generator) -> Mechanism:
    """Return a cart with two rods, a spring with a law, a driven weight, and a filtered load."""
    m = Mechanism()
    m.body("cart", mass=1.0, inertia=0.1, velocity=(float(rng.uniform(0.1, 0.5)), 0.0))
    m.prismatic("rail", m.ground, "cart", at=(0.0, 0.0), axis=(1.0, 0.0))
    m.body("pole", mass=0.5, inertia=0.02, position=(0.0, -0.5), angle=-1.6)
    m.revolute("pin", "cart", "pole", points=((0.0, 0.0), (-0.5, 0.0)))
    m.law("stop", m.ground, "cart", points=((2.0, 0.0), (0.1, 0.0)), law="one-sided", acts="compression",
          stiffness=50.0, free_length=1.8, damping=1.0)  # fmt: skip
    m.driver(
        "lift",
        "cart",
        m.body("weight", mass=0.2, inertia=0.01, position=(0.0, 0.3)),
        coordinate="y",
        motion="0.3 + 0.1*sin(3*t)",
    )
    m.state("lagged", initial=0.2, rate="(pole.angle - states.lagged)/0.1", unit="rad")
    m.torque("motor", "pole", value="-2*states.lagged", reaction_body="cart")
    return m


MECHANISMS: dict[str, Callable[[np.random.Generator], Mechanism]] = {
    "chain": lambda rng: chain(rng, 3), "tree": lambda rng: tree(rng, 5), "forces": with_forces,
}  # fmt: skip


def spec_of(mechanism: Mechanism, formulation: str = "joint-coordinates", method: str = "rk4") -> RunSpec:
    return load_spec(
        mechanism, (), formulation=formulation, integrator={"name": method}, time={"end": 0.4, "step": 0.005}
    )


@pytest.mark.parametrize("formulation", ["joint-coordinates", "index-1"])
@pytest.mark.parametrize("kind", MECHANISMS)
def test_a_batch_has_the_bits_of_a_run(kind: str, formulation: str) -> None:
    spec = spec_of(MECHANISMS[kind](np.random.default_rng(1)), formulation, "rk4" if kind == "chain" else "rk-gill")
    run, batch = mbdkit.run(spec), SimulationBatch(spec, NUMBER, threads=2)
    bodies, joints = list(run.bodies), list(run.joints)
    names = [f"bodies.{body}.{axis}" for body in bodies for axis in ("x", "y", "angle", "vx", "vy", "angular_velocity")]
    names += [f"joints.{joint}.{force}" for joint in joints for force in ("force_x", "force_y", "torque")]
    read = batch.reader(["t", *names, "energy.total"])
    for row in range(0, 80, 4):
        expected = [run.time[row]]
        for body in map(run.bodies.__getitem__, bodies):
            expected += [*body.position[row], body.angle[row], *body.velocity[row], body.angular_velocity[row]]
        for joint in map(run.joints.__getitem__, joints):
            expected += [*joint.reaction_force[row], joint.reaction_torque[row]]
        assert np.array_equal(read(), np.tile([*expected, run.energy.total[row]], (NUMBER, 1)))
        batch.advance(4)
    assert not batch.lost.any()


def held(controlled: bool) -> Mechanism:
    """Return a double pendulum with two torques, of a controller or of states that its caller sets."""
    m = Mechanism()
    m.body("a", mass=1.0, inertia=0.08, position=(0.5, 0.0))
    m.body("b", mass=1.0, inertia=0.08, position=(1.5, 0.0))
    m.revolute("J1", m.ground, "a", at=(0.0, 0.0))
    m.revolute("J2", "a", "b", at=(1.0, 0.0))
    if controlled:
        m.controller("u", period=0.02, outputs={"one": "3*sin(9*t)", "two": "cos(5*t)"})
    for name in ("one", "two") if not controlled else ():
        m.state(name, rate=0.0)
    value = "controllers.u" if controlled else "states"
    m.torque("first", "a", value=f"{value}.one")
    m.torque("second", "b", value=f"{value}.two", reaction_body="a")
    return m


def test_states_that_are_set_act_as_the_outputs_of_a_sampled_controller() -> None:
    run = mbdkit.run(spec_of(held(controlled=True)))
    batch = SimulationBatch(spec_of(held(controlled=False)), NUMBER)
    read = batch.reader(["J2.angle", "a.angular_velocity", "t"])
    for row in range(0, 80, 4):
        expected = [run.joints["J2"].angle[row], run.bodies["a"].angular_velocity[row], run.time[row]]
        assert read() == pytest.approx(np.tile(expected, (NUMBER, 1)), rel=1e-11, abs=1e-12)
        time = batch.time
        batch.set_states([0, 1], np.column_stack([3.0 * np.sin(9.0 * time), np.cos(5.0 * time)]))
        batch.advance(4)


def test_simulations_start_again_with_other_numbers() -> None:
    light, heavy = (spec_of(pendulum(mass)) for mass in (1.0, 2.5))
    start = Starts().at_start(heavy.mechanism())
    batch = SimulationBatch(light, NUMBER, apart=True)
    read = batch.reader(["arm.angle", "energy.kinetic", "t"])
    batch.advance(7)
    batch.start([2, 9], start.q0, start.v0, [start.mechanism] * 2)
    assert read()[[2, 9]].tolist() == [[0.0, 0.0, 0.0]] * 2
    batch.advance(20)
    runs = {9: (mbdkit.run(heavy), 20), 3: (mbdkit.run(light), 27)}
    for number, (run, row) in runs.items():
        assert read()[number].tolist() == [run.bodies["arm"].angle[row], run.energy.kinetic[row], run.time[row]]


def pendulum(mass: float) -> Mechanism:
    """Return a rod with a spring, so that its motion depends on its mass."""
    m = Mechanism()
    m.body("arm", mass=mass, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin", m.ground, "arm", at=(0.0, 0.0))
    m.spring_damper("spring", m.ground, "arm", points=((0.5, 1.0), (0.0, 0.0)), stiffness=20.0, free_length=0.5)
    return m


def test_a_simulation_that_is_lost_starts_again() -> None:
    batch = SimulationBatch(spec_of(held(controlled=False)), NUMBER)
    start, read = Starts().at_start(batch.spec.mechanism()), batch.reader(["a.angle"])
    torques = np.zeros((NUMBER, 2))
    torques[5] = 1e308
    batch.set_states([0, 1], torques)
    batch.advance(4)
    assert np.flatnonzero(batch.lost).tolist() == [5]
    assert np.isfinite(np.delete(read(), 5)).all()
    batch.start([5], start.q0[None], start.v0[None])
    batch.set_states([0, 1], 0.0 * torques)
    batch.advance(4)
    assert not batch.lost.any()
    assert np.isfinite(read()).all()


@pytest.mark.parametrize(("given", "reason"), [
    ({"integrator": {"name": "gauss"}}, "mbdkit:gauss is not an explicit method with fixed steps"),
    ({"integrator": {"name": "dop853", "adaptive": True}}, "mbdkit:dop853 is not an explicit method with fixed steps"),
    ({"stabilization": {"name": "projection"}}, "the stabilization is projection"),
    ({"events": {"low": {"when": "r1.y + 2"}}}, "the spec has events"),
    ({"limits": {"energy_jump": 0.1}}, "`limits.energy_jump` watches the energies of each step"),
])  # fmt: skip
def test_reasons_against_batches(given: dict[str, object], reason: str) -> None:
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 0.4, "step": 0.005}} | given
    spec = load_spec(chain(np.random.default_rng(0), 2), (), **sections)  # type: ignore[arg-type]
    assert why_not_batched(spec) == reason
    with pytest.raises(SpecError, match="simulations of this spec cannot be batched: "):
        SimulationBatch(spec, 2)


def test_loops_and_controllers_are_not_batched() -> None:
    assert why_not_batched(spec_of(loop(np.random.default_rng(0)))) == "its joints close a loop"
    assert "controllers" in why_not_batched(spec_of(held(controlled=True)))
