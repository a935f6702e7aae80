"""Time-stepping in machine code, and many steps at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.integrators.loop.steps_ahead import StepsAhead
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from mbdkit_contact.kernels.stepping_bundle import Stepping
from mbdkit_contact.stepping import CompiledTimeStepping
from mbdkit_contact.time_stepping_methods import MoreauJean, NonsmoothGeneralizedAlpha
from tests.margins import assert_within
from tests.witness.pit import pit

G = 9.81
BOX: dict[str, Any] = {"polygon": [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}


def pile(count: int, friction: float) -> dict[str, Any]:
    """Return a spec of boxes on each other, of which the highest slides with 1 m/s."""
    bodies, contacts = {}, {}
    for i in range(count):
        bodies[f"box{i}"] = {"mass": 2.0, "inertia": 0.05, "position": [0.0, 0.1 + 0.2 * i]}
        lower = {"line": {"point": [0, 0], "normal": [0, 1]}} if i == 0 else BOX
        below = "ground" if i == 0 else f"box{i - 1}"
        contacts[f"on{i}"] = {"bodies": [below, f"box{i}"], "shapes": [lower, BOX], "friction": friction}
    bodies[f"box{count - 1}"]["velocity"] = [1.0, 0.0]
    return {
        "mbdkit": 1, "model": {"name": "mechanism", "bodies": bodies, "contacts": contacts},
        "contact": {"treatment": "time-stepping"}, "integrator": {"name": "moreau-jean"},
        "time": {"end": 0.1, "step": 1e-3}, "output": {"every": 1},
    }  # fmt: skip


def types_of(bundle: Any) -> tuple[Any, ...]:
    """Return dtype and number of dimensions of every array of a bundle."""
    return tuple(types_of(x) if isinstance(x, tuple) else (x.dtype, x.ndim) for x in bundle)


@pytest.mark.parametrize("method", [MoreauJean(), NonsmoothGeneralizedAlpha()])
def test_the_bundle_has_the_types_that_the_kernels_are_compiled_for(method: Any) -> None:
    workspace, _ = build(load_spec(pile(2, 0.5)))
    assert types_of(CompiledTimeStepping(method, workspace).bundle) == types_of(example_of(Stepping))


@pytest.mark.parametrize("count", [1, 6, 15])  # 12 contacts by elimination, and 30 by sweeps and iteration
@pytest.mark.parametrize("method", ["moreau-jean", "nonsmooth-generalized-alpha"])
def test_the_highest_box_of_a_pile_slides_by_coulombs_law(count: int, method: str) -> None:
    """Closed form: it is slowed down by mu g, and its normal force is its weight; each box bears those above it."""
    run = mbdkit.run(pile(count, 0.5), integrator={"name": method})
    t, top = run.time, run.bodies[f"box{count - 1}"]
    assert top.velocity[:, 0] == pytest.approx(1.0 - 0.5 * G * t, abs=1e-11)
    for i in range(count):
        own = [run.contacts[name] for name in run.contacts if name.startswith(f"on{i}.")]
        pressed, rubbed = (sum(getattr(one, kind)[1:] for one in own) for kind in ("normal_force", "friction_force"))
        assert pressed == pytest.approx(2.0 * G * (count - i), rel=1e-9)
        assert rubbed == pytest.approx(-0.5 * 2.0 * G, rel=2e-9)
    assert_within(run.bodies["box0"].velocity, 1e-11 if count > 1 else np.inf)


def test_impulses_of_many_contacts_are_exact() -> None:
    """60 discs fall into a pit: no contact with an impulse separates by more than rounding errors afterwards."""
    run = mbdkit.run(pit(10, 6), time={"end": 0.12, "step": 1e-3}, output={"every": 1, "quantities": []})
    normal = run.array("contacts/normal_force")
    assert np.max(np.sum(normal > 0.0, axis=1)) > 30
    assert not any("laws of contact" in warning for warning in run.warnings)


@pytest.mark.parametrize("method", ["moreau-jean", "nonsmooth-generalized-alpha"])
def test_many_steps_at_once_yield_the_same_bits_as_one_by_one(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> mbdkit.Run:
        events = {"seated": {"when": "contacts.seat.gap - 1e-4", "direction": "falling"}}
        return mbdkit.run(
            "sit-down", contact={"treatment": "time-stepping"}, integrator={"name": method}, events=events,
            time={"end": 2.0, "step": 2e-3}, output={"every": 5},
        )  # fmt: skip

    several = run()
    monkeypatch.setattr(StepsAhead, "of", lambda *_: None)
    single = run()
    assert len(several.events) > 0
    assert several.data_sha256 == single.data_sha256
    assert several.measures == single.measures
    assert several.impacts.time.tolist() == single.impacts.time.tolist()
