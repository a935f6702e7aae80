"""Transmissions in other computations: vectorized runs, gradients, CasADi, statics, archives."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import EquationsOfMotion, Mechanism, SpecError
from mbdkit.engine.consistent_start import Starts
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.spec import load_spec
from tests.margins import assert_within

from .geared_arm import RATIO, acceleration, coupled, crossed, geared, links

GAUSS = {"name": "gauss", "stages": 3}
TIME = {"end": 0.2, "step": 0.005}


def spec_of(ratio: float = 1.5, integrator: Any = GAUSS, **sections: Any) -> dict[str, Any]:
    """Return the spec of a run of the arm with a coupling, whose ratio is a parameter."""
    disc = {"mass": 1.0, "inertia": 0.1}
    joints = {
        "A": {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0]},
        "B": {"type": "revolute", "bodies": ["a", "b"], "at": [1, 0]},
        "G": {"type": "coupling", "bodies": ["a", "b"], "equation": "angle - ratio*first"},
    }
    bodies = {"a": disc | {"position": [0.5, 0.0]}, "b": disc | {"position": [1.5, 0.0]}}
    model = {"name": "mechanism", "gravity": [0.0, -9.81], "bodies": bodies, "joints": joints}
    own = {"mbdkit": 1, "parameters": {"ratio": ratio}, "model": model, "integrator": integrator, "time": TIME}
    return own | sections


@pytest.mark.parametrize("integrator", [GAUSS, {"name": "rk4"}, {"name": "radau-iia", "stages": 3}])
def test_vectorized_runs_have_the_bits_of_single_runs(integrator: dict[str, Any]) -> None:
    specs = [load_spec(spec_of(ratio, integrator)) for ratio in (1.3, 1.4, 1.5, 1.6, 1.7)]
    lanes = LaneRuns(Starts(), ())
    members = [member for member in lanes.members(specs) if member is not None]
    assert len(members) == len(specs)
    found = {
        place: runs.run(number)
        for places, runs in lanes.finished(members)
        for number, place in enumerate(places)
        if runs is not None
    }
    assert [found[i].data_sha256 for i in range(len(specs))] == [mbdkit.run(spec).data_sha256 for spec in specs]


def test_the_gradient_by_a_number_of_an_equation_is_that_of_differences() -> None:
    measures = {"angle": "final(bodies.b.angle)", "torque": "final(joints.G.torque)"}
    gradient = mbdkit.gradient(spec_of(), measures, ["ratio"], check=False)
    step = 1e-5
    values = []
    for ratio in (1.5 - step, 1.5 + step):
        run = mbdkit.run(spec_of(ratio))
        values.append([run.bodies["b"].angle[-1], run.joints["G"].reaction_torque[-1]])
    differences = np.diff(values, axis=0)[0] / (2 * step)
    np.testing.assert_allclose(gradient.jacobian[:, 0], differences, rtol=1e-7)


@pytest.mark.parametrize("model", [geared, coupled, crossed])
def test_casadi_has_the_equations_of_the_engine(model: Any) -> None:
    pytest.importorskip("casadi")
    m = model()
    system, equations = m.to_casadi(), EquationsOfMotion.of(m)
    generator = np.random.default_rng(3)
    q, v, a = (generator.standard_normal(equations.n) for _ in range(3))
    lam = generator.standard_normal(equations.m)
    state = (q, v, a, lam, [], [], [], 0.0)
    position, velocity, acceleration = (np.ravel(x) for x in system.constraints(*state))
    close: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(position, equations.constraints(0.0, q), **close)
    np.testing.assert_allclose(velocity, equations.constraint_rates(0.0, q, v), **close)
    rates = equations.constraint_jacobian(0.0, q) @ a - equations.gamma(0.0, q, v)
    np.testing.assert_allclose(acceleration, rates, **close)
    np.testing.assert_allclose(np.ravel(system.residual(*state)), equations.residual(0.0, q, v, a, lam), **close)


def test_casadi_has_tables_and_roots() -> None:
    pytest.importorskip("casadi")
    m = Mechanism()
    m.body("a", mass=1.0, inertia=0.1)
    m.body("b", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.cam("C", "a", "b", profile={"table": [[0, 2, 4, 6.283185307179586], [0.4, 0.5, 0.45, 0.4]], "ends": "periodic"},
          follower={"roller": 0.1})  # fmt: skip
    system, equations = m.to_casadi(), EquationsOfMotion.of(m)
    for angle in (0.1, 2.5, 5.0):
        q = equations.q0 + np.array([0.0, 0.0, angle, 0.02, 0.03, 0.0])
        position, *_ = system.constraints(q, q, q, [0.0], [], [], [], 0.0)
        np.testing.assert_allclose(np.ravel(position), equations.constraints(0.0, q), rtol=0, atol=1e-12)


def test_a_geared_arm_hangs_where_its_potential_is_stationary() -> None:
    found = mbdkit.equilibrium(geared())
    a, b = found.position[:, 2]
    assert b == pytest.approx(2.5 * a, rel=1e-12)
    assert 1.5 * np.cos(a) + 2.5 * 0.5 * np.cos(b) == pytest.approx(0.0, abs=1e-12)


def test_modes_include_no_radial_force_that_does_work() -> None:
    """Expected: held centres have the modes of a gear without this force; otherwise the tangents would be wrong."""
    held, free = geared(), links()
    plain = held.joints["G"].model_copy(update={"pressure_angle": 0.0})
    modes = mbdkit.modes(held).eigenvalues
    held.joints["G"] = plain
    np.testing.assert_allclose(modes, mbdkit.modes(held).eigenvalues, rtol=1e-9)
    free.gear("G", free.ground, "b", radii=(0.6, 0.9))
    with pytest.raises(SpecError, match="not held at a constant distance") as error:
        mbdkit.modes(free)
    assert error.value.key == "model.joints.G.pressure_angle"


def geared_spec(pressure_angle: float = 0.0) -> dict[str, Any]:
    """Return the model of the arm whose second link is geared to the ground."""
    model = spec_of()["model"]
    gear = {"type": "gear", "bodies": ["ground", "b"], "radii": [0.6, 0.4], "points": [[0, 0], [-0.5, 0]]}
    return model | {"joints": model["joints"] | {"G": gear | {"pressure_angle": pressure_angle}}}


def test_inverse_dynamics_of_a_geared_arm_is_virtual_work(tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 401)
    a, rate, change = 0.4 * np.sin(3 * time), 1.2 * np.cos(3 * time), -3.6 * np.sin(3 * time)
    np.savetxt(tmp_path / "arm.csv", np.stack([time, a], axis=1), delimiter=",", header="time,a", comments="")
    motion = {"file": str(tmp_path / "arm.csv"), "columns": {"a.angle": {"column": "a", "unit": "rad"}}}
    spec = {"mbdkit": 1, "model": geared_spec(), "motion": motion | {"smooth": {"name": "none"}}}
    run = mbdkit.inverse(spec | {"actuators": {"A": {"joint": "A"}}})
    # expected: with acceleration 0, the equation of the arm gives its bias; the inertia multiplies the rest
    bias = np.array([acceleration(x, v) for x, v in zip(a, rate, strict=True)])
    inertia = 0.5**2 + 1.0 + (RATIO * 0.5) ** 2 + 0.1 * (1 + RATIO**2) + RATIO * np.cos((RATIO - 1.0) * a)
    torque = np.interp(time, run.time, run.actuators["A"].value)
    np.testing.assert_allclose(torque[50:-50], (inertia * (change - bias))[50:-50], rtol=0, atol=1e-8)
    with pytest.raises(SpecError, match="does not support the radial force of the teeth"):
        mbdkit.inverse(spec | {"model": geared_spec(0.35)} | {"actuators": {"A": {"joint": "A"}}})


def test_a_predicted_motion_of_a_geared_arm_is_confirmed_by_a_run() -> None:
    pytest.importorskip("casadi")
    model = geared_spec(0.35) | {"forces": {"T": {"type": "torque", "body": "a", "value": 0.0}}}
    found = mbdkit.predict(
        {
            "mbdkit_predict": 1,
            "base": {"model": model},
            "controls": {"forces.T.value": {"bounds": [-100, 100], "start": 20}},
            "duration": 0.8,
            "initial": {"a.angle": 0, "a.angular_velocity": 0},
            "final": {"a.angle": 0.8, "a.angular_velocity": 0},
            "minimize": "integral(forces.T.value**2)",
        }
    )
    assert found.verdict == "good"
    assert found.bodies["b"].angle[-1] == pytest.approx(RATIO * 0.8, abs=1e-9)


def test_taylor_refuses_other_joints_than_pins() -> None:
    with pytest.raises(SpecError, match="joints other than pins"):
        mbdkit.run(coupled(), integrator={"name": "taylor"}, formulation="joint-coordinates", time=TIME)


def test_a_start_off_the_constraint_is_assembled() -> None:
    m = links()
    m.joints.clear()
    m.revolute("A", m.ground, "a", points=((0.0, 0.0), (-0.5, 0.0)))
    m.revolute("B", "a", "b", points=((0.5, 0.0), (-0.5, 0.0)))
    m.coupling("G", "a", "b", equation="angle - 1.5*first - 0.01")
    equations = EquationsOfMotion.of(m)
    assert_within(equations.constraints(0.0, equations.q0), 1e-12)


def test_archives_are_read_without_the_part(tmp_path: Path) -> None:
    path = tmp_path / "arm.h5"
    with mbdkit.run(spec_of(), archive=path) as run:
        known = [float(run.bodies["b"].angle[-1]), float(run.joints["G"].reaction_torque[-1])]
    program = (
        "import mbdkit; run = mbdkit.load('arm.h5'); "
        "print([float(run.bodies['b'].angle[-1]), float(run.joints['G'].reaction_torque[-1])])"
    )
    environment = os.environ | {"MBDKIT_DISABLE_PLUGINS": "mbdkit/transmissions"}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(known)
