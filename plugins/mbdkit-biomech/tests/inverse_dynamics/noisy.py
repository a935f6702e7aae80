"""Motions of forward runs, given back with noise, and the share of their true loads that error bars cover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import mbdkit
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.spec import load_spec
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute, recorded_states
from mbdkit_biomech.inverse_dynamics.errors.error_bars import error_bars
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec

OBSERVED = {
    "knee": ("shank.angle",), "watt-six-bar": ("A.angle",), "double-wishbone": ("lower inner.angle", "guide.angle"),
}  # fmt: skip
"""Observed quantities of each example."""

CUTOFF = {"knee": 12.0, "watt-six-bar": 12.0, "double-wishbone": 15.0}
"""Cutoff of the Butterworth filter [Hz]."""

DEVIATION = 0.001
"""Standard deviation of the noise [rad or m]."""

ENDS = 25
"""Rows at both ends that are left out: 0.05 s, where the smoothing depends on how the motion is continued."""


@dataclass(frozen=True)
class Truth:
    """The true motion and loads of a forward run.

    Attributes
    ----------
    columns
        Times and true values of the observed quantities, by heading.
    torques
        (T, U) true torques of the actuators.
    force
        (T, J, 2) true reaction forces.
    """

    columns: dict[str, np.ndarray]
    torques: np.ndarray
    force: np.ndarray

    @classmethod
    def of(cls, example: str, run: mbdkit.Run, actuators: dict[str, Any]) -> Truth:
        """Return the truth of a run of an example whose torques have the names of the actuators."""
        names = QuantityNames(load_spec(example).mechanism())
        q = run.array("trajectory/position").reshape(len(run.time), -1)
        columns = {name: names.find(name, "columns").value(q) for name in OBSERVED[example]}
        zero = np.zeros(len(run.time))
        torques = np.column_stack([run.forces[name].value if name in run.forces else zero for name in actuators])
        return cls({"time": run.time, **columns}, torques, run.array("joints/reaction_force"))


def noisy_motion(truth: Truth, random: np.random.Generator, **options: Any) -> dict[str, Any]:
    """Return the section `motion` with noise added to the true values; `options` are those of the section."""
    noisy = {
        name: values if name == "time" else values + DEVIATION * random.standard_normal(len(values))
        for name, values in truth.columns.items()
    }
    return {"data": noisy, "columns": {name: name for name in noisy if name != "time"}, **options}


def covered(
    truth: Truth, spec: dict[str, Any], cutoff: float, samples: int, *, seed: int = 17, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of frames and noise samples in which bars cover true torques (U,) and joint forces (J,).

    Parameters
    ----------
    seed
        Seed of the noise.
    options
        Further options of the section `motion`.
    """
    random = np.random.default_rng(seed)
    torques, forces = np.zeros(truth.torques.shape[1]), np.zeros(truth.force.shape[1])
    inside = slice(ENDS, -ENDS)
    for _ in range(samples):
        motion = noisy_motion(truth, random, smooth={"name": "butterworth", "cutoff": cutoff}, **options)
        result = compute(InverseProblem.of(load_inverse_spec({**spec, "motion": motion}, ())))
        bars = error_bars(result)
        assert bars is not None
        wrong = np.linalg.norm(recorded_states(result).reactions[:, :, :2] - truth.force, axis=2)
        torques += np.mean((np.abs(result.dynamics.value - truth.torques) <= bars.actuators)[inside], axis=0)
        forces += np.mean((wrong <= bars.accuracy.reaction_error)[inside], axis=0)
    return torques / samples, forces / samples
