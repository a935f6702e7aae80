"""Whole runs: how they end, what they leave behind, that they repeat, and the adaptive methods."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.mechanism.mechanism import Mechanism
from tests.margins import assert_within

DOUBLE = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
SCIPY = ("scipy-radau", "scipy-dop853", "scipy-lsoda")
METHODS: list[dict[str, Any]] = [
    {"name": "rk4"},
    {"name": "rk-gill"},
    {"name": "gauss"},
    {"name": "gauss", "stages": 3, "stage_solver": "fixed-point"},
    *({"name": name} for name in SCIPY),
]
methods = pytest.mark.parametrize("integrator", METHODS, ids=lambda i: "-".join(str(x) for x in i.values()))


def spec(model: Any = None, integrator: Any = None, **sections: Any) -> dict[str, Any]:
    given = {"mbdkit": 1, "model": model or DOUBLE, "integrator": integrator or {"name": "rk4"}}
    return {**given, "time": {"end": 0.5, "step": 0.01}, **sections}


def rod() -> Mechanism:
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.revolute("A", m.ground, "rod", at=(0.0, 0.0))
    return m


def stiff() -> Mechanism:
    m = rod()
    m.spring_damper("s", "rod", m.ground, from_=(1, 0), to=(1, 1), stiffness=1e9, free_length=0.5)
    return m


def stiff_and_free() -> Mechanism:
    m = stiff()
    del m.joints["A"]
    return m


def loaded(value: str) -> Mechanism:
    m = rod()
    m.torque("t", "rod", value=value)
    return m


def driven(motion: str) -> Mechanism:
    m = rod()
    m.driver("d", m.ground, "rod", coordinate="angle", motion=motion)
    return m


RK4, GAUSS = {"name": "rk4"}, {"name": "gauss"}
DOPRI5 = {"name": "dopri5", "adaptive": True}
FIXED_POINT = {"name": "gauss", "stage_solver": "fixed-point"}


def longer(step: float = 0.05, **more: Any) -> dict[str, Any]:
    return {"time": {"end": 2.0, "step": step}, **more}


def every(rows: int) -> dict[str, Any]:
    return {"output": {"every": rows}}


FEW: dict[str, Any] = {"limits": {"max_steps": 3}}
ENDLESS: dict[str, Any] = {"time": {"end": 1e4, "step": 1e-3}, "limits": {"wall_time": 0.05}}
RADAU = {"name": "radau-iia", "adaptive": True}
ENDINGS: dict[str, tuple[Any, dict[str, Any], dict[str, Any], str, str]] = {
    # name: model, integrator, other sections, status code, words of the sentence
    "max-steps": (DOUBLE, RK4, {"limits": {"max_steps": 7}}, "max-steps", "limits.max_steps = 7"),
    "max-steps adaptive": (DOUBLE, {"name": "scipy-dop853"}, FEW, "max-steps", "3 steps"),
    "max-steps by tolerance": (DOUBLE, DOPRI5, FEW, "max-steps", "3 steps"),
    "max-steps, rows at times": (DOUBLE, DOPRI5, FEW | {"output": {"interval": 1e-3}}, "max-steps", "3 steps"),
    "blow-up in finite time": (lambda: loaded("(0.3 - t)**-2"), DOPRI5, {}, "step-too-small", "from t = 0.3 s"),
    "blow-up, implicit": (lambda: loaded("(0.3 - t)**-2"), RADAU, {}, "step-too-small", "from t = 0.3 s"),
    "load that ends, by tolerance": (lambda: loaded("log(0.055 - t)"), DOPRI5, {}, "not-finite", "from t = 0.055 s"),
    "wall-time": ({"name": "n-pendulum", "n": 50}, RK4, ENDLESS, "wall-time", "limits.wall_time = 0.05"),
    "big step": (DOUBLE, GAUSS, {"time": {"end": 40.0, "step": 10.0}}, "newton-failed", "rod"),
    "fixed-point on a stiff spring": (stiff, FIXED_POINT, {}, "newton-failed", "step 1"),
    "stiff spring": (stiff, RK4, longer(), "fell-apart", "at t = 0.05 s"),
    "stiff spring and joints": (stiff, RK4, longer(limits={"misalignment": 1e300}), "not-finite", "step"),
    "stiff spring seldom recorded": (stiff, RK4, longer(**every(7)), "fell-apart", "at t = 0.05 s"),
    "stiff spring, free": (stiff_and_free, RK4, longer(0.01, **every(100)), "not-finite", "step"),
    "load that ends at a row": (lambda: loaded("log(0.05 - t)"), GAUSS, every(7), "not-finite", "0.0"),
    "load that ends": (lambda: loaded("log(0.055 - t)"), RK4, {}, "not-finite", "t = 0.0"),
}


@pytest.mark.parametrize("name", ENDINGS)
def test_a_run_that_stops_early_says_why_and_leaves_a_sound_archive(name: str, tmp_path: Path) -> None:
    model, integrator, sections, code, words = ENDINGS[name]
    path = tmp_path / "run.h5"
    if callable(model):
        time = sections.get("time", {"end": 0.5, "step": 0.01})
        others = {k: v for k, v in sections.items() if k != "time"}
        returned = mbdkit.run(model(), integrator=integrator, time=time, archive=path, **others)
    else:
        returned = mbdkit.run(spec(model, integrator, **sections), archive=path)
    assert returned.status == "failed"
    assert returned.status_reason.partition(": ")[0] == code, returned.status_reason
    assert words in returned.status_reason
    with pytest.raises(mbdkit.RunError):
        returned.check()
    returned.close()
    assert os.listdir(tmp_path) == ["run.h5"]
    assert check(path) == []
    with mbdkit.load(path) as run:
        assert run.status == "failed"
        for array in ("position", "velocity", "acceleration"):
            assert np.all(np.isfinite(run.array(f"trajectory/{array}")))
        assert np.all(np.isfinite(run.array("energy/total")))
        assert run.stats["steps"] >= run.array("steps/steps").sum()  # a last state that cannot be recorded is left out


def test_a_load_that_is_not_finite_at_the_start_is_refused(tmp_path: Path) -> None:
    with pytest.raises(mbdkit.SpecError, match="finite"):
        mbdkit.run(loaded("1/t"), integrator=RK4, time={"end": 0.1, "step": 0.01}, archive=tmp_path / "run.h5")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("value", ["sqrt(t)", "t**1.5", "asin(t - 1)"])
def test_a_load_may_start_with_infinite_slope(value: str) -> None:
    # expected: a load enters by its value alone; only drivers need derivatives
    assert mbdkit.run(loaded(value), integrator=RK4, time={"end": 0.1, "step": 0.01}).status == "complete"


def test_the_state_before_the_step_that_failed_is_recorded() -> None:
    # expected: rows at the start, every 20 steps, and the last state reached; max_steps = 47
    run = mbdkit.run(spec(time={"end": 5.0, "step": 0.01}, output={"every": 20}, limits={"max_steps": 47}))
    np.testing.assert_array_equal(run.time, [0.0, 0.2, 0.4, 47 * 0.01])
    whole = mbdkit.run(spec(time={"end": 5.0, "step": 0.01}))
    np.testing.assert_array_equal(run["rod2"].position[-1], whole["rod2"].position[47])
    np.testing.assert_array_equal(run.array("steps/steps"), [20, 20, 7])


def test_ctrl_c_in_python_returns_an_interrupted_run_and_keeps_a_sound_archive(tmp_path: Path) -> None:
    path = tmp_path / "long.h5"
    steps, stop = {"end": 100.0, "step": 1e-3}, lambda reached, end: signal.raise_signal(signal.SIGINT)
    before = signal.getsignal(signal.SIGINT)
    with mbdkit.run(spec(time=steps, output={"every": 100}), archive=path, progress=stop) as run:
        assert run.status_reason.startswith("interrupted: stopped by the user at t = ")
        assert 0.0 < run.time[-1] < 100.0
    assert signal.getsignal(signal.SIGINT) is before
    assert check(path) == []


@methods
def test_a_run_in_memory_equals_another_of_the_same_spec_in_a_file(integrator: dict[str, Any], tmp_path: Path) -> None:
    memory = mbdkit.run(spec(integrator=integrator)).check()
    with mbdkit.run(spec(integrator=integrator), archive=tmp_path / "run.h5") as stored:
        assert stored.path == tmp_path / "run.h5"
        assert stored.data_sha256 == memory.data_sha256
        assert stored.run_id == memory.run_id
        assert stored.spec_sha256 == memory.spec_sha256
        np.testing.assert_array_equal(stored["rod2"].position, memory["rod2"].position)
    assert check(tmp_path / "run.h5") == []


def test_what_assembly_did_is_told_in_the_provenance() -> None:
    m = rod()
    assert "left untouched" in str(mbdkit.run(m, integrator=RK4, time={"end": 0.1, "step": 0.1}).provenance["assembly"])
    m.bodies["rod"] = m.bodies["rod"].model_copy(update={"position": (0.6, 0.0)})
    moved = mbdkit.run(m, integrator=RK4, time={"end": 0.1, "step": 0.1})
    assert "rod 0." in str(moved.provenance["assembly"])
    assert_within(moved.misalignment_max, 1e-4)


def test_a_mechanism_without_joints_falls_freely() -> None:
    # expected: a parabola
    m = Mechanism()
    m.body("stone", mass=2.0, position=(1.0, 2.0), velocity=(3.0, 4.0))
    for integrator in METHODS:
        run = mbdkit.run(m, integrator=integrator, time={"end": 0.5, "step": 0.1}).check()
        np.testing.assert_allclose(run["stone"].position[-1], [2.5, 4.0 - 9.81 / 8], rtol=0, atol=1e-7)
        assert run.misalignment_max == 0.0
        assert run.joint_names == ()


def test_a_mechanism_whose_every_freedom_is_driven_moves_as_told() -> None:
    # expected: the motion itself
    for integrator in METHODS:
        options = {**integrator, "rtol": 1e-11, "atol": 1e-12} if integrator["name"] in SCIPY else integrator
        run = mbdkit.run(driven("0.5*sin(2*t)"), integrator=options, time={"end": 0.5, "step": 0.01}).check()
        np.testing.assert_allclose(run["rod"].angle, 0.5 * np.sin(2 * np.asarray(run.time)), rtol=0, atol=1e-8)


# ---- SciPy's adaptive methods ----------------------------------------------------------------------------------------

adaptive = pytest.mark.parametrize("name", SCIPY)


@pytest.mark.parametrize(
    ("name", "start", "end", "interval"),
    [("scipy-radau", 0.0, 1.0, 0.1), ("scipy-dop853", 0.3, 1.0, 0.25), ("scipy-lsoda", 0.0, 0.4, 1.0)],
)
def test_an_interval_of_output_gives_rows_at_its_multiples_and_the_end(
    name: str, start: float, end: float, interval: float
) -> None:
    run = mbdkit.run(
        spec(integrator={"name": name}, time={"start": start, "end": end}, output={"interval": interval})
    ).check()
    count = int(np.ceil((end - start) / interval - 1e-9))
    expected = [*(start + interval * k for k in range(count)), end]
    np.testing.assert_allclose(run.time, expected, rtol=0, atol=1e-15)
    assert run.time[-1] == end
    assert run.array("steps/steps").sum() == run.stats["steps"]


@adaptive
def test_dense_output_is_about_as_good_as_the_steps(name: str) -> None:
    # expected: gauss with six stages, converged to round-off
    options = {"name": name, "rtol": 1e-10, "atol": 1e-12}
    run = mbdkit.run(spec(integrator=options, time={"end": 0.5}, output={"interval": 0.05})).check()
    best = mbdkit.run(spec(integrator={"name": "gauss", "stages": 6}, time={"end": 0.5, "step": 0.05}))
    np.testing.assert_allclose(run["rod2"].position, best["rod2"].position, rtol=0, atol=1e-7)


@adaptive
def test_a_tighter_tolerance_gives_a_smaller_error(name: str) -> None:
    best = mbdkit.run(spec(integrator={"name": "gauss", "stages": 6}, time={"end": 1.0, "step": 0.05}))
    errors = []
    for rtol in (1e-4, 1e-7):
        run = mbdkit.run(spec(integrator={"name": name, "rtol": rtol, "atol": rtol / 100}, time={"end": 1.0})).check()
        errors.append(np.abs(run["rod2"].position[-1] - best["rod2"].position[-1]).max())
    assert errors[0] > 10 * errors[1]


@adaptive
def test_every_counts_steps_of_an_adaptive_method(name: str) -> None:
    fine = mbdkit.run(spec(integrator={"name": name}, time={"end": 1.0})).check()
    coarse = mbdkit.run(spec(integrator={"name": name}, time={"end": 1.0}, output={"every": 4})).check()
    steps = fine.stats["steps"]
    assert len(fine.time) == steps + 1
    kept = sorted({*range(0, steps + 1, 4), steps})
    np.testing.assert_array_equal(coarse.time, fine.time[kept])
    np.testing.assert_array_equal(coarse["rod2"].position, fine["rod2"].position[kept])


def scipy_counts(name: str, options: dict[str, Any]) -> dict[str, int]:
    """Return what SciPy itself says of the same run, on mbdkit's right side."""
    import scipy.integrate

    from mbdkit.spec import load_spec

    solver = {"scipy-radau": "Radau", "scipy-dop853": "DOP853", "scipy-lsoda": "LSODA"}[name]
    p = mbdkit.EquationsOfMotion.of(load_spec(spec(), ()).mechanism())

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[p.n :], p.derivatives(t, y[: p.n], y[p.n :], p.z0)[0]])

    jacobian = {"jac": lambda t, y: p.jacobian(t, y[: p.n], y[p.n :], p.z0)} if name != "scipy-dop853" else {}
    found = scipy.integrate.solve_ivp(
        rates,
        (0.0, 1.0),
        np.concatenate([p.q0, p.v0]),
        method=solver,
        **options,
        **jacobian,
    )
    return {"steps": len(found.t) - 1, "nfev": found.nfev, "njev": found.njev, "nlu": found.nlu}


