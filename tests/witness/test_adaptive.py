"""Adaptive steps: errors in proportion to the tolerance, and no more steps than SciPy's Radau takes for the same error.

Errors are the largest along the run, at the ends of steps, against a run of six Gauss stages in fixed small steps,
which other tests hold against outside witnesses, and which is interpolated with its velocities and accelerations.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BPoly
from scipy.stats import linregress

import mbdkit
from mbdkit.spec import load_spec
from tests.margins import assert_within
from tests.slow_cases import slow_but

STIFF_KNEE = {"model.springs.support.stiffness": 1e5}
PROBLEMS: dict[str, tuple[str, dict[str, Any], float]] = {
    "pendulum": ("pendulum", {}, 5.0),
    "car axis": ("car-axis", {}, 1.0),
    "knee with a stiff spring": ("knee", STIFF_KNEE, 0.5),
}
TOLERANCES = [10.0 ** -(k / 2) for k in range(10, 25)]
FLOOR = {"pendulum": 2e-12, "car axis": 2e-12, "knee with a stiff spring": 1e-10}
"""Errors below this are rounding. The stiff spring amplifies it: with the eigenvectors of Radau IIA from LAPACK for
AVX2 and for AVX-512, which differ in their last bits, errors differ by 1.3e-11.
"""


@cache
def base(problem: str) -> dict[str, Any]:
    """Return the spec of a problem without its integrator."""
    example, changes, end = PROBLEMS[problem]
    if example == "knee":
        pytest.importorskip("mbdkit_biomech")
    spec = load_spec(example, [f"{key}={value!r}" for key, value in changes.items()])
    model = json.loads(spec.canonical_json())["model"]
    if problem == "pendulum":
        model |= {"angle": -0.3, "rate": 0.0}
    return {"mbdkit": 1, "model": model, "time": {"end": end}}


@cache
def reference(problem: str) -> BPoly:
    """Return the motion of a problem."""
    end = PROBLEMS[problem][2]
    spec = base(problem) | {"integrator": {"name": "gauss", "stages": 6}, "time": {"end": end, "step": end / 4000}}
    run = mbdkit.run(spec).check()
    parts = [run.array(f"trajectory/{name}") for name in ("position", "velocity", "acceleration")]
    return BPoly.from_derivatives(run.time, np.stack([x.reshape(len(run.time), -1) for x in parts], axis=1))


def measured(problem: str, integrator: dict[str, Any]) -> tuple[float, int]:
    """Return the largest error of a run, relative to coordinates of 1 at least, and its steps, rejected ones too."""
    run = mbdkit.run(base(problem) | {"integrator": integrator}).check()
    q = run.array("trajectory/position").reshape(len(run.time), -1)
    exact = reference(problem)(run.time)
    error = float(np.max(np.abs(q - exact) / np.maximum(1.0, np.abs(exact))))
    return error, run.stats["accepted"] + run.stats["rejected"]


@cache
def series(problem: str, name: str, stages: int) -> np.ndarray:
    """Return (K, 3) tolerances, errors and steps, where errors are above the floor of rounding."""
    method: dict[str, Any] = {"name": name}
    if stages:
        method["stages"] = stages
    own = {} if name.startswith("scipy") else {"adaptive": True}
    found = [(tol, *measured(problem, method | own | {"rtol": tol, "atol": tol})) for tol in TOLERANCES]
    return np.array([row for row in found if row[1] > FLOOR[problem]])


IMPLICIT = [("radau-iia", 3), ("gauss", 2), ("gauss", 4)]
EXPLICIT = [("dopri5", 0)]
COVER = [
    (*method, problem)
    for number, method in enumerate(IMPLICIT + EXPLICIT)
    for place, problem in enumerate(PROBLEMS)
    if (number + place) % 2 == 0
]
"""Every method on one problem or two, and every problem with two methods."""


@pytest.mark.parametrize(("name", "stages", "problem"), slow_but(COVER, *COVER[::2]))
def test_errors_follow_the_tolerance(problem: str, name: str, stages: int) -> None:
    # expected: errors are the tolerance times a factor that changes by less than 30 over six decades, and on average
    # with no power of the tolerance: slope 1 within 0.1, as far as the scatter of the points determines it
    tolerance, error = np.log10(series(problem, name, stages)[:, :2]).T
    assert len(tolerance) >= 12
    assert 10 ** np.ptp(error - tolerance) < 30
    line = linregress(tolerance, error)
    assert line.slope == pytest.approx(1.0, abs=0.1 + 2 * line.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize(("name", "stages"), [("radau-iia", 3), ("radau-iia", 5), ("gauss", 3), ("gauss", 4)])
def test_no_more_steps_than_the_radau_of_scipy_at_equal_error(problem: str, name: str, stages: int) -> None:
    # expected: SciPy's, interpolated between its own runs; by a twentieth more counts as no more
    ours, scipy = series(problem, name, stages), series(problem, "scipy-radau", 0)
    order = np.argsort(scipy[:, 1])
    errors, steps = np.log(scipy[order, 1]), np.log(scipy[order, 2])
    inside = (np.log(ours[:, 1]) >= errors[0]) & (np.log(ours[:, 1]) <= errors[-1])
    assert np.any(inside)
    theirs = np.exp(np.interp(np.log(ours[inside, 1]), errors, steps))
    assert np.max(ours[inside, 2] / theirs) <= 1.05


def test_adaptive_gauss_claims_no_symmetry() -> None:
    spec = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "time": {"end": 1.0, "step": 0.01}}
    fixed = load_spec(spec | {"integrator": {"name": "gauss"}}).claims
    adaptive = load_spec(spec | {"integrator": {"name": "gauss", "adaptive": True}}).claims
    assert fixed.symmetric
    assert fixed.symplectic
    assert fixed.order == 4
    assert not adaptive.symmetric
    assert not adaptive.symplectic
    assert adaptive.order is None
    assert adaptive.adaptive


@pytest.mark.parametrize("name", ["dopri5", "dop853", "gauss", "radau-iia"])
def test_states_between_steps_are_as_accurate_as_the_steps(name: str) -> None:
    # expected: the reference; dense output of every method is of order 4 at least at these tolerances
    integrator: dict[str, Any] = {"name": name, "adaptive": True, "rtol": 1e-7}
    if name in ("gauss", "radau-iia"):
        integrator["stages"] = 3
    run = mbdkit.run(base("pendulum") | {"integrator": integrator, "output": {"interval": 0.037}}).check()
    assert len(run.time) == 137
    q = run.array("trajectory/position").reshape(len(run.time), -1)
    assert_within(q - reference("pendulum")(run.time), 2e-5)
    assert_within(np.diff(run.time)[:-1] - 0.037, 1e-12)


def test_a_failing_iteration_makes_the_step_smaller() -> None:
    method = {"name": "gauss", "stages": 3, "adaptive": True, "rtol": 1e-6, "max_iterations": 3}
    run = mbdkit.run(base("pendulum") | {"integrator": method, "time": {"end": 1.0, "step": 0.9}}).check()
    assert run.stats["rejected"] > 0


def test_tolerances_without_adaptive_steps_are_refused() -> None:
    with pytest.raises(mbdkit.SpecError, match="`rtol` only with `adaptive: true`"):
        load_spec(base("pendulum") | {"integrator": {"name": "gauss", "rtol": 1e-6}, "time": {"end": 1, "step": 0.1}})
