"""`python -m tests.benchmarks emg --count N`: what EMG of drawn persons does to the errors of their forces.

Persons are those of `drawn_persons`, but their activations are not those of recruitment: they follow targets that
differ from it by a factor, the exponential of a Gaussian process in time with the standard deviation 0.3, and by
co-contraction, the magnitude of another one with 0.08. Their EMG is 70 ms early, has a coefficient of variation of 0.3
and an unknown scale; a third result has noise in its place.
"""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit import Run
from mbdkit.base.errors import MbdkitError
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec

from .drawn_persons import Array, Drawn, drawn_person, forces_of, page_walker

FACTOR, TOGETHER, NOISE, DEVIATION, EARLY = 0.3, 0.08, 0.3, 0.4, 0.07
"""Standard deviations of factors, of co-contraction, and of EMG; the stated one, with that of the strength; and the
time from EMG to force [s]."""


def _with_emg(
    data: dict[str, Any],
    emg: dict[str, Array],
    deviation: float,
    delay: float = EARLY,
    scale: float | str = "estimated",
) -> dict[str, Any]:
    """Return a spec with columns (T,) of EMG by muscle."""
    motion = {**data["motion"], "data": {**data["motion"]["data"], **{f"emg_{name}": x for name, x in emg.items()}}}
    channels = {name: {"column": f"emg_{name}", "deviation": deviation, "delay": delay, "scale": scale} for name in emg}
    return {**data, "motion": motion, "emg": channels}


def _truth(person: Drawn, random: np.random.Generator) -> Run:
    """Return the forces of a person who co-contracts."""
    with person.forces as alone:
        activation = {name: np.asarray(muscle.activation) for name, muscle in alone.muscles.items()}
    process = lambda: page_walker().skin(random)[:, 0]  # noqa: E731
    targets = {
        name: np.clip(own * np.exp(FACTOR * process()) + TOGETHER * np.abs(process()), 0.01, 0.95).tolist()
        for name, own in activation.items()
    }
    data, recruitment = json.loads(person.truth.canonical_json()), person.truth.recruitment
    assert recruitment is not None
    spec = load_inverse_spec(_with_emg({**data, "recruitment": {"reserves": 1.0}}, targets, 0.05, 0.0, 1.0))
    return forces_of(spec.model_copy(update={"recruitment": recruitment}))


def emg(console: Console, count: int = 20, seed: int = 76) -> None:
    """Print root mean square errors [N] of the force of the knee, and of tensions, for `count` persons."""
    errors: dict[str, list[tuple[float, float]]] = {"no EMG": [], "EMG": [], "noise": []}
    for number in range(count):
        random = np.random.default_rng([seed, number])
        try:
            with redirect_stderr(io.StringIO()):
                person = drawn_person(random, uncertainty="none")
                measured = {**person.measured, "motion": {**person.measured["motion"], "errors": "none"}}
                truth = _truth(person, random)
                channels: dict[str, dict[str, Array]] = {"no EMG": {}, "EMG": {}, "noise": {}}
                for name, muscle in truth.muscles.items():
                    scatter, noise = (page_walker().skin(random)[:, 0] for _ in range(2))
                    at = np.asarray(truth.time)
                    own = np.interp(at + EARLY, at, muscle.activation)
                    channels["EMG"][name] = own * np.exp(NOISE * scatter + random.standard_normal())
                    channels["noise"][name] = np.clip(0.02 + 0.15 * np.abs(noise), 0.0, 1.0)
                found = {key: mbdkit.inverse(_with_emg(measured, own, DEVIATION)) for key, own in channels.items()}
        except MbdkitError as error:
            console.print(f"failed: {number}: {error}")
            continue
        for key, run in found.items():
            errors[key].append((_error(run, truth, "joints"), _error(run, truth, "muscles")))
    table = Table(title=f"{len(errors['EMG'])} persons: root mean square errors, and medians over persons [N]")
    for heading in ("", "knee", "median", "tensions", "median"):
        table.add_column(heading)
    for key, own in errors.items():
        columns = np.array(own).T
        texts = [f"{x:.0f}" for one in columns for x in (np.sqrt(np.nanmean(one**2)), np.nanmedian(one))]
        table.add_row(key, *texts)
    console.print(table)


def _error(run: Run, truth: Run, kind: str) -> float:
    """Return the root mean square error of the force of the knee, or of all tensions [N]."""
    if kind == "joints":
        gap = run.joints["knee"].reaction_force - truth.joints["knee"].reaction_force
        return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))
    gaps = [muscle.force - truth.muscles[name].force for name, muscle in run.muscles.items()]
    return float(np.sqrt(np.mean(np.square(gaps))))