@adaptive
def test_counters_of_an_adaptive_method_are_those_of_scipy(name: str) -> None:
    # expected: scipy.integrate.solve_ivp on the same right side
    options = {"rtol": 1e-7, "atol": 1e-9}
    run = mbdkit.run(spec(integrator={"name": name, **options}, time={"end": 1.0})).check()
    expected = scipy_counts(name, options)
    assert run.stats["steps"] == run.stats["accepted"] == expected["steps"]
    assert abs(run.stats["rhs_evaluations"] - expected["nfev"]) <= 2
    assert run.stats["jacobian_evaluations"] == expected["njev"]
    solves = run.stats["rhs_evaluations"] + expected["nlu"]  # and up to two in every Jacobian
    jacobians = run.stats["jacobian_evaluations"]
    assert solves + jacobians <= run.stats["factorizations"] <= solves + 2 * jacobians
    assert run.array("steps/rejected").sum() == run.stats["rejected"]


@pytest.mark.parametrize("name", ["scipy-radau", "scipy-dop853"])
def test_a_first_step_that_overflows_is_taken_back(name: str) -> None:
    # expected: the solver rejects it, and the run is that of a better first step
    m = stiff()
    m.forces["s"] = m.forces["s"].model_copy(update={"stiffness": 1e8})
    runs = [mbdkit.run(m, integrator={"name": name}, time={"end": 1e-3, "step": step}) for step in (1e-3, 1e-9)]
    assert [run.status for run in runs] == ["complete", "complete"], runs[0].status_reason
    np.testing.assert_allclose(runs[0]["rod"].angle[-1], runs[1]["rod"].angle[-1], rtol=1e-5)


