"""The comparison of contacts with MuJoCo: its references, MuJoCo's models, and the error of the laws of contact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.benchmarks.contact_cases import CASES, event_driven, pendulum, slide
from tests.benchmarks.contact_studies import law_errors
from tests.benchmarks.contacts import damping_ratio
from tests.margins import assert_within
from tests.witness.pit import pit


def test_pendulum_at_a_wall_is_the_closed_form() -> None:
    case = pendulum()
    assert case.reference is not None
    np.testing.assert_allclose(event_driven(case.model, case.end), case.reference(), atol=1e-12)


def test_top_box_stops_where_friction_stops_it() -> None:
    case = slide(1)
    assert case.reference is not None
    np.testing.assert_allclose(event_driven(case.model, case.end), case.reference(), atol=1e-12)


@pytest.mark.parametrize("name", ["slide-3", "biped", "pendulum"])
def test_mujoco_has_the_masses_and_the_accelerations_of_mbdkit(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    from tests.benchmarks.mujoco_model import mujoco_model

    model = {**CASES[name]().model, "contacts": {}}
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "dop853"}, "time": {"end": 0.01, "step": 0.001}}
    run = mbdkit.run(spec)
    built, data = mujoco_model(CASES[name]().model, 1e-5, "RK4", (0.02, 1.0), (0.9, 0.95, 0.001))
    built.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    mujoco.mj_step(built, data, nstep=1000)
    mujoco.mj_kinematics(built, data)
    for body in model["bodies"]:
        np.testing.assert_allclose(data.body(body).xpos[[0, 2]], run.bodies[body].position[-1], atol=1e-9)


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.9])
def test_damping_ratio_gives_the_restitution(restitution: float) -> None:
    # x'' = -2 r x' - x from x = 0, x' = -1, until the force -2 r x' - x, which is x'', becomes zero
    ratio = damping_ratio(restitution)
    root = np.sqrt(1.0 - ratio**2)
    t = np.linspace(1e-6, np.pi / root, 2_000_001)
    x = -np.exp(-ratio * t) * np.sin(root * t) / root
    v = -np.exp(-ratio * t) * (np.cos(root * t) - ratio / root * np.sin(root * t))
    end = np.flatnonzero(-2.0 * ratio * v - x <= 0.0)[0]
    assert v[end] == pytest.approx(restitution, abs=1e-5)


def test_complementarity_of_few_discs_holds_to_rounding_and_wrong_forces_are_seen() -> None:
    spec: dict[str, Any] = pit(2, 2) | {"time": {"end": 0.05, "step": 1e-3}, "output": {"quantities": []}}
    run = mbdkit.run(spec)
    complementarity, _, closed = law_errors(run, spec, 1e-3)
    assert closed > 0
    assert_within(complementarity, 1e-14)
    elastic = {**spec["model"]["contacts"]}
    elastic = {name: {**contact, "restitution": 0.5} for name, contact in elastic.items()}
    bounced = mbdkit.run(spec | {"model": {**spec["model"], "contacts": elastic}})
    assert law_errors(bounced, spec, 1e-3)[0] > 1e-2  # these impulses are not those of discs without restitution


@pytest.mark.slow
def test_laws_of_100_discs_hold_to_rounding_errors() -> None:
    spec: dict[str, Any] = pit(10, 10) | {
        "time": {"end": 0.3, "step": 1e-3},
        "output": {"every": 1, "quantities": []},
    }
    run = mbdkit.run(spec)
    complementarity, friction, closed = law_errors(run, spec, 1e-3)
    assert closed / run.stats["steps"] > 64  # more contacts than are solved by elimination
    assert_within(max(complementarity, friction), 1e-10)
    assert not any("laws of contact" in warning for warning in run.warnings)
