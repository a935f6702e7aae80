"""Mechanisms that share what was compiled have the starts of mechanisms that were compiled alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbdkit.engine import consistent_start
from mbdkit.engine.consistent_start import Starts
from mbdkit.mechanism.mechanism import Mechanism
from tests.engine.starts import assert_same_bits, moved

from .random_mechanisms import chain, driven_frame, ladder, slides


@pytest.mark.parametrize("kind", [chain, ladder, driven_frame, slides])
def test_shared_starts_have_the_bits_of_starts_alone(kind: Callable[[np.random.Generator], Mechanism]) -> None:
    starts = Starts()
    for seed in (0, 0, 1, 0, 1):
        mechanism = moved(kind(np.random.default_rng(seed)), np.random.default_rng(len(starts._compiled) + seed))
        assert_same_bits(starts.at_start(mechanism), Starts().at_start(mechanism))


def pendulum(arm: float, angle: float = 0.5) -> Mechanism:
    mechanism = Mechanism()
    rod = mechanism.body("rod", mass=1.0, inertia=0.1, position=(0.0, 0.0), angle=angle)
    mechanism.revolute("A", mechanism.ground, rod, points=((0.0, 0.0), (arm, 0.0)))
    return mechanism


def test_only_mechanisms_of_equal_numbers_are_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = []
    compile_mechanism = consistent_start.compile_mechanism
    monkeypatch.setattr(
        consistent_start, "compile_mechanism", lambda one: compiled.append(one) or compile_mechanism(one)
    )
    starts = Starts()
    for arm, angle, expected in ((0.0, 0.1, 1), (0.0, 0.2, 1), (-0.0, 0.2, 2), (0.25, 0.2, 3), (0.0, 0.3, 3)):
        starts.at_start(pendulum(arm, angle))
        assert len(compiled) == expected
