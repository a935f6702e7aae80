"""Muscles on both sides of a knee that act together, which recruitment leaves out.

The extensors and flexors of a knee have a larger least activation than recruitment needs, at two times of the stance:

- from the end of the swing to the loading response, both groups act in all strides of 14 persons (Dynamic knee muscle
  co-contraction quantified during walking, IEEE 2016), with mean peaks of 5 to 15 % of a maximal contraction at heel
  strike (M. O. Ericson, R. Nisell and J. Ekholm, Scand. J. Rehabil. Med. 18 (1986) 159-163);
- from midstance to the end of the stance, in a third of the strides (PubMed 26198265, 30 persons); that they then are
  half as active is an assumption.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np

from mbdkit_biomech.persons.landmarks import LEFT

InverseProblem: TypeAlias = Any  #: Class of `mbdkit_biomech.inverse_dynamics.compute`, whose module imports this one.

#: Shares of the stance between which the activation rises from 0 and falls to 0 again, by phase.
PHASES = {"loading": ((-0.15, -0.05, 0.15, 0.35), (0.0, 1.0, 1.0, 0.0)),
          "late stance": ((0.25, 0.4, 0.8, 1.0), (0.0, 1.0, 1.0, 0.0))}  # fmt: skip

CONTACT = 20.0  #: Force of the ground from which a foot stands [N].

USUAL = 0.65  #: Duration of a stance of which both ends are cut [s].


def stance_shares(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the shares (T,) of the stance that have passed: from 0 to 1 in a stance, and continued to both sides of
    it; of several stances, that of the nearest one.

    Parameters
    ----------
    force
        (T,) magnitude of the force of the ground.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], force > CONTACT, [False]]))).reshape(-1, 2).tolist()
    spans = [[time[first], time[end - 1], first > 0, end < len(time)] for first, end in edges]
    usual = max((end - first for first, end, *whole in spans if all(whole)), default=USUAL)
    found = np.full(len(time), np.inf)
    for first, end, has_start, has_end in spans:
        first = first if has_start else end - max(usual, end - first)
        end = end if has_end else first + max(usual, end - first)
        share = (time - first) / (end - first)
        found = np.where(np.abs(share - 0.5) < np.abs(found - 0.5), share, found)
    return found


def shared_activations(problem: InverseProblem) -> Iterator[tuple[str, str, np.ndarray]]:
    """Yield knee, phase, and the shares (T, M) of the largest common activation that the muscles then have, for knees
    of legs whose foot has a load, and whose muscles are on both sides.
    """
    muscles, time = problem.recruiter.muscles, problem.measured.time
    names = [*problem.names.mechanism.bodies]
    for leg in ("", LEFT):
        loads = [one for one in problem.loads.values() if names[one.body] == f"foot{leg}"]
        bodies = [{item.on for item in muscle.path} for muscle in muscles.values()]
        extends = np.array([m.patella is not None and m.patella.joint == f"knee{leg}" for m in muscles.values()])
        bends = np.array([{f"shank{leg}"} < on and f"foot{leg}" not in on for on in bodies]) & ~extends
        if not loads or not extends.any() or not bends.any():
            continue
        share = stance_shares(time, np.linalg.norm(sum(one.at(time, one.force) for one in loads), axis=1))
        for phase, (at, values) in PHASES.items():
            yield f"knee{leg}", phase, np.interp(share, at, values)[:, None] * (extends | bends)
