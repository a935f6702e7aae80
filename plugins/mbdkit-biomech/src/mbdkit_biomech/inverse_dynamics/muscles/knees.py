"""Forces in knees beside those of the joint: of the patella on the thigh, of both compartments, and the compression."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from mbdkit.base.text import listed
from mbdkit_biomech.inverse_dynamics.files.measured_table import cited
from mbdkit_biomech.muscles.patella import contact_share
from mbdkit_biomech.persons.landmarks import LEFT

Inverse: TypeAlias = Any  #: Class of `mbdkit_biomech.inverse_dynamics.compute`, whose module imports this one.


def left_out_of_recruitment(result: Inverse) -> list[str]:
    """Return sentences on actuators without muscles, on knees that bend farther than the data of patellas, and on
    channels of EMG that disagree with recruitment.
    """
    recruiter, recruited, found = result.problem.recruiter, result.recruited, []
    if recruiter is None or recruited is None:
        return []
    pairs = zip(result.problem.actuators, recruited.sharing.driven.tolist(), strict=True)
    if alone := [actuator.name for actuator, driven in pairs if not (driven or actuator.is_residual)]:
        copied = all(name.endswith(LEFT) for name in alone)
        hint = "; `symmetric_muscles: true` in the model gives the second leg those of the first one" if copied else ""
        found = [
            f"no muscle acts on {listed(alone, 'and')}, so that forces of these joints lack those of muscles{hint}"
        ]
    bent = {one.joint: one.beyond_data(result.motion.q) for one in recruiter.patellas.values()}
    found += filter(None, bent.values())
    names = list(recruiter.muscles)
    return found + [
        f"the EMG of {names[one.muscle]} (column '{cited(one.column)}') {why}" for one, why in recruited.targets.remarks
    ]


def knee_forces(result: Inverse, compression: np.ndarray) -> np.ndarray:
    """Return the forces in knees [N]: of the patella on the thigh, in the medial and the lateral compartment, and the
    compression with its bar, as in `KNEES`.

    Parameters
    ----------
    compression
        (T, K, 3) compression along the shank, and how far the true one may lie below and above.

    Returns
    -------
    ndarray
        (T, K, 6); nan for knees without patella or without compartments. A negative force of a compartment means that
        muscles which can close it are lacking.
    """
    recruiter, recruited = result.problem.recruiter, result.recruited
    names, q = result.problem.source.result_names["knees"], result.motion.q
    found = np.full((len(q), len(names), 6), np.nan)
    found[..., 3:] = compression
    if recruiter is None or recruited is None:
        return found
    for index, patella in recruiter.patellas.items():
        own = found[:, names.index(patella.joint), 0]
        own[:] = np.nan_to_num(own) + contact_share(patella.flexion(q)) * recruited.force[:, index]
    for knee in recruiter.targets.knees:
        pair, own = knee.moment / knee.width, found[:, names.index(knee.joint)]
        own[:, 1:3] = 0.5 * own[:, [3]] + np.stack([pair, -pair], axis=1)
    return found
