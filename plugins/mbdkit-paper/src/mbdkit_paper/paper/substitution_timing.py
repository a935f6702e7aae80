"""Timing of the paper's evaluation method, which substitutes numbers into symbolic matrices at every evaluation.

The equations of motion of a chain of rods are SymPy matrices with numeric masses and lengths. Each evaluation
substitutes time, positions and velocities with ``subs``, and solves the numeric system with LAPACK.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mbdkit.plugin import RunSpec, SpecError
from mbdkit.plugin.files import replacing

EVALUATIONS = 24
"""Number of timed evaluations. The minimum of this many is reproducible even on a busy machine."""
FILE = "substitution.json"


@dataclass(frozen=True)
class Substitution:
    """Time of one evaluation by substitution.

    Attributes
    ----------
    bodies
        Number of bodies.
    least_s, median_s
        Minimum and median processor time of an evaluation [s]; unlike wall time, it does not include waiting.
    evaluations
        Number of timed evaluations.
    """

    bodies: int
    least_s: float
    median_s: float
    evaluations: int


def measure(spec: RunSpec, evaluations: int = EVALUATIONS) -> Substitution:
    """Time the evaluation of a spec's equations by substitution.

    Parameters
    ----------
    spec
        The run; its mechanism is evaluated at states near its start.
    evaluations
        Number of timed evaluations, after one warm-up evaluation.
    """
    mechanism = spec.mechanism()
    system = mechanism.to_sympy()
    matrix, right = system.kkt()
    bodies = mechanism.bodies.values()
    start = np.array([[*body.position, body.angle, *body.velocity, body.angular_velocity] for body in bodies])
    symbols = [*system.q, *system.v]
    taken = []
    for k in range(evaluations + 1):
        state = start + 0.1 * math.sin(k + 1)  # no zeros, because SymPy would drop the terms that they multiply
        numbers = [*state[:, :3].ravel().tolist(), *state[:, 3:].ravel().tolist()]
        begin = time.process_time()
        values = dict(zip(symbols, numbers, strict=True)) | {system.t: 0.1 * k}
        left = np.array(matrix.subs(values).tolist(), dtype=float)
        np.linalg.solve(left, np.array(right.subs(values).tolist(), dtype=float))
        taken.append(time.process_time() - begin)
    taken = sorted(taken[1:])
    return Substitution(len(start), taken[0], taken[len(taken) // 2], len(taken))


def measured(folder: Path, specs: Sequence[RunSpec]) -> tuple[Substitution, ...]:
    """Return the times of evaluation by substitution, measured now or read from an earlier call.

    Parameters
    ----------
    folder
        The folder of the study; the times are stored in its ``measured/substitution.json``.
    specs
        Runs with different numbers of bodies.
    """
    path = folder / "measured" / FILE
    names = [spec.sha256() for spec in specs]
    known = _read(path)
    if any(name not in known for name in names):
        known = {name: known.get(name) or measure(spec) for name, spec in zip(names, specs, strict=True)}
        _write(path, known)
    return tuple(known[name] for name in names)


def _read(path: Path) -> dict[str, Substitution]:
    try:
        found = json.loads(path.read_text("utf-8"))
        return {str(name): Substitution(**entry) for name, entry in found.items()}
    except (OSError, ValueError, TypeError, AttributeError):  # not measured yet, or written by another version
        return {}


def _write(path: Path, times: dict[str, Substitution]) -> None:
    text = json.dumps({name: asdict(entry) for name, entry in times.items()}, indent=2)
    try:
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8", newline="\n")
    except (OSError, SpecError):  # the folder is read-only: measure again next time
        return
