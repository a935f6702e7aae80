"""Criterion of the verdict on the compression of knees: muscles only pull, and press the bones together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.plugin import Finding
from mbdkit.plugin.equations import elementary
from mbdkit_biomech.inverse_dynamics.compute import Inverse, reaction_forces_without_muscles, recorded_states
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.persons.landmarks import LEFT

STANCE = 0.5
"""A foot stands alone if its load exceeds this share of the largest load of all plates, and no other one acts."""

LESS, FRAMES = 0.05, 0.05
"""Compression is doubtful if it is smaller than without muscles by more than the first share of the ground's force in
more than the second share of the rows in single stance."""


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
        angle = result.motion.q[:, 3 * names.body(f"shank{leg}", "model") + 2]
        down = np.column_stack([elementary.sin(angle), -elementary.cos(angle)])
        less = np.sum(down * (without - reactions)[:, joints.index(knee)], axis=1)
        wrong = np.flatnonzero(alone & (less > LESS * mine))
        if wrong.size > FRAMES * max(1, int(np.sum(alone))):
            row = wrong[int(np.argmax(less[wrong]))]
            yield doubt(
                "compression",
                f"muscles reduce the compression of {knee} in single stance by up to {less[row]:.4g} N (t = "
                f"{result.motion.time[row]:.6g} s), below the force of the ground less weight and inertia of the "
                "segments beneath; muscles pull, and can only add to it: check the paths of the muscles that cross it",
            )
