"""Bodies without inertia that friction cannot turn are reported."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from mbdkit import Mechanism
from mbdkit.spec import example_names, load_spec
from mbdkit_contact.contact_criteria import rolling_point_masses


def test_no_packaged_example_has_one() -> None:
    assert not [finding for name in example_names("run") for finding in rolling_point_masses(load_spec(name))]


@pytest.mark.parametrize(("inertia", "friction", "count"), [(None, 0.3, 1), (0.004, 0.3, 0), (None, 0.0, 0)])
def test_friction_that_cannot_turn_a_disc_without_inertia_is_told(
    inertia: float | None, friction: float, count: int
) -> None:
    m = Mechanism()
    m.body("disc", mass=1.0, inertia=inertia, position=(0, 0.1))
    m.contact(
        "floor", m.ground, "disc", shapes=[{"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.1}}], friction=friction
    )
    spec: Any = SimpleNamespace(mechanism=lambda: m)
    told = [finding.sentence for finding in rolling_point_masses(spec)]
    assert len(told) == count
    assert all("the friction of contact 'floor' does not turn its circle of 0.1 m" in text for text in told)
