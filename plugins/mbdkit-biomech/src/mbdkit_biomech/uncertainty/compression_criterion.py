"""Criterion of the verdict on the compression of knees: muscles only pull, and press the bones together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.plugin import Finding
from mbdkit_biomech.inverse_dynamics.compute import (
    Inverse,
    compression,
    reaction_forces_without_muscles,
    recorded_states,
)
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.persons.landmarks import LEFT

STANCE = 0.5
"""A foot stands alone if its load exceeds this share of the largest load of all plates, and no other one acts."""

LESS, FRAMES = 0.05, 0.05
"""Compression is doubtful if it is smaller than without muscles by more than the first share of the ground's force in
more than the second share of the rows in single stance."""

PULLED = 0.01
"""A knee is pulled if muscles leave a tension of more than this share of its largest force."""


def compression_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt for each knee whose compression is smaller than the force of the ground less weight and inertia of
    the segments beneath, which is that without muscles.
    """
    names, loads = result.problem.names, result.loads
    if result.recruited is None or not len(loads.names):
        return
    measured = len(result.problem.loads)  # further loads are those of worn devices
    size = np.sqrt(np.sum(loads.force * loads.force, axis=2))[:, :measured]
    joints = list(result.problem.prepared.workspace.mechanism.joints)
    reactions, without = recorded_states(result).reactions[:, :, :2], reaction_forces_without_muscles(result)
    for leg in ("", LEFT):
        foot, knee = f"foot{leg}", f"knee{leg}"
        own = [index for index, body in enumerate(loads.bodies[:measured]) if body == foot]
        if not own or knee not in joints or f"shank{leg}" not in names.mechanism.bodies:
            continue
        mine = np.sum(size[:, own], axis=1)
        alone = (mine > STANCE * np.max(size)) & (np.sum(size, axis=1) - mine <= 0)
        shank = names.body(f"shank{leg}", "model")
        less = compression((without - reactions)[:, joints.index(knee)], result.motion.q, shank)
        wrong = np.flatnonzero(alone & (less > LESS * mine))
        if wrong.size > FRAMES * max(1, int(np.sum(alone))):
            row = wrong[int(np.argmax(less[wrong]))]
            yield doubt(
                "compression",
                f"muscles reduce the compression of {knee} in single stance by up to {less[row]:.4g} N (t = "
                f"{result.motion.time[row]:.6g} s), below the force of the ground less weight and inertia of the "
                "segments beneath; muscles pull, and can only add to it: check the paths of the muscles that cross it",
            )


def pulled_knees(result: Inverse) -> Iterator[Finding]:
    """Yield a finding for each knee that muscles pull apart, beyond what weight and inertia of the segments beneath do
    without muscles; it makes the result bad.
    """
    names, joints = result.problem.names, list(result.problem.prepared.workspace.mechanism.joints)
    legs = [leg for leg in ("", LEFT) if f"knee{leg}" in joints and f"shank{leg}" in names.mechanism.bodies]
    if result.recruited is None or not legs:
        return
    reactions, without = recorded_states(result).reactions[:, :, :2], reaction_forces_without_muscles(result)
    for leg in legs:
        index, shank = joints.index(f"knee{leg}"), names.body(f"shank{leg}", "model")
        pushed, alone = (compression(one[:, index], result.motion.q, shank) for one in (reactions, without))
        row = int(np.argmin(pushed - np.minimum(alone, 0.0)))
        largest = float(np.max(np.linalg.norm(reactions[:, index], axis=1)))
        if pushed[row] < min(alone[row], 0.0) - PULLED * largest:
            sentence = (
                f"knee{leg} is pulled: muscles leave a tension of {-pushed[row]:.4g} N along the shank at t = "
                f"{result.motion.time[row]:.6g} s, which cartilage cannot carry: give the muscles of the quadriceps a "
                "`patella`, and check the paths of the muscles that cross the knee"
            )
            yield Finding("compression", "bad", sentence)
