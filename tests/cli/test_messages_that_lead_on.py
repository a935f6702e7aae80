"""The page `messages_that_lead_on.md` has messages that say what to do next, word by word; this file causes them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import MbdkitError
from mbdkit.registry.catalogue import SEPARATE, Registry
from mbdkit.spec import load_spec

PAGE = Path(__file__).with_name("messages_that_lead_on.md")
MESSAGES = dict(re.findall(r"^## (.+?)\n\n((?:> .*\n?)+)", PAGE.read_text("utf-8"), re.MULTILINE))


def _crank(**changes: Any) -> dict[str, Any]:
    """Return a spec of a crank whose motor has a name with a blank."""
    joints = {
        "hub": {"type": "revolute", "bodies": ["ground", "crank"], "at": [0, 0]},
        "knee motor": {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle", "motion": "t"},
    }
    model = {"name": "mechanism", "bodies": {"crank": {"mass": 1, "inertia": 1}}, "joints": joints}
    time = {"end": 1.0, "step": 0.1}
    return {"mbdkit": 1, "model": model, "time": time, "integrator": {"name": "gauss"}, **changes}


CAUSES: dict[str, Callable[[], Any]] = {
    "A model of a distribution that is not installed": lambda: Registry([], []).get("model", "urdf"),
    "An integrator of a distribution that is not installed": lambda: Registry([], []).get("integrator", "sundials-ida"),
    "A name with a blank": lambda: mbdkit.run(_crank(measures={"m": "max(joints.knee_motor.torque)"})),
    "A name with a blank, without its kind": lambda: load_spec(
        _crank(events={"e": {"when": "knee_motor.angle - 1", "action": "note"}})
    ),
    "A Python function as a value": lambda: load_spec(_crank(time={"end": 1.0, "step": lambda: 0.1})),
    "Forces on a model that builds its own": lambda: load_spec(
        _crank(model={"name": "single-pendulum", "forces": {"spring": {}}})
    ),
}


@pytest.mark.parametrize("title", CAUSES)
def test_the_message_is_that_of_the_page(title: str) -> None:
    with pytest.raises(MbdkitError) as raised:
        CAUSES[title]()
    assert str(raised.value) == " ".join(line[2:].strip() for line in MESSAGES[title].splitlines())


def test_the_page_has_no_other_messages() -> None:
    assert [*MESSAGES] == [*CAUSES]


@pytest.mark.parametrize("distribution", SEPARATE)
def test_distributions_have_the_items_that_messages_name(distribution: str) -> None:
    folder = Path(__file__).parents[2] / "plugins" / distribution
    (evidence,) = (folder / "src").rglob("mbdkit-evidence.json")  # of all items, whose names code may compute
    text = evidence.read_text("utf-8")
    for name in SEPARATE[distribution]:
        assert f'"{name}"' in text


def test_methods_add_forces_to_a_model_that_builds_its_own_as_the_message_says() -> None:
    """Expected: the spring adds its energy k (phi - phi_0)^2 / 2 to that of the start."""
    energies = []
    for stiffness in (3.0, None):
        m = load_spec("pendulum").mechanism()
        (rod,) = m.bodies
        if stiffness is not None:
            m.torsion_spring("spring", m.ground, rod, stiffness=stiffness, free_angle=1.0)
        run = mbdkit.run(m, time={"end": 0.1, "step": 0.01}, integrator={"name": "gauss"})
        energies.append(float(run.energy.potential[0]))
    assert energies[0] - energies[1] == pytest.approx(0.5 * 3.0 * (m.bodies[rod].angle - 1.0) ** 2, rel=1e-12)
