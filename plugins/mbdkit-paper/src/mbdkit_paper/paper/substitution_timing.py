"""Timing of the paper's evaluation method, which substitutes numbers into symbolic matrices at every evaluation.

The equations of motion of a chain of rods are SymPy matrices with numeric masses and lengths. Each evaluation
substitutes time, positions and velocities with ``subs``, and solves the numeric system with LAPACK.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.files import replacing
from mbdkit.spec.run_spec import RunSpec

#: Number of timed evaluations. The minimum of this many is reproducible even on a busy machine.
EVALUATIONS = 24
FILE = "substitution.json"


def measure(spec: RunSpec) -> float:
    """Return the shortest processor time [s] of an evaluation of a spec's equations by substitution, at states near its
    start; unlike wall time, it does not include waiting.
    """
    mechanism = spec.mechanism()
    system = mechanism.to_sympy()
    matrix, right = system.kkt()
    bodies = mechanism.bodies.values()
    start = np.array([[*body.position, body.angle, *body.velocity, body.angular_velocity] for body in bodies])
    symbols = [*system.q, *system.v]
    taken = []
    for k in range(EVALUATIONS + 1):
        state = start + 0.1 * math.sin(k + 1)  # no zeros, because SymPy would drop the terms that they multiply
        numbers = [*state[:, :3].ravel().tolist(), *state[:, 3:].ravel().tolist()]
        begin = time.process_time()
        values = dict(zip(symbols, numbers, strict=True)) | {system.t: 0.1 * k}
        left = np.array(matrix.subs(values).tolist(), dtype=float)
        np.linalg.solve(left, np.array(right.subs(values).tolist(), dtype=float))
        taken.append(time.process_time() - begin)
    return min(taken[1:])  # the first one warms up


def measured(folder: Path, specs: Sequence[RunSpec]) -> list[float]:
    """Return the times of evaluation by substitution [s], measured now or read from an earlier call.

    Parameters
    ----------
    folder
        The folder of the study; the times are stored in its ``measured/substitution.json``.
    """
    path = folder / "measured" / FILE
    by_name = {spec.sha256(): spec for spec in specs}
    known = _read(path)
    if not by_name.keys() <= known.keys():
        known = {name: known.get(name) or measure(spec) for name, spec in by_name.items()}
        with suppress(OSError, SpecError):  # the folder is read-only: measure again next time
            path.parent.mkdir(exist_ok=True)
            with replacing(path) as temporary:
                temporary.write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8", newline="\n")
    return [known[name] for name in by_name]


def _read(path: Path) -> dict[str, float]:
    try:
        return {str(name): float(seconds) for name, seconds in json.loads(path.read_text("utf-8")).items()}
    except (OSError, ValueError, TypeError, AttributeError):  # not measured yet, or damaged
        return {}
