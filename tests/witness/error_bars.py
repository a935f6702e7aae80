"""Compares the estimated errors of runs with their true errors, on the mechanisms of `known_motions`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mbdkit
from mbdkit.archive.accuracy import Accuracy
from mbdkit.engine.observed_states import JointSums, StateObserver
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec

from .known_motions import Known
from .running import gauss

Array = NDArray[np.floating[Any]]

FIXED: dict[str, dict[str, Any]] = {
    "rk-gill": {"name": "rk-gill"},
    "rk4": {"name": "rk4"},
    "gauss-2": gauss(2),
    "gauss-3": gauss(3),
    "radau-iia-3": {"name": "radau-iia", "stages": 3},
}
FACTORS = (4.0, 2.0, 1.0, 0.5)
"""Steps of the methods, times that of the problem."""

ASKED = (1e-3, 1e-5, 1e-7, 1e-9)
"""Accuracies that are asked, so that pilots estimate the errors."""

TOLERANCES = (1e-5, 1e-7, 1e-9, 1e-11)
"""Tolerances of adaptive DOP853; the first and the third with rows from dense output, the others at its own steps."""

LOW, HIGH, NEVER = 1 / 5, 3.0, 10.0
"""Limits of true over estimated error: in nearly all rows, and the one that is never to be passed."""

ROWS = 100

FLOOR = 1e-11
"""Accuracy of the known motions, relative to the largest value of a quantity; below it, nothing is compared."""


@dataclass(frozen=True)
class Case:
    """A run and what its estimates are worth.

    Attributes
    ----------
    problem, method, setting
        What was run.
    status
        Of the run.
    known_until, end
        Times [s].
    ratios
        True over estimated error of all quantities in all known rows in which one of them exceeds the floor.
    good, worst_true_share
        Whether the reactions count as known to 5 % until the end, and the largest true error of a reaction over its
        peak.
    where
        Quantity and time of the largest and of the smallest ratio.
    """

    problem: str
    method: str
    setting: float
    status: str
    known_until: float
    end: float
    ratios: Array
    good: bool
    worst_true_share: float
    where: str


class Truth:
    """True states and reactions of a problem, computed once for each set of times."""

    def __init__(self, known: Known):
        self.known = known
        self._found: dict[bytes, tuple[Array, ...]] = {}
        spec = load_spec(
            {"mbdkit": 1, "model": known.model, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 1}}, ()
        )
        self._workspace = build(spec)[0]

    def at(self, times: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Return position, velocity, force, torque, and the running maxima of their own errors."""
        key = times.tobytes()
        if key not in self._found:
            values = self._with_reactions(times, *self.known.solve(times))
            floors = [FLOOR * np.max(np.abs(x), initial=0.0) for x in values]
            floors[3] = max(floors[3], floors[2] * self._workspace.mechanism.length)
            spread = [np.zeros_like(x) for x in values]
            if self.known.again is not None:
                others = self._with_reactions(times, *self.known.again(times))
                spread = [np.maximum.accumulate(np.abs(x - y), axis=0) for x, y in zip(values, others, strict=True)]
            self._found[key] = (*values, *(10 * s + f for s, f in zip(spread, floors, strict=True)))
        found = self._found[key]
        return found[:4], found[4:]

    def _with_reactions(self, times: Array, position: Array, velocity: Array) -> tuple[Array, ...]:
        """Return states with the reactions that belong to them.

        Reactions are a function of the state, which `test_four_bar`, `test_pendulum` and `test_redundant` compare with
        independent ones.
        """
        ground = np.zeros((len(times), 3))
        q, v = (np.hstack([x.reshape(len(times), -1), ground]) for x in (position, velocity))
        observer = StateObserver(self._workspace.with_own_pivots())
        out = observer.arrays(len(times))
        assert observer.observe(times, q, v, out) is None
        wrench = JointSums(self._workspace.mechanism).sum(out.reactions)
        return position, velocity, wrench[..., :2], wrench[..., 2]


