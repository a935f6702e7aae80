"""First-order states of force elements: a motor whose current lags behind its voltage, against the exact solution."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import mbdkit
from mbdkit import SpecError
from tests.margins import assert_within

INERTIA, OPTIONS = 0.02, {"voltage": 12.0, "resistance": 1.5, "inductance": 0.3, "constant": 0.4, "current": 2.0}
END = 0.5


def model(**options: float) -> dict[str, Any]:
    """A rotor on a pin, driven by the motor; there is no gravity."""
    motor = {"type": "law", "law": "motor", "pathway": {"type": "relative-angle", "bodies": ["ground", "rotor"]}}
    return {
        "name": "mechanism",
        "gravity": [0.0, 0.0],
        "bodies": {"rotor": {"mass": 1.0, "inertia": INERTIA, "position": [0.0, 0.0], "angular_velocity": -3.0}},
        "joints": {"J": {"type": "revolute", "bodies": ["ground", "rotor"], "points": [[0, 0], [0, 0]]}},
        "forces": {"motor": motor | OPTIONS | options},
    }


def exact(times: np.ndarray, **options: float) -> np.ndarray:
    """Angular velocity and current (T, 2): J w' = k i, L i' = U - R i - k w, by the matrix exponential."""
    p = OPTIONS | options
    matrix = np.zeros((3, 3))
    matrix[0, 1] = p["constant"] / INERTIA
    matrix[1] = np.array([-p["constant"], -p["resistance"], p["voltage"]]) / p["inductance"]
    return np.array([(expm(t * matrix) @ [-3.0, p["current"], 1.0])[:2] for t in times])


def spec_of(model: dict[str, Any], integrator: dict[str, Any], step: float = 0.01, **more: Any) -> dict[str, Any]:
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": END, "step": step}, **more}


def run(integrator: dict[str, Any], step: float = 0.01, **more: Any) -> mbdkit.Run:
    return mbdkit.run(spec_of(model(), integrator, step, **more)).check()


def error(done: mbdkit.Run) -> float:
    """Largest error of angular velocity and current at the end."""
    value = done.states["motor.current"].value[-1]
    return float(np.abs([done["rotor"].angular_velocity[-1], value] - exact(done.time[-1:])[0]).max())


GAUSS, RADAU = {"name": "gauss", "stages": 2}, {"name": "radau-iia", "stages": 2}
FIXED = {
    "rk4": ({"name": "rk4"}, {}, 4),
    "rk-gill": ({"name": "rk-gill"}, {}, 4),
    "gauss": (GAUSS, {}, 4),
    "gauss, fixed-point": ({"name": "gauss", "stages": 2, "stage_solver": "fixed-point"}, {}, 4),
    "radau": (RADAU, {}, 3),
    "radau, index-2": (RADAU, {"formulation": "index-2"}, 3),
    "radau, index-3": (RADAU, {"formulation": "index-3"}, 3),
    "radau, ggl": (RADAU, {"formulation": "ggl"}, 3),
    "rk4, projection": ({"name": "rk4"}, {"stabilization": "projection"}, 4),
    "gauss, symmetric": (GAUSS, {"stabilization": {"name": "projection", "symmetric": True}}, 4),
}


def alternating_motor() -> dict[str, Any]:
    """A rod that swings under gravity, driven by the nonlinear motor at an alternating voltage."""
    swinging = model()
    del swinging["gravity"]
    swinging["bodies"]["rotor"]["position"] = [0.2, 0.0]
    swinging["joints"]["J"]["points"] = [[0, 0], [-0.2, 0]]
    swinging["bodies"]["rotor"]["velocity"] = [0.0, -0.6]
    swinging["forces"]["motor"]["law"] = "alternating-motor"
    return swinging


@pytest.mark.parametrize("name", FIXED)
def test_the_order_holds_for_a_nonlinear_and_non_autonomous_state(name: str) -> None:
    # expected: angle, angular velocity and current by DOP853 in minimal coordinates
    p = OPTIONS

    def rates(t: float, y: np.ndarray) -> list[float]:
        angle, velocity, current = y
        torque = p["constant"] * current - 9.81 * 0.2 * np.cos(angle)
        back = p["resistance"] * (current + current**3 / 10) + p["constant"] * velocity
        return [velocity, torque / (INERTIA + 0.2**2), (p["voltage"] * np.sin(5 * t) - back) / p["inductance"]]

    oracle = solve_ivp(rates, (0.0, END), [0.0, -3.0, p["current"]], method="DOP853", rtol=1e-13, atol=1e-13)
    integrator, sections, order = FIXED[name]
    # velocities of index 3 have order s, as claimed
    compared = [0, 2] if sections.get("formulation") == "index-3" else [0, 1, 2]
    errors = []
    for step in (0.0125, 0.00625):
        done = mbdkit.run(spec_of(alternating_motor(), integrator, step, **sections)).check()
        found = (done["rotor"].angle[-1], done["rotor"].angular_velocity[-1], done.states["motor.current"].value[-1])
        errors.append(np.abs(np.array(found) - oracle.y[:, -1])[compared].max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("method", ["dopri5", "dop853", "radau-iia"])
def test_the_error_of_states_controls_the_step(method: str) -> None:
    adaptive = {"name": method, "adaptive": True}
    coarse, fine = (error(run({**adaptive, "rtol": rtol, "atol": rtol})) for rtol in (1e-5, 1e-9))
    assert_within(coarse, 1e-3)
    assert_within(fine, 1e-7)


@pytest.mark.parametrize(
    "integrator", [{"name": "dopri5", "adaptive": True}, {"name": "radau-iia", "adaptive": True, "stages": 3}]
)
def test_states_inside_steps_have_the_accuracy_of_dense_output(integrator: dict[str, Any]) -> None:
    done = run({**integrator, "rtol": 1e-8, "atol": 1e-8}, output={"interval": 0.013})
    assert_within(done.states["motor.current"].value - exact(done.time)[:, 1], 1e-5)


def test_a_stiff_state_is_solved_by_an_implicit_method() -> None:
    """A time constant of 1e-7 s in steps of 0.01 s: the current follows the velocity at once."""
    done = mbdkit.run(spec_of(model(inductance=1.5e-7), {"name": "radau-iia", "stages": 3})).check()
    velocity, current = exact(done.time[-1:], inductance=1.5e-7)[0]
    assert done["rotor"].angular_velocity[-1] == pytest.approx(velocity, rel=1e-5)
    assert done.states["motor.current"].value[-1] == pytest.approx(current, rel=1e-5)


def test_states_are_archived_with_their_rates_and_units(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    mbdkit.run(spec_of(model(), {"name": "rk4"}), archive=path)
    done = mbdkit.load(path)
    states = done.file["states"]
    assert list(states["state"].asstr()[:]) == ["motor.current"]
    assert list(states["row_units"].asstr()[:]) == ["A"]
    velocity, current = done["rotor"].angular_velocity, states["value"][:, 0]
    voltage = OPTIONS["voltage"] - OPTIONS["resistance"] * current - OPTIONS["constant"] * velocity
    np.testing.assert_allclose(states["rate"][:, 0], voltage / OPTIONS["inductance"], rtol=1e-12)
    np.testing.assert_allclose(done["rotor"].angular_acceleration, OPTIONS["constant"] * current / INERTIA, rtol=1e-12)
    assert_within(done.energy.balance, 3e-6)  # the motor does work
    assert states["value"][0, 0] == OPTIONS["current"]


@pytest.mark.parametrize("name", ["rk4", "dopri5", "gauss"])
def test_runs_in_lanes_have_the_states_of_single_runs(name: str) -> None:
    voltages = [6.0, 9.0, 12.0]
    alone = [mbdkit.run(spec_of(model(voltage=voltage), {"name": name})).data_sha256 for voltage in voltages]
    study = mbdkit.ensemble(spec_of(model(), {"name": name}), {"model.forces.motor.voltage": voltages}, store="hashes")
    assert list(study.columns()["data_sha256"]) == alone


def test_what_does_not_include_states_says_so() -> None:
    with pytest.raises(SpecError, match=r"Lobatto.*does not include first-order states \(motor.current\)"):
        mbdkit.run(spec_of(model(), {"name": "rattle"}, formulation="index-3"))


def test_a_state_of_a_law_is_at_rest_in_an_equilibrium() -> None:
    # expected: the current voltage / resistance, and its torque balanced by a spring
    sprung = model()
    sprung["forces"]["spring"] = {"type": "torsion-spring", "bodies": ["ground", "rotor"], "stiffness": 5.0}
    found = mbdkit.equilibrium(spec_of(sprung, {"name": "rk4"}))
    assert found.state[0] == pytest.approx(12.0 / 1.5, rel=1e-12)
    assert found["rotor"][2] == pytest.approx(0.4 * 8.0 / 5.0, rel=1e-12)
    sprung["forces"]["motor"]["current"] = found.state[0]
    sprung["bodies"]["rotor"] |= {"angle": found["rotor"][2], "angular_velocity": 0.0}
    done = mbdkit.run(spec_of(sprung, {"name": "rk4"})).check()
    assert_within(np.ptp(done.states["motor.current"].value), 1e-12)


def test_a_gradient_is_that_of_the_matrix_exponential() -> None:
    # expected: complex steps of the exact solution
    measures = ["final(rotor.angular_velocity)", 'final(states["motor.current"].rate)']
    keys = [f"model.forces.motor.{name}" for name in OPTIONS]
    found = mbdkit.gradient(spec_of(model(), {"name": "dop853"}), measures, keys, check=False)

    def at_end(p: np.ndarray) -> np.ndarray:
        voltage, resistance, inductance, constant, current = p
        matrix = np.zeros((3, 3), dtype=complex)
        matrix[0, 1] = constant / INERTIA
        matrix[1] = np.array([-constant, -resistance, voltage]) / inductance
        state = expm(END * matrix) @ np.array([-3.0, current, 1.0])
        return np.array([state[0], (matrix @ state)[1]])

    numbers = np.array([*OPTIONS.values()], dtype=complex)
    wanted = np.array([at_end(numbers + 1e-20j * np.eye(5)[k]).imag / 1e-20 for k in range(5)]).T
    np.testing.assert_allclose(found.jacobian, wanted, rtol=1e-8, atol=1e-8)
