"""A thousand double pendulums with torques: steps of environments per second, beside the batched rollout of MuJoCo."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import load_spec

pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install mbdkit[gym]")

NUMBER, PERIOD, STEPS = 1000, 0.02, 4

MJCF = f"""
<mujoco>
  <option timestep="{PERIOD / STEPS}" integrator="RK4" gravity="0 0 -9.81"><flag contact="disable"/></option>
  <worldbody>
    <body><joint name="shoulder" type="hinge" axis="0 -1 0"/>
      <inertial pos="0.5 0 0" mass="1" diaginertia="0.08 0.08 0.08"/>
      <body pos="1 0 0"><joint name="elbow" type="hinge" axis="0 -1 0"/>
        <inertial pos="0.5 0 0" mass="1" diaginertia="0.08 0.08 0.08"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>"""


def pendulums(number: int) -> Any:
    """Return a vector environment of double pendulums with torques at both joints."""
    from mbdkit_gym import VectorEnvironment

    m = mbdkit.Mechanism()
    m.body("a", mass=1.0, inertia=0.08, position=(0.5, 0.0))
    m.body("b", mass=1.0, inertia=0.08, position=(1.5, 0.0))
    m.revolute("J1", m.ground, "a", at=(0.0, 0.0))
    m.revolute("J2", "a", "b", at=(1.0, 0.0))
    for name in ("shoulder", "elbow"):
        m.input(name, unit="N*m", bounds=(-5.0, 5.0))
    m.torque("first", "a", value="inputs.shoulder")
    m.torque("second", "b", value="inputs.elbow", reaction_body="a")
    time = {"end": 1.0, "step": PERIOD / STEPS}
    spec = load_spec(m, (), formulation="joint-coordinates", integrator={"name": "rk4"}, time=time)
    return VectorEnvironment(
        spec, number=number, period=PERIOD, duration=1000.0, reward="sin(a.angle) + sin(b.angle)",
        observations=["J1.angle", "J2.angle", "a.angular_velocity", "b.angular_velocity"],
    )  # fmt: skip


def rollouts(number: int, threads: int = 2) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that advances pendulums in MuJoCo by a period, and returns angles and rates (N, 4)."""
    mujoco = pytest.importorskip("mujoco")
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_string(MJCF)
    data = [mujoco.MjData(model) for _ in range(threads)]
    state = np.zeros((number, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    pool = rollout.Rollout(nthread=threads)

    def advance(actions: np.ndarray) -> np.ndarray:
        control = np.repeat(actions[:, None].astype(float), STEPS, axis=1)
        states, _ = pool.rollout(model, data, state, control, nstep=STEPS)
        state[:] = states[:, -1]
        return np.asarray(state[:, 1:])

    return advance


def test_pendulums_of_mujoco_are_the_same() -> None:
    environment, advance = pendulums(5), rollouts(5)
    environment.reset()
    rng = np.random.default_rng(0)
    for _ in range(25):
        actions = rng.uniform(-5.0, 5.0, (5, 2)).astype(np.float32)
        observed, *_ = environment.step(actions)
        first, second, rate, other_rate = advance(actions).T
        # the second angle of MuJoCo is that of the joint, its rate relative to the first rod
        expected = np.column_stack([first, second, rate, rate + other_rate])
        assert observed == pytest.approx(expected, abs=1e-9)


@pytest.mark.benchmark
def test_steps_of_a_thousand_environments_per_second(capsys: pytest.CaptureFixture[str]) -> None:
    environment, advance = pendulums(NUMBER), rollouts(NUMBER)
    environment.reset()
    actions = np.random.default_rng(0).uniform(-5.0, 5.0, (NUMBER, 2)).astype(np.float32)

    def rate(step: Callable[[np.ndarray], object], calls: int) -> float:
        begin = time.perf_counter()
        for _ in range(calls):
            step(actions)
        return NUMBER * calls / (time.perf_counter() - begin)

    pairs = [(rate(environment.step, 100), rate(advance, 10)) for _ in range(10)]
    (ours, theirs), ratios = np.max(pairs, axis=0), [a / b for a, b in pairs]
    with capsys.disabled():
        print(f"\nsteps of environments per second: {ours:.0f}; by mujoco.rollout, with two threads: {theirs:.0f}")
        print(f"ratio in {len(pairs)} pairs of measurements: {min(ratios):.1f} to {max(ratios):.1f}")