def threads_of_linear_algebra() -> set[int]:
    """Return the numbers of threads of the libraries of linear algebra that are loaded."""
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_a_run_uses_one_thread_of_linear_algebra_and_restores_their_number() -> None:
    # expected: with several threads, sums are split, and the last bits of results would depend on the computer
    import scipy.linalg  # noqa: F401  # loaded during the run, it would begin with one thread

    seen = []
    with threadpool_limits(2, user_api="blas"):
        before = threads_of_linear_algebra()
        mbdkit.run(spec(), progress=lambda reached, end: seen.append(threads_of_linear_algebra()))
        assert threads_of_linear_algebra() == before
    assert seen
    assert all(numbers == {1} for numbers in seen)


def test_the_library_of_scipy_has_one_thread_before_its_modules_are_imported() -> None:
    # expected: a run may need SciPy when it has begun; a library that is loaded only then would have all threads
    program = """
import mbdkit, sys
from threadpoolctl import threadpool_info

def libraries():
    return {one["filepath"]: one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

def look(reached, end):
    assert "scipy.linalg" not in sys.modules
    before = libraries()
    import scipy.linalg
    assert libraries() == before and set(before.values()) == {1}, (before, libraries())
    sys.exit("seen")

mbdkit.run("pendulum", progress=look)
"""
    several = {"OPENBLAS_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | several, capture_output=True, text=True, check=False
    )
    assert done.stderr.strip() == "seen"
