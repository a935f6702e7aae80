"""Gradients of inverse dynamics: closed forms of a pendulum and an arm, and differences of computations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.identified import write_identified

TIME = np.linspace(0.0, 2.0, 101)


def pendulum(**parameters: float) -> dict[str, Any]:
    """Return a pendulum whose angle is measured, with a stop that pushes beyond 0.2 rad."""
    known = {"mass": 1.3, "inertia": 0.1, "length": 0.7, "stiffness": 25.0} | parameters
    return {
        "mbdkit": 1, "parameters": known,
        "model": {
            "name": "mechanism",
            "bodies": {"rod": {"mass": "mass", "inertia": "inertia", "position": [0.0, "-length"]}},
            "joints": {"hip": {"type": "revolute", "bodies": ["ground", "rod"], "at": [0.0, 0.0]}},
            "forces": {
                "stop": {
                    "type": "law", "law": "one-sided", "acts": "tension", "stiffness": "stiffness", "free_length": 0.2,
                    "pathway": {"type": "relative-angle", "bodies": ["ground", "rod"]},
                },
            },
        },
        "motion": {
            "data": {"time": TIME, "hip": 0.5 * np.sin(3.0 * TIME)}, "columns": {"hip.angle": "hip"}, "smooth": "none",
        },
    }  # fmt: skip


TORQUE = "actuators.hip.value"
PARAMETERS = ["mass", "inertia", "length", "stiffness"]


def final_torque(**parameters: float) -> float:
    with mbdkit.inverse(pendulum(**parameters), measures={"torque": f"at({TORQUE}, 0.6)"}) as run:
        return float(run.measures["torque"])


def test_inverse_dynamics_takes_estimated_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_identified(tmp_path / "fit.h5", {"stiffness": 30.0, "mass": 1.5}, [[1.0, 0.1], [0.1, 0.04]])
    spec = load_inverse_spec(pendulum() | {"parameters": {"from": "fit.h5", "inertia": 0.1, "length": 0.7}})
    assert spec.estimated is not None
    assert spec.estimated.names == ("stiffness", "mass")
    with mbdkit.inverse(spec, measures={"torque": f"at({TORQUE}, 0.6)"}) as run:
        assert run.measures["torque"] == final_torque(stiffness=30.0, mass=1.5)


def test_derivatives_by_values_of_a_table_are_unit_vectors_through_its_spline() -> None:
    # expected: the spring supplies its value at the angle, the cubic spline through the values, in place of the hip
    spec, lengths = pendulum(), np.linspace(-0.6, 0.6, 7)
    spec["model"]["forces"]["stop"] = {
        "type": "law", "law": "table", "table": [lengths.tolist(), (3.0 * lengths).tolist()],
        "pathway": {"type": "relative-angle", "bodies": ["ground", "rod"]},
    }  # fmt: skip
    names = [f"model.forces.stop.table.1.{k}" for k in range(7)]
    found = mbdkit.inverse_gradient(spec, {"t": f"at({TORQUE}, 0.6)"}, [*names, "mass"], check=False)
    np.testing.assert_allclose(found.jacobian[0, :7], CubicSpline(lengths, np.eye(7))(0.5 * np.sin(1.8)), atol=1e-12)
    assert not np.any(found.preparation_error[:7])


def test_derivatives_of_a_torque_are_those_of_its_closed_form() -> None:
    # expected: (m l^2 + I) a + m g l sin(angle) + k (angle - 0.2) is linear in mass, inertia and stiffness, and
    # quadratic in the length, so that central differences of any distance are exact
    found = mbdkit.inverse_gradient(pendulum(), f"at({TORQUE}, 0.6)", PARAMETERS)
    assert found.value[0] == final_torque()
    steps = {"mass": 0.4, "inertia": 0.05, "length": 0.3, "stiffness": 10.0}
    base = pendulum()["parameters"]
    for name, step in steps.items():
        above, below = (final_torque(**{name: base[name] + sign * step}) for sign in (1.0, -1.0))
        assert found[f"at({TORQUE}, 0.6)", name] == pytest.approx((above - below) / (2.0 * step), rel=1e-10)
    angle = 0.5 * np.sin(1.8)
    assert found[f"at({TORQUE}, 0.6)", "stiffness"] == pytest.approx(angle - 0.2, rel=1e-10)
    assert found.check is not None
    assert found.check.is_passed, str(found)


def test_a_stated_uncertainty_is_left_out_of_a_gradient_which_has_no_error_bars() -> None:
    specs = pendulum(), pendulum() | {"uncertainty": {"masses": 0.1}}
    plain, uncertain = (mbdkit.inverse_gradient(spec, f"rms({TORQUE})", "mass", check=False) for spec in specs)
    assert uncertain.jacobian == plain.jacobian


def test_measures_of_workload_agree_with_differences() -> None:
    measures = {
        "work": "integral(max(actuators.hip.power, 0))", "effort": f"rms({TORQUE})",
        "peak": f"mean({TORQUE}**8)**(1/8)", "reaction": "max(abs(joints.hip.force))",
        "stored": "max(forces.stop.potential)", "given": "final(energy.work)",
    }  # fmt: skip
    found = mbdkit.inverse_gradient(pendulum(), measures, PARAMETERS)
    assert found.check is not None
    assert found.check.is_passed, str(found)
    with mbdkit.inverse(pendulum(), measures=measures) as run:
        np.testing.assert_allclose(found.value, [run.measures[name] for name in measures], rtol=1e-13)
    assert found["stored", "stiffness"] == pytest.approx(0.5 * 0.3**2, rel=1e-3)  # at the sampled peak of 0.5 rad
    assert found["stored", "mass"] == 0.0


FOUR_BAR: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"rod": 1.2, "stiffness": 30.0},
    "model": {
        "name": "mechanism",
        "bodies": {
            "crank": {"mass": 1.0, "inertia": 0.1, "position": [0.15, 0.0], "angle": 0.0},
            "rod": {"mass": 2.0, "inertia": 0.2, "position": [0.3, 0.1], "angle": 0.6},
            "lever": {"mass": 1.5, "inertia": 0.3, "position": [1.0, 0.4], "angle": 1.2},
        },
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], [-0.15, 0]]},
            "B": {"type": "revolute", "bodies": ["crank", "rod"], "points": [[0.15, 0], [0, 0]]},
            "C": {"type": "revolute", "bodies": ["rod", "lever"], "points": [["rod", 0], [0.5, 0]]},
            "D": {"type": "revolute", "bodies": ["lever", "ground"], "points": [[-0.5, 0], [1.0, 0]]},
        },
        "forces": {
            "s": {
                "type": "spring-damper", "bodies": ["ground", "lever"], "points": [[0.5, 1.5], [0.2, 0.1]],
                "stiffness": "stiffness", "damping": 0.5, "free_length": 0.5,
            }
        },
    },
    "motion": {
        "data": {"time": TIME, "A": 0.3 + 0.8 * np.sin(3.0 * TIME)}, "columns": {"A.angle": "A"}, "smooth": "none",
    },
}  # fmt: skip


def test_parameters_that_change_the_motion_of_a_linkage_are_chained_through() -> None:
    measures = ["rms(actuators.A.value)", "rms(abs(joints.C.force))", "final(bodies.lever.angle)", "final(energy.work)"]
    parameters = [
        "rod", "stiffness", "model.bodies.lever.mass", "model.joints.D.points.1.0", "model.forces.s.points.1.0",
    ]  # fmt: skip
    found = mbdkit.inverse_gradient(FOUR_BAR, measures, parameters)
    assert found.check is not None
    assert found.check.is_passed, str(found)
    assert np.max(found.preparation_error) < 1e-9
    assert found["final(bodies.lever.angle)", "stiffness"] == 0.0
    assert abs(found["final(bodies.lever.angle)", "rod"]) > 0.1


def test_actuators_that_share_a_load_have_derivatives_unless_the_motion_changes() -> None:
    # expected: two equal actuators on the same joint angle share the load equally
    actuators = {"left": {"joint": "A"}, "right": {"joint": "A"}}
    found = mbdkit.inverse_gradient({**FOUR_BAR, "actuators": actuators}, "rms(actuators.left.value)", "stiffness")
    alone = mbdkit.inverse_gradient(FOUR_BAR, "rms(actuators.A.value)", "stiffness", check=False)
    assert found.jacobian[0, 0] == pytest.approx(0.5 * alone.jacobian[0, 0], rel=1e-9)
    assert found.check is not None
    assert found.check.is_passed, str(found)
    with pytest.raises(SpecError, match=r"the motion depends on 'rod'\. There is no derivative with respect to"):
        mbdkit.inverse_gradient({**FOUR_BAR, "actuators": actuators}, "rms(actuators.left.value)", "rod")
