"""Steps that are too long for the fastest motion of a mechanism: the first cause of a failed or inaccurate run."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbdkit.base.errors import MbdkitError, StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.equations import JACOBIAN, STIFFNESS
from mbdkit.engine.tangents import dense_parts
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec import RunSpec

LONGEST_SHARE = 1 / 8  #: Longest step that is not the cause of errors, as a share of the period of the fastest motion.
FINE = 20  #: Number of steps per period that is advised.
RANK = 1e-10  #: Singular values of the constraints below this share of the largest count as zero.
MOST_COORDINATES = 600  #: Frequencies of larger mechanisms are not computed: the time grows with the cube.


class Start(NamedTuple):
    """The start of a run of a mechanism: its equations, positions and velocities (n,), and size [m]."""

    equations: EquationsOfMotion
    q: np.ndarray
    v: np.ndarray
    size: float


def coarse_step(spec: RunSpec, start: Callable[[], Start] | None = None) -> str:
    """Return a sentence if the fixed step of a run is too long for the fastest motion at its start, otherwise "".

    - `spec`: spec of the run or, if `start` is given, of a run that differs in numbers of its model only.
    - `start`: returns the start of the run; by default, that of `spec`.
    """
    step = None if spec.claims.adaptive else spec.time.step
    if step is None:
        return ""
    try:
        with np.errstate(all="ignore"):
            fastest = _fastest(spec, _start_of(spec) if start is None else start())
    except (MbdkitError, StepError, ValueError, np.linalg.LinAlgError):  # the state or a derivative is not finite
        return ""
    period = 2.0 * math.pi / fastest if fastest > 0.0 else math.inf
    if not step > LONGEST_SHARE * period:
        return ""
    return (
        f"The step of {step:g} s is {step / period:.2g} of the period of {period:.3g} s of the fastest motion at "
        f"the start; use steps of at most {period / FINE:.1g} s."
    )


def _start_of(spec: RunSpec) -> Start:
    setup = RunSetup.of(spec)
    equations = EquationsOfMotion(setup.workspace)
    return Start(equations, equations.q0, equations.v0, setup.size)


def _fastest(spec: RunSpec, start: Start) -> float:
    """Return the largest of the rates at the start [1/s]: turning, oscillation, acceleration through its size."""
    (equations, q, v, size), t = start, spec.time.start
    acc, lam = equations.accelerations(t, q, v)
    linear = np.hypot(*acc.reshape(-1, 3)[:, :2].T)
    rates = [np.max(np.abs(v[2::3])), math.sqrt(np.max(linear) / size) if size else 0.0]
    if equations.n <= MOST_COORDINATES and not spec.mechanism().beams:
        terms = equations.evaluated_terms(t, q, v, acc, lam)
        stiffness, jacobian = dense_parts(equations.workspace, [STIFFNESS, JACOBIAN], terms)
        _, sizes, rows = np.linalg.svd(jacobian)
        free = rows[np.sum(sizes > RANK * np.max(sizes, initial=0.0)) :]  # velocities that the joints allow
        reduced = np.linalg.pinv(free * equations.mass @ free.T) @ (free @ stiffness @ free.T)
        rates.append(math.sqrt(np.max(np.abs(np.linalg.eigvals(reduced)), initial=0.0)))
    return float(max(rates))
