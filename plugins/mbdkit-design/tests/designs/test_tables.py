"""Designs whose variables are tables: whole characteristics of springs, and profiles of cams."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import LinearConstraint, minimize
from tests.designs.design_command import command

import mbdkit
from mbdkit import SpecError
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.problem import Problem
from mbdkit_design.search import searches
from mbdkit_design.store import DesignFolder, written_out

MASS, CENTER, GRAVITY = 2.0, 0.3, 9.81
SUPPORT = "model.forces.support.table"


def driven_rod(base: object = ((-1.0, 1.0), (1.0, 0.0)), **variable: object) -> dict:
    """Return the design of a spring that carries a rod, which a motor turns at constant speed through two radians."""
    given, m = [*map(list, base)], mbdkit.Mechanism()
    rod = m.body("rod", mass=MASS, inertia=0.1, position=(CENTER * np.cos(1.0), -CENTER * np.sin(1.0)), angle=-1.0)
    m.revolute("hip", m.ground, rod, at=(0, 0))
    m.driver("motor", m.ground, rod, coordinate="angle", motion="t - 1")
    base = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 2.0, "step": 0.02}}
    pathway = {"type": "relative-angle", "bodies": ["ground", "rod"]}
    base["model"]["forces"] = {"support": {"type": "law", "law": "table", "table": given, "pathway": pathway}}
    variables = {SUPPORT: {"points": 12, "bounds": [-20, 20]} | variable}
    goal = "integral(joints.motor.torque**2)"
    optimizer = {"name": "slsqp", "tolerance": 1e-12}
    return {"mbdkit_design": 1, "base": base, "variables": variables, "minimize": goal, "optimizer": optimizer}


def test_the_best_curve_carries_the_weight_of_a_rod_in_every_pose() -> None:
    # expected: m g c cos(angle) without inertia; the spline through 12 points is off by 384^-1 h^4 of it, and more at
    # its ends
    found = mbdkit.design(driven_rod())
    at, values = found.tables[SUPPORT]
    assert found.best.goals["goal"] < 1e-6
    np.testing.assert_allclose(values, -MASS * GRAVITY * CENTER * np.cos(at), atol=2e-3)
    assert found.derivatives.startswith("Derivatives are exact")


def test_the_best_curve_with_limits_of_slope_and_curvature_is_that_of_another_optimizer() -> None:
    slope, curvature = (-1.5, 2.5), (-3.0, 5.5)
    found = mbdkit.design(driven_rod(slope=slope, curvature=curvature))
    at, values = found.tables[SUPPORT]
    angle, step = np.linspace(-1.0, 1.0, 2001), at[1] - at[0]
    load = -MASS * GRAVITY * CENTER * np.cos(angle)
    to_angles, differences = CubicSpline(at, np.eye(12))(angle), np.diff(np.eye(12), axis=0) / step
    limits = [
        LinearConstraint(differences, *slope),
        LinearConstraint(np.diff(differences, axis=0) / step, *curvature),
    ]
    expected = minimize(
        lambda x: np.sum((to_angles @ x - load) ** 2) / 1e3,
        np.zeros(12),
        jac=lambda x: 2 * to_angles.T @ (to_angles @ x - load) / 1e3,
        hess=lambda x: 2 * to_angles.T @ to_angles / 1e3,
        method="trust-constr",
        constraints=limits,
        options={"gtol": 1e-10, "xtol": 1e-12, "barrier_tol": 1e-10, "maxiter": 500},
    ).x
    np.testing.assert_allclose(values, expected, atol=2e-3)
    slopes = differences @ values
    assert np.all((slopes >= slope[0] - 1e-5) & (slopes <= slope[1] + 1e-5))
    assert "of 11 slopes" in found.summary()


@pytest.mark.slow
def test_the_profile_of_a_cam_that_lifts_as_asked_is_found_and_closed() -> None:
    # expected: a point above the centre is as high as the radius at the angle pi/2 - rotation is long
    m = mbdkit.Mechanism()
    cam, follower = (
        m.body("cam", mass=1.0, inertia=1e-3),
        m.body("follower", mass=1.0, inertia=1e-3, position=(0, 0.02)),
    )
    m.revolute("shaft", m.ground, cam, at=(0, 0))
    m.driver("motor", m.ground, cam, coordinate="angle", motion="2*pi*t")
    m.prismatic("guide", m.ground, follower, at=(0, 0.02), axis=(0, 1))
    model = m.to_spec()
    profile = {"table": [[-np.pi, np.pi], [0.02, 0.02]], "ends": "periodic"}
    model["joints"]["lift"] = {"type": "cam", "bodies": ["cam", "follower"], "profile": profile}
    base = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.02}}
    base["parameters"] = {"middle": "20 mm", "lift": "2 mm"}
    key = "model.joints.lift.profile.table"
    variables = {key: {"points": 9, "bounds": ["15 mm", "25 mm"], "start": "20 mm"}}
    goal = "integral((follower.y - middle - lift*cos(cam.angle))**2)"
    design = {"mbdkit_design": 1, "base": base, "variables": variables, "minimize": goal}
    found = mbdkit.design(design)
    at, values = found.tables[key]
    print(values - (0.02 + 0.002 * np.sin(at)), found.summary())
    np.testing.assert_allclose(values, 0.02 + 0.002 * np.sin(at), atol=2e-5)
    assert values[0] == values[-1]


WRONG = {
    "three points": ({"points": 3}, "points: should be at least 4"),
    "no order": ({"slope": [2, 1]}, "slope: the lower limit 2 should be less than the upper limit 1"),
    "wrong unit": ({"bounds": ["1 m", "2 m"], "start": 1.5}, "bounds: has the unit m, which does not fit N m"),
    "wrong unit of the slope": ({"slope": ["-1 N m/s", "1 N m/s"]}, "does not fit N m/rad"),
    "no table": (
        {"base": [[1.0, 0.0], [1.0, 0.0]]},
        "the table of the base should be two columns of numbers, of which",
    ),
    "start outside": ({"start": [0, 30]}, "start: should be within the bounds -20 and 20, not 30"),
    "base outside": ({"bounds": [2, 3]}, "bounds: the table of the base has the value 1 outside"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_table_is_refused_with_its_key(case: str) -> None:
    variable, words = WRONG[case]
    with pytest.raises(SpecError) as caught:
        load_design_spec(driven_rod(**variable))
    assert f'variables."{SUPPORT}"' in str(caught.value)
    assert words in str(caught.value)


def test_the_default_start_is_the_curve_of_the_base_between_its_points() -> None:
    spec = load_design_spec(driven_rod(([-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]), points=5))
    assert len(spec.specs) == 1
    np.testing.assert_allclose(spec.tables[SUPPORT].start, [1.0, 0.25, 0.0, 0.25, 1.0], atol=1e-15)


def test_scenarios_with_different_tables_need_a_start() -> None:
    other = {SUPPORT: [[-1.0, 1.0], [2.0, 0.0]]}
    design = driven_rod() | {"scenarios": {"soft": {}, "hard": {"overrides": other}}}
    with pytest.raises(SpecError, match="different tables"):
        load_design_spec(design).specs  # noqa: B018
    design["variables"][SUPPORT]["start"] = 0.0
    assert len(load_design_spec(design).specs) == 2


def test_slopes_of_the_start_beyond_their_limits_are_told() -> None:
    found = mbdkit.design(driven_rod(((-1.0, 1.0), (4.0, 0.0)), slope=(-1.0, 3.0)), optimum_only=True)
    (gain,) = found.gains
    assert gain.start_violations == f"11 slopes of {SUPPORT} beyond the limits, by up to 1 in SI units"


def test_points_of_a_number_are_refused() -> None:
    design = driven_rod()
    design["variables"] = {"model.bodies.rod.mass": {"points": 5, "bounds": [1, 2]}}
    with pytest.raises(SpecError, match=r"only tables have `points`: those of laws `table`"):
        load_design_spec(design)


def test_a_folder_keeps_the_curve_and_its_report_draws_it(tmp_path: Path) -> None:
    spec = load_design_spec(driven_rod(points=5, slope=["-0.2 N m/deg", 20]))
    found = mbdkit.design(spec, out=tmp_path / "rod")
    assert DesignFolder(tmp_path / "rod").is_same(load_design_spec(written_out(copy.deepcopy(spec))))
    again = mbdkit.load_design(tmp_path / "rod")
    np.testing.assert_array_equal(again.tables[SUPPORT], found.tables[SUPPORT])
    with mbdkit.load(tmp_path / "rod" / "best.h5") as run:
        table = run.spec["model"]["forces"]["support"]["table"]
    np.testing.assert_array_equal(table, found.tables[SUPPORT])
    done = command("report", str(tmp_path / "rod"))
    assert done.exit_code == 0, done.stderr
    page = (tmp_path / "rod" / "report.html").read_text("utf-8")
    assert 'id="figure-curve-1"' in page
    assert 'id="table-table-1"' in page


@pytest.mark.slow
def test_another_optimizer_finds_the_packaged_curve_from_three_starts() -> None:
    # expected: a search by the interior-point method of SciPy, with its own linear constraints. The goal has kinks
    # where muscles begin to pull, so that searches end up to 0.1 % apart.
    spec = load_design_spec("knee-curve")
    evaluator = Evaluator(spec)
    problem = Problem(evaluator)
    (table,) = spec.tables.values()
    width, slopes = evaluator.widths[0], np.diff(np.eye(len(table.at)), axis=0) / (table.at[1] - table.at[0])
    curvatures = np.diff(slopes, axis=0) / (table.at[1] - table.at[0])
    rows = np.vstack([slopes * width / 120.0, curvatures * width / 1000.0])
    options = {"maxiter": 40, "gtol": 1e-5, "xtol": 1e-5, "barrier_tol": 1e-5, "initial_barrier_parameter": 0.01}
    best = searches(problem, spec.optimizer, evaluator.first)[0].cost
    for share in (evaluator.first, np.full(40, 0.3), np.linspace(0.1, 0.6, 40)):
        found = minimize(
            problem.cost,
            share,
            jac=problem.slope,
            method="trust-constr",
            bounds=[(0.0, 1.0)] * 40,
            constraints=LinearConstraint(rows, -1.0, 1.0),
            options=options,
        )
        assert found.fun == pytest.approx(best, rel=5e-3)
