"""The verdict on the flexible slider-crank, on synthetic runs with known errors of their joint forces."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbdkit_paper.flexible_slider_crank.verdict import verdict

TURN = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
EXACT = 50.0 * np.stack([np.cos(TURN), np.sin(TURN)], axis=-1)


class FakeRun(SimpleNamespace):
    """A run that can be closed."""

    def __enter__(self) -> FakeRun:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def study(*runs: tuple[str, str, float, float, float, str]) -> Any:
    """Return a study of runs by family, method, step, relative error of the force, misalignment and status."""

    def opened(error: float, gap: float) -> Any:
        pin = SimpleNamespace(reaction_force=EXACT * (1.0 + error), misalignment_max=gap)
        motor = SimpleNamespace(reaction_force=np.zeros_like(EXACT), misalignment_max=0.0)
        return FakeRun(joint_names=("pin", "motor"), joints={"pin": pin, "motor": motor})

    points = [
        SimpleNamespace(family=kind, axes={"integrator": method, "time.step": step}, status=status,
                        values={"wall_s": 1.0}, error=error, gap=gap)
        for kind, method, step, error, gap, status in runs
    ]  # fmt: skip
    return SimpleNamespace(
        points=points, spec=SimpleNamespace(title="Crank", added=()), run=lambda point: opened(point.error, point.gap)
    )


REFERENCE = ("implicit", "Gauss 3", 2e-6, 0.0, 1e-15, "complete")
FINE = ("explicit", "RK4", 2e-6, 0.01, 1e-15, "complete")
UNSTABLE = ("explicit", "RK4", 5e-6, 0.0, 1.0, "failed")


def test_forces_that_are_wrong_although_joints_hold_are_found() -> None:
    coarse = ("implicit", "Gauss 3", 1e-4, 0.5, 1e-14, "complete")
    found = verdict(study(REFERENCE, FINE, UNSTABLE, coarse))
    assert [str(claim.answer) for claim in found.claims] == ["yes"] * 4
    rows = found.table("joints").rows
    assert rows[1][4] == 1.0  # percent
    assert rows[3][4] == 50.0
    assert rows[2][2:] == ("failed",) * 3
    assert "Gauss 3, 0.0001 s" in found.claim("hidden").computed


@pytest.mark.parametrize(
    ("run", "name"),
    [
        (("implicit", "Gauss 3", 1e-4, 0.5, 1e-3, "complete"), "held"),
        (("explicit", "RK4", 1e-4, 0.01, 1e-14, "complete"), "stable"),
        (("implicit", "Radau IIA 2", 2e-6, 0.3, 1e-14, "complete"), "agree"),
        (("implicit", "Gauss 3", 1e-4, 0.01, 1e-14, "complete"), "hidden"),
    ],
)
def test_each_claim_can_be_refuted(run: tuple[str, str, float, float, float, str], name: str) -> None:
    assert str(verdict(study(REFERENCE, FINE, UNSTABLE, run)).claim(name).answer) == "no"


def test_without_a_reference_nothing_is_said_about_forces() -> None:
    found = verdict(study(FINE, UNSTABLE))
    assert {str(found.claim(name).answer) for name in ("agree", "hidden")} == {"open"}
