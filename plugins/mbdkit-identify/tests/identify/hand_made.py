"""A hand-made result of an identification: a decaying oscillation, whose numbers follow from formulas."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit_identify.identification import Doubt, Estimate, Identification, NextExperiment, Profile, Residuals

NOISE = 0.02
COVARIANCE = np.array([[0.04, -0.001, np.nan], [-0.001, 0.0025, np.nan], [np.nan, np.nan, np.nan]])
"""Covariance of stiffness and damping; the third parameter is not determined."""

BASE = {
    "name": "mechanism",
    "bodies": {"leg": {"mass": 1.0, "inertia": 0.1, "position": [0.0, -0.4]}},
    "joints": {"hip": {"type": "revolute", "bodies": ["ground", "leg"], "at": [0.0, 0.0]}},
    "forces": {"coil": {"type": "torsion-spring", "bodies": ["ground", "leg"], "stiffness": "stiffness"}},
}


def signal(experiment: str, *, is_hold_out: bool = False, samples: int = 200) -> Residuals:
    """Return a signal with white noise."""
    time = np.linspace(0.0, 4.0, samples)
    fitted = 0.3 * np.exp(-0.4 * time) * np.cos(5 * time)
    white = np.random.default_rng(len(experiment)).normal(size=samples)
    band = np.full(samples, 1.96 * NOISE)
    covered = float(np.mean(abs(NOISE * white) <= band))
    return Residuals(
        experiment, "leg.angle", "rad", time, fitted + NOISE * white, fitted, white, NOISE, 0.1, is_hold_out, band,
        covered,
    )  # fmt: skip


def result(**changes: Any) -> Identification:
    """Return the result with some fields changed."""
    estimates = [
        Estimate("stiffness", "N m/rad", 12.0, 11.6, 12.4, 0.2, True, mean=12.0),
        Estimate("damping", "N m s/rad", 0.0, 0.0, 0.1, 0.05, True, "lower", mean=0.02),
        Estimate("mass", "kg", 2.0, -np.inf, np.inf, np.nan, False),
        Estimate("ratio", "1", 6.0, 5.8, np.inf, 0.1, True),
    ]
    values = np.linspace(11.5, 12.5, 11)
    following = NextExperiment(
        "stiffness",
        {"": {"stiffness": 0.4, "damping": 0.1}, "swing: further": {"stiffness": 0.2, "damping": np.inf}},
        "swing: further",
    )
    whole = Identification(
        spec={"mbdkit_identify": 1, "base": "pendulum", "parameters": {"stiffness": {"start": 10.0}}},
        base={"mbdkit": 1, "parameters": {"stiffness": 12.0}, "model": BASE},
        level=0.95,
        estimates={one.name: one for one in estimates},
        parameters=("stiffness", "damping", "mass"),
        covariance=COVARIANCE,
        combinations=("the data determine mass*length^2, not mass and length",),
        residuals=(signal("first"), signal("second, <b>", is_hold_out=True)),
        profiles={"stiffness": Profile("stiffness", values, ((values - 12.0) / 0.2) ** 2, 3.84)},
        next_experiment=following,
        verdict="doubtful",
        doubts=(Doubt("friction in the joint 'hip'", "residuals depend on the direction of motion", (9.1, 3.84)),),
        notes=("the noise of inputs was neglected",),
        cost=398.5,
        log_likelihood=-12.25,
        evaluations=(30, 12),
        way="exact",
        seconds=1.5,
        title="A leg",
    )
    return replace(whole, **changes)
