"""Starts of several mechanisms at once have the bits of starts alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbdkit.engine.consistent_start import CompiledForStarts, Starts, mechanism_at_start
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_studies.lanes.lane_starts import at_starts
from tests.engine.random_mechanisms import chain, driven_frame, ladder, slides
from tests.engine.starts import assert_same_bits, moved


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