def run_case(truth: Truth, method: str, factor: float) -> Case:
    """Run a problem with a check and compare; `factor` is that of the step, or the tolerance of ``dop853``."""
    known = truth.known
    coarsest = max(FACTORS) * known.step
    interval = coarsest * max(1, round(known.end / ROWS / coarsest))
    if method == "dop853":
        integrator: dict[str, Any] = {"name": "dop853", "adaptive": True, "rtol": factor, "atol": factor}
        time: dict[str, Any] = {"end": known.end}
        output: dict[str, Any] = {"interval": interval} if TOLERANCES.index(factor) % 2 == 0 else {"every": 1}
    else:
        integrator, step = FIXED[method], factor * known.step
        time, output = {"end": known.end, "step": step}, {"every": round(interval / step)}
    spec = {"mbdkit": 1, "model": known.model, "integrator": integrator, "time": time, "output": output}
    run = mbdkit.run({**spec, "check": True})
    accuracy = run.accuracy
    if accuracy is None or len(run.time) < 2:
        return Case(known.name, method, factor, run.status, math.nan, known.end, np.zeros(0), False, math.nan, "")
    return compare(run, accuracy, truth, (known.name, method, factor))


def run_asked(truth: Truth, asked: float) -> Case:
    """Run a problem with an accuracy that is asked, and compare."""
    known = truth.known
    run = mbdkit.run({"mbdkit": 1, "model": known.model, "time": {"end": known.end}, "accuracy": asked})
    assert run.accuracy is not None
    return compare(run, run.accuracy, truth, (known.name, "asked", asked))


def compare(run: mbdkit.Run, accuracy: Accuracy, truth: Truth, names: tuple[str, str, float]) -> Case:
    """Compare the estimated errors of a run with the true ones."""
    values, floors = truth.at(run.time)
    paths = ("trajectory/position", "trajectory/velocity", "joints/reaction_force", "joints/reaction_torque")
    true = [np.abs(run.array(path) - value) for path, value in zip(paths, values, strict=True)]
    true[2], floors = np.linalg.norm(true[2], axis=-1), (*floors[:2], np.linalg.norm(floors[2], axis=-1), floors[3])
    estimates = (accuracy.position_error, accuracy.velocity_error, accuracy.reaction_error, accuracy.torque_error)
    ratios, tops = [], []
    for name, error, estimate, floor in zip(
        ("position", "velocity", "force", "torque"), true, estimates, floors, strict=True
    ):
        error = np.maximum.accumulate(error, axis=0)
        compared = np.isfinite(estimate) & ((error > floor) | (estimate > 5 * floor))
        # the witness itself is known to its floor only
        low, high = np.maximum(error - floor, 0.0), error + floor
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(low > estimate, low / estimate, np.where(high < estimate, high / estimate, 1.0))
        if np.any(compared):
            ratios.append(ratio[compared])
            for pick in (np.argmax, np.argmin):
                masked = np.where(compared, ratio, 1.0)
                at = np.unravel_index(pick(masked), masked.shape)
                value, place = masked[at], list(map(int, at[1:]))
                told = f"{name}{place} at {run.time[at[0]]:.3g} s: {value:.3g} of {estimate[at]:.2g}"
                tops.append((abs(math.log(max(value, 1e-30))), told))
    force = run.array("joints/reaction_force")
    peaks = np.max(np.linalg.norm(force, axis=-1), axis=0, initial=0.0)
    share = np.max(true[2], axis=0, initial=0.0) / np.where(peaks > 1e-9 * np.max(peaks, initial=0.0), peaks, np.inf)
    figures = accuracy.figures(run.joint_names, force)
    worst = figures.worst_joint
    good = run.status == "complete" and figures.is_complete and (worst is None or worst.share < 0.05)
    return Case(
        *names,
        run.status,
        accuracy.known_until,
        float(run.time[-1]),
        np.concatenate(ratios) if ratios else np.zeros(0),
        good,
        float(np.max(share, initial=0.0)),
        max(tops)[1] if tops else "",
    )


def share_inside(cases: Sequence[Case]) -> float:
    """Return the share of known values whose true error is within `LOW` and `HIGH` times the estimate."""
    ratios = np.concatenate([case.ratios for case in cases])
    return float(np.mean((ratios >= LOW) & (ratios <= HIGH))) if len(ratios) else math.nan
