"""Batches of simulations have the bits of single runs, also if inputs are set between their steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism, RunSpec, SpecError, load_spec
from mbdkit.engine.consistent_start import Starts
from mbdkit.plugin.runs import SimulationBatch
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


def driven(hold: str = "zero") -> Mechanism:
    """Return a double pendulum with a torque at each joint, which its caller sets."""
    m = Mechanism()
    m.body("a", mass=1.0, inertia=0.08, position=(0.5, 0.0))
    m.body("b", mass=1.0, inertia=0.08, position=(1.5, 0.0))
    m.revolute("J1", m.ground, "a", at=(0.0, 0.0))
    m.revolute("J2", "a", "b", at=(1.0, 0.0))
    m.input("shoulder", unit="N*m", initial=0.5)
    m.input("elbow", unit="N*m", hold=hold)
    m.torque("first", "a", value="inputs.shoulder")
    m.torque("second", "b", value="inputs.elbow", reaction_body="a")
    return m


READ = ["t", "J1.angle", "b.x", "a.angular_velocity", "joints.J1.force_x", "inputs.shoulder", "inputs.elbow"]


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize("formulation", ["joint-coordinates", "index-1"])
def test_inputs_have_the_effect_that_they_have_in_a_single_simulation(hold: str, formulation: str) -> None:
    spec = spec_of(driven(hold), formulation)
    batch, single = SimulationBatch(spec, NUMBER, threads=2), mbdkit.open(spec)
    read, read_single, rng = batch.reader(READ), single.reader(READ), np.random.default_rng(2)
    for call in range(16):
        torques = rng.uniform(-2.0, 2.0, (NUMBER, 2))
        batch.inputs[:, call % 2 :] = torques[:, call % 2 :]  # the first input is set in every other call
        for name, value in list(zip(("shoulder", "elbow"), torques[7].tolist(), strict=True))[call % 2 :]:
            single.inputs[name] = value
        batch.advance(4)
        single.advance(0.02)
        assert read()[7].tolist() == read_single().tolist()
    assert len(np.unique(read()[:, 1])) == NUMBER


def test_held_inputs_act_as_the_outputs_of_a_sampled_controller() -> None:
    controlled = Mechanism.from_spec(driven().to_spec() | {"inputs": {}, "forces": {}})
    controlled.controller("u", period=0.02, outputs={"one": "3*sin(9*t)", "two": "cos(5*t)"})
    controlled.torque("first", "a", value="controllers.u.one")
    controlled.torque("second", "b", value="controllers.u.two", reaction_body="a")
    run, batch = mbdkit.run(spec_of(controlled)), SimulationBatch(spec_of(driven()), NUMBER)
    read = batch.reader(["J2.angle", "a.angular_velocity"])
    for row in range(0, 80, 4):
        expected = [run.joints["J2"].angle[row], run.bodies["a"].angular_velocity[row]]
        assert read() == pytest.approx(np.tile(expected, (NUMBER, 1)), rel=1e-11, abs=1e-12)
        batch.inputs[:] = np.column_stack([3.0 * np.sin(9.0 * batch.time), np.cos(5.0 * batch.time)])
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
    batch = SimulationBatch(spec_of(driven()), NUMBER)
    start, read = Starts().at_start(batch.spec.mechanism()), batch.reader(["a.angle"])
    batch.inputs[5] = 1e308
    batch.advance(4)
    assert np.flatnonzero(batch.lost).tolist() == [5]
    assert np.isfinite(np.delete(read(), 5)).all()
    batch.start([5], start.q0[None], start.v0[None])
    assert batch.inputs[5].tolist() == [0.5, 0.0]
    batch.advance(4)
    assert not batch.lost.any()
    assert np.isfinite(read()).all()


@pytest.mark.parametrize(("given", "reason"), [
    ({"integrator": {"name": "gauss"}}, "mbdkit:gauss is not an explicit method with fixed steps"),
    ({"integrator": {"name": "dop853", "adaptive": True}}, "mbdkit:dop853 is not an explicit method with fixed steps"),
    ({"integrator": {"name": "dopri5"}}, "the method reuses the last stage of a step"),
    ({"stabilization": {"name": "projection"}}, "the stabilization is projection"),
    ({"events": {"low": {"when": "r1.y + 2"}}}, "the spec has events"),
    ({"limits": {"energy_jump": 0.1}}, "`limits.energy_jump` watches the energies of each step"),
])  # fmt: skip
def test_reasons_against_batches(given: dict[str, object], reason: str) -> None:
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 0.4, "step": 0.005}} | given
    spec = load_spec(chain(np.random.default_rng(0), 2), (), **sections)  # type: ignore[arg-type]
    assert SimulationBatch.why_not(spec) == reason
    with pytest.raises(SpecError, match="simulations of this spec cannot be batched: "):
        SimulationBatch(spec, 2)


def test_loops_and_controllers_are_not_batched() -> None:
    controlled = driven()
    controlled.controller("u", period=0.02, outputs={"one": "sin(t)"})
    assert SimulationBatch.why_not(spec_of(loop(np.random.default_rng(0)))) == "its joints close a loop"
    assert "controllers" in SimulationBatch.why_not(spec_of(controlled))
