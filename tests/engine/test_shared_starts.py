"""Mechanisms that share what was compiled have the starts of mechanisms that were compiled alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbdkit.engine import consistent_start
from mbdkit.engine.consistent_start import CompiledForStarts, MechanismAtStart, Starts, mechanism_at_start
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_studies.lanes.lane_starts import at_starts

from .random_mechanisms import chain, driven_frame, ladder, slides


def moved(mechanism: Mechanism, rng: np.random.Generator) -> Mechanism:
    """Return a mechanism with other initial positions and velocities."""
    for name, body in list(mechanism.bodies.items()):
        position = tuple(x + float(rng.uniform(-0.01, 0.01)) for x in body.position)
        update = {"position": position, "angle": body.angle + 0.01, "angular_velocity": float(rng.uniform(-1, 1))}
        mechanism.bodies[name] = body.model_copy(update=update)
    return mechanism


def assert_same_bits(one: MechanismAtStart, other: MechanismAtStart) -> None:
    for name, mine, theirs in zip(
        one.mechanism.topology._fields, one.mechanism.topology, other.mechanism.topology, strict=True
    ):
        assert mine.tobytes() == theirs.tobytes(), name
    assert one.q0.tobytes() == other.q0.tobytes()
    assert one.v0.tobytes() == other.v0.tobytes()
    assert one.assembled.describe() == other.assembled.describe()
    for name in ("order", "below", "rows", "length", "well_scaled", "redundancy"):
        assert getattr(one.mechanism, name) == getattr(other.mechanism, name)


@pytest.mark.parametrize("kind", [chain, ladder, driven_frame, slides])
def test_shared_starts_have_the_bits_of_starts_alone(kind: Callable[[np.random.Generator], Mechanism]) -> None:
    starts = Starts()
    for seed in (0, 0, 1, 0, 1):
        mechanism = moved(kind(np.random.default_rng(seed)), np.random.default_rng(len(starts._compiled) + seed))
        assert_same_bits(starts.at_start(mechanism), mechanism_at_start(mechanism))


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


@pytest.mark.parametrize("kind", [chain, ladder, driven_frame, slides])
def test_starts_of_several_mechanisms_have_the_bits_of_starts_alone(
    kind: Callable[[np.random.Generator], Mechanism],
) -> None:
    """Consistent, inconsistent and impossible initial states are mixed."""
    alone = mechanism_at_start(kind(np.random.default_rng(0)))
    mechanisms = [moved(kind(np.random.default_rng(0)), np.random.default_rng(seed)) for seed in range(6)]
    for mechanism in mechanisms[::2]:  # put where assembly has put it before
        for (name, body), q, v in zip(mechanism.bodies.items(), alone.assembled.q, alone.assembled.v, strict=True):
            update = {"position": tuple(q[:2].tolist()), "angle": float(q[2])}
            velocity = {"velocity": tuple(v[:2].tolist()), "angular_velocity": float(v[2])}
            mechanism.bodies[name] = body.model_copy(update=update | velocity)
    mechanisms[3].hold(*mechanisms[3].bodies)
    groups: dict[CompiledForStarts, list[Mechanism]] = {}
    starts = Starts()
    for mechanism in mechanisms:
        groups.setdefault(starts.compiled(mechanism, 0.0), []).append(mechanism)
    for compiled, members in groups.items():
        for mechanism, start in zip(members, at_starts(compiled, members, [0.0] * len(members)), strict=True):
            if mechanism is mechanisms[3]:
                assert start is None
            else:
                assert start is not None
                assert_same_bits(start, mechanism_at_start(mechanism))
                assert start.assembled.changed == any(mechanism is one for one in mechanisms[1::2])
                assert start.assembled.residual == mechanism_at_start(mechanism).assembled.residual
                assert start.assembled.velocity_residual == mechanism_at_start(mechanism).assembled.velocity_residual
