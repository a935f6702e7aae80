"""Drawn problems with several local optima; run as a script, compares predictions of several starts with another
transcription from many starts.

    PYTHONPATH=plugins/mbdkit-predict/tests python -m predict.several_optima [NUMBER ...]

A particle moves in the plane with least effort around two or three disks, each of which it may pass on either side; or
a pendulum, pushed by a wind, swings up to its upper rest position with a limited torque, in one or several swings. The
witness has x, y or the angle as unknowns, and collocation with Radau points of CasADi, from 40 starts.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import PchipInterpolator

import mbdkit

WITNESS_STARTS, STARTS, INTERVALS, FINE, POINTS = 40, 8, 40, 500, 3
#: The test: drawn problems for which the witness finds several optima; others have one.
NUMBERS = *range(0, 20, 2), 1, 3, 7, 9, 11, 13, 19, 21, 23, 25
SAME = 1e-4  #: Relative difference of objectives of one optimum.
GRAVITY = 9.81


@dataclass(frozen=True)
class Several:
    """A drawn problem.

    Attributes
    ----------
    kind
        What is drawn.
    spec
        Spec of the prediction.
    rates
        Function of CasADi of coordinates, velocities and controls: the accelerations.
    clear
        Function of the coordinates that must not be negative; with several values.
    ends
        Coordinates at the start and at the end, at rest.
    limit
        Largest control.
    """

    kind: str
    spec: dict[str, Any]
    rates: ca.Function
    clear: ca.Function
    ends: tuple[np.ndarray, np.ndarray]
    limit: float

    def optima(self) -> np.ndarray:
        """Return the objectives of all local optima that the witness finds, from the smallest one on; that is solved
        again on a fine mesh, because coarse ones cut corners.
        """
        random, found = np.random.default_rng(7), list[tuple[float, Any]]()
        solve = self._program(INTERVALS)
        for start in range(WITNESS_STARTS):
            waves = random.normal(0.0, 1.5, (len(self.ends[0]), 3)) * (start > 0)

            def bent(share: np.ndarray, waves: np.ndarray = waves) -> np.ndarray:
                straight = self.ends[0][:, None] + np.outer(self.ends[1] - self.ends[0], share)
                return straight + waves @ np.sin(np.pi * np.outer(np.arange(1, 4), share))

            found += solve(bent)
        found.sort(key=lambda row: row[0])
        best = self._program(FINE)(found[0][1])
        optima = np.array([best[0][0], *(x for x, _ in found[1:])])
        return optima[np.abs(np.diff(optima, prepend=-np.inf)) > SAME * abs(optima)]

    def _program(self, intervals: int) -> Any:
        """Return a function that solves the problem from coordinates as a function of the share of time, and returns
        the objective and the coordinates as such a function; nothing without an optimum.
        """
        end = float(self.spec["duration"])
        n, total = len(self.ends[0]), intervals * POINTS
        c = np.array(ca.collocation_points(POINTS, "radau"))
        slopes, _, b = (np.array(matrix) for matrix in ca.collocation_coeff(c.tolist()))
        x, v, u = (ca.MX.sym(name, n, total) for name in "xvu")

        def rate(y: ca.MX, first: Any) -> ca.MX:
            begins = ca.horzcat(ca.DM(first), y[:, POINTS - 1 : -1 : POINTS])
            each = ca.DM.eye(intervals)
            whole = ca.mtimes(y, ca.kron(each, ca.DM(slopes[1:]))) + ca.mtimes(begins, ca.kron(each, ca.DM(slopes[:1])))
            return whole * intervals / end

        rows = ca.veccat(
            rate(x, self.ends[0]) - v, rate(v, np.zeros(n)) - self.rates.map(total)(x, v, u), x[:, -1] - self.ends[1],
            v[:, -1],
        )  # fmt: skip
        clear = ca.vec(self.clear.map(total)(x))
        effort = ca.mtimes(ca.sum1(u**2), ca.DM(np.tile(b.ravel(), intervals))) * end / intervals
        options = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 500,
            "expand": True,
        }
        program = {"x": ca.veccat(x, v, u), "f": effort, "g": ca.vertcat(rows, clear)}
        solver = ca.nlpsol("witness", "ipopt", program, options)
        low, high = np.zeros(rows.numel() + clear.numel()), np.zeros(rows.numel() + clear.numel())
        high[rows.numel() :] = np.inf
        bound = np.concatenate([np.full(2 * n * total, np.inf), np.full(n * total, self.limit)])
        share = ((np.arange(intervals)[:, None] + c) / intervals).ravel()

        def solve(guess: Any) -> list[tuple[float, Any]]:
            x0 = np.concatenate([guess(share).ravel("F"), np.zeros(2 * n * total)])
            result: Any = solver(x0=x0, lbg=low, ubg=high, lbx=-bound, ubx=bound)
            place = np.array(result["x"]).ravel()[: n * total].reshape(n, total, order="F")
            motion = PchipInterpolator([0.0, *share], np.column_stack([self.ends[0], place]), axis=1)
            return [(float(result["f"]), motion)] * bool(solver.stats()["success"])

        return solve


def disks(random: np.random.Generator) -> Several:
    """Return a particle among disks."""
    count, end = int(random.integers(2, 4)), float(random.uniform(1.0, 2.0))
    places = np.column_stack([np.linspace(0.25, 0.75, count) * 3.0, random.uniform(-0.25, 0.25, count)])
    radii = random.uniform(0.2, 0.35, count)
    pushes = [f'controls["forces.push.value[{k}]"]' for k in (0, 1)]
    model = {
        "name": "mechanism", "gravity": [0, 0], "bodies": {"ball": {"mass": 1.0}},
        "forces": {"push": {"type": "force", "body": "ball", "value": [0, 0]}},
    }  # fmt: skip
    spec = {
        "mbdkit_predict": 1, "base": {"model": model}, "duration": end, "starts": STARTS, "tolerance": 1e-4,
        "controls": {f"forces.push.value[{k}]": {"bounds": [-100, 100]} for k in (0, 1)},
        "initial": {"ball.x": 0, "ball.y": 0, "ball.vx": 0, "ball.vy": 0},
        "final": {"ball.x": 3, "ball.y": 0, "ball.vx": 0, "ball.vy": 0},
        "subject_to": {
            f"disk{k}": {"value": f"(ball.x - {x})**2 + (ball.y - {y})**2", "min": r**2}
            for k, ((x, y), r) in enumerate(zip(places.tolist(), radii.tolist(), strict=True))
        },
        "minimize": f"integral({' + '.join(f'{push}**2' for push in pushes)})", "limits": {"wall_time": 120},
    }  # fmt: skip
    x, v, u = (ca.SX.sym(name, 2) for name in "xvu")
    clear = [(x[0] - a) ** 2 + (x[1] - b) ** 2 - r**2 for (a, b), r in zip(places, radii, strict=True)]
    return Several(
        f"{count} disks", spec, ca.Function("rates", [x, v, u], [u]), ca.Function("clear", [x], [ca.vertcat(*clear)]),
        (np.zeros(2), np.array([3.0, 0.0])), 100.0,
    )  # fmt: skip


def swing_up(random: np.random.Generator) -> Several:
    """Return a pendulum that swings up."""
    length, mass, end = float(random.uniform(0.4, 0.8)), 1.0, float(random.uniform(3.0, 4.0))
    own, wind = 1e-3, float(random.uniform(0.05, 0.3)) * GRAVITY
    limit = float(random.uniform(0.3, 0.5)) * mass * GRAVITY * length
    model = {
        "name": "mechanism", "gravity": [wind, -GRAVITY],
        "bodies": {"bob": {"mass": mass, "inertia": own, "position": [0, -length]}},
        "joints": {"pin": {"type": "revolute", "bodies": ["ground", "bob"], "points": [[0, 0], [0, length]]}},
        "forces": {"motor": {"type": "torque", "body": "bob", "value": 0.0}},
    }  # fmt: skip
    side = float(random.choice([-1.0, 1.0]))
    spec = {
        "mbdkit_predict": 1, "base": {"model": model}, "duration": end, "starts": STARTS, "tolerance": 1e-4,
        "controls": {"forces.motor.value": {"bounds": [-limit, limit]}},
        "initial": {"bob.angle": 0, "bob.angular_velocity": 0},
        "final": {"bob.angle": side * np.pi, "bob.angular_velocity": 0},
        "minimize": "integral(forces.motor.value**2)", "limits": {"wall_time": 120},
    }  # fmt: skip
    x, v, u = (ca.SX.sym(name, 1) for name in "xvu")
    pull = mass * length * (wind * ca.cos(x) - GRAVITY * ca.sin(x))
    return Several(
        "swing-up", spec, ca.Function("rates", [x, v, u], [(u + pull) / (own + mass * length**2)]),
        ca.Function("clear", [x], [ca.SX(1.0)]), (np.zeros(1), np.array([side * np.pi])), limit,
    )  # fmt: skip


def several(number: int) -> Several:
    """Return a problem; those of `NUMBERS` are the test."""
    return (disks, swing_up)[number % 2](np.random.default_rng([92, 7, number]))


def word_of(run: mbdkit.Run, optima: np.ndarray) -> str:
    """Return ``right``, ``told``, or ``silent``: a good verdict on a motion that is not the best one known."""
    is_best = run.objective <= optima[0] * (1.0 + SAME) + run.objective_error
    if (run.status, run.verdict) == ("complete", "good"):
        return "right" if is_best else "silent"
    return "told"


def main() -> None:
    """Print the table."""
    words = dict[str, int]()
    for number in [int(x) for x in sys.argv[1:]] or NUMBERS:
        problem = several(number)
        optima, begin = problem.optima(), time.perf_counter()
        run = mbdkit.predict(problem.spec)
        word = word_of(run, optima)
        words[word] = words.get(word, 0) + 1
        basin = next((line for line in run.verdict_reasons if "starts" in line), "")
        print(
            f"{number:>3} {problem.kind:<9} {len(optima)} optima {optima[0]:10.5g} to {optima[-1]:10.5g}: "
            f"{run.objective:10.5g} +- {run.objective_error:7.1e} {time.perf_counter() - begin:5.1f} s {word} "
            f"{basin or (run.status_reason or run.verdict_reasons[0])[:100]}", flush=True,
        )  # fmt: skip
    print(", ".join(f"{word} {count}" for word, count in words.items()))


if __name__ == "__main__":
    main()
