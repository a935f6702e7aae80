"""How errors of adaptive `radau-iia` depend on the tolerance, by formulation and stabilization."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.methods.radau_iia import RadauOptions
from mbdkit_testing.trial_models import FOUR_BAR

ENDS = (0.5, 0.8, 1.1, 1.4)
"""Ends of runs [s], over which errors are averaged: those of velocities vary from step to step in index-3."""


def velocities(integrator: dict[str, Any], **more: Any) -> np.ndarray:
    """Return the velocities of all bodies of a driven four-bar linkage at `ENDS`."""
    found = []
    for end in ENDS:
        spec = {"mbdkit": 1, "model": FOUR_BAR, "integrator": integrator, "time": {"end": end}}
        run = mbdkit.run(spec | {"output": {"interval": end}} | more)
        assert run.status == "complete"
        found.append([run[name].velocity[-1] for name in FOUR_BAR["bodies"]])
    return np.array(found)


@cache
def reference() -> np.ndarray:
    """Return the velocities by `dop853` with a small tolerance."""
    return velocities({"name": "dop853", "adaptive": True, "rtol": 1e-13}, stabilization="projection")


@pytest.mark.parametrize(
    ("formulation", "stabilization", "power"),
    [
        ("index-1", "none", 1.0),
        ("index-3", "none", 3 / 5),
        ("index-3", "projection", 1.0),
        ("ggl", "none", 1.0),
        ({"name": "joint-coordinates", "loops": "index-3"}, "none", 3 / 5),
    ],
)
def test_errors_of_velocities_are_the_documented_power_of_the_tolerance(
    formulation: Any, stabilization: str, power: float
) -> None:
    # expected: order 3 instead of 5 for velocities in index-3 (Hairer, Lubich and Roche 1989, Lecture Notes in
    # Mathematics 1409, table 2.3), as the option says
    loose, tight = (
        np.sqrt(
            np.mean((velocities(integrator, formulation=formulation, stabilization=stabilization) - reference()) ** 2)
        )
        for integrator in ({"name": "radau-iia", "adaptive": True, "rtol": rtol} for rtol in (1e-6, 1e-11))
    )
    # margin: power of the tolerance, from errors of mbdkit alone
    assert np.log10(loose / tight) / 5.0 == pytest.approx(power, abs=0.15)
    described = RadauOptions.model_json_schema()["properties"]["rtol"]["description"]
    assert "error of velocities is proportional to rtol^(s / (2 s - 1))" in " ".join(described.split())
