"""How often error bars cover the truth of random mechanisms, for chosen and for random coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, compute, fit, forces_of, recorded_states
from mbdkit_biomech.inverse_dynamics.errors.error_bars import error_bars
from mbdkit_biomech.inverse_dynamics.motion import reduced_motion
from mbdkit_biomech.inverse_dynamics.motion.manifold import Quantities
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Independent, motion_of_series
from mbdkit_biomech.inverse_dynamics.motion.smoothing import smoothed
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.benchmarks.drawn_mechanisms import COLUMNS, KINDS, RATE, Drawn, draw

TRIES = 200
"""Number of random sets of coordinates that are tried for one that determines the motion well."""


@dataclass(frozen=True)
class Coverage:
    """Shares of frames in which bars cover the truth, means over the noise: of actuators (U,) and joint forces (J,)."""

    label: str
    torques: np.ndarray
    forces: np.ndarray


def coverage(number: int, noises: int, *, random_coordinates: bool = False) -> Coverage:
    """Return the coverage for the mechanism of a number, with its own smoothing and noise.

    Parameters
    ----------
    noises
        Number of samples of the noise.
    random_coordinates
        Whether random coordinates are smoothed where there are more columns than degrees of freedom.
    """
    random = np.random.default_rng(number)
    drawn = draw(random, KINDS[number % len(KINDS)], COLUMNS[number // len(KINDS) % len(COLUMNS)])
    deviation, smooth = 10 ** random.uniform(-3.3, -2.3), _smoothing(random, drawn)
    noise = {"deviation": deviation} if random.random() < 0.5 else {}
    columns = {name: {"column": name, **noise} for name in drawn.values if name != "time"}
    ends = int(np.ceil(RATE / smooth.get("cutoff", 3 * drawn.highest)))  # a period of the cutoff, see the guide
    inside, torques, forces = slice(ends, -ends), [], []
    own = [place for place, one in enumerate(drawn.model["joints"].values()) if one["type"] != "driver"]
    for _ in range(noises):
        data = {
            name: values if name == "time" else values + deviation * random.standard_normal(len(values))
            for name, values in drawn.values.items()
        }
        motion = {"data": data, "columns": columns, "smooth": smooth, "errors": {"samples": 100}}
        spec = {"mbdkit": 1, "model": drawn.model, "actuators": drawn.actuators, "motion": motion}
        problem = InverseProblem.of(load_inverse_spec(spec, ()))
        try:
            result = _with_random_coordinates(problem, random) if random_coordinates else compute(problem)
            bars = error_bars(result)
        except RunError:  # near a fold of random coordinates, where mbdkit refuses them
            if random_coordinates:
                continue
            raise
        assert bars is not None
        known = np.column_stack([drawn.torques[one.name] for one in problem.actuators])
        torques.append(np.mean((np.abs(result.dynamics.value - known) <= bars.actuators)[inside], axis=0))
        wrong = np.linalg.norm((recorded_states(result).reactions[..., :2] - drawn.force)[:, own], axis=2)
        forces.append(np.mean((wrong <= bars.accuracy.reaction_error[:, own])[inside], axis=0))
    label = f"{drawn.kind}, {drawn.columns}, {smooth['name']}, {deviation:.1e}{' stated' if noise else ''}"
    return Coverage(label, np.mean(torques, axis=0), np.mean(forces, axis=0))


def _smoothing(random: np.random.Generator, drawn: Drawn) -> dict[str, Any]:
    """Return a smoothing with a cutoff of 2 to 5 times the highest frequency of the motion."""
    cutoff = drawn.highest * random.uniform(2.0, 5.0)
    choices: list[dict[str, Any]] = [
        {"name": "butterworth", "cutoff": cutoff},
        {"name": "butterworth", "cutoff": cutoff, "order": 4},
        {"name": "opensim", "cutoff": 1.2 * cutoff},  # the cutoff of one of two passes
        {"name": "spline"},
    ]
    return choices[random.integers(len(choices))]


def _with_random_coordinates(problem: InverseProblem, random: np.random.Generator) -> Inverse:
    fitted = fit(problem)
    measured, fitter = fitted.measured, problem.fitter
    if len(measured.names) == fitter.manifold.freedoms:
        return compute(problem)
    candidates = problem.names.candidates()
    quantities = Quantities(list(candidates.values()))
    rows = reduced_motion._rates(fitter.manifold, measured.time, fitted.q, quantities)
    for _ in range(TRIES):
        places = sorted(random.permutation(len(candidates))[: rows.shape[2]].tolist())
        if np.min(reduced_motion._independence(rows[:, places])) < reduced_motion.ENOUGH:
            continue
        names = tuple(list(candidates)[place] for place in places)
        intervals = ((0, len(fitted.q), tuple(range(len(places)))),)
        chosen = Independent(names, quantities.only(places), intervals)
        series = smoothed(measured.time, chosen.quantities.values(fitted.q), problem.spec.motion.smooth)
        try:
            motion = motion_of_series(fitter, chosen, measured.time, fitted.q, series)
        except RunError:  # near a fold, where smoothed coordinates have no pose; mbdkit would refuse them
            continue
        return forces_of(problem, fitted, chosen, motion)
    return compute(problem)
