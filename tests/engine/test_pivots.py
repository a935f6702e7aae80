"""The pivoted solver in whole runs: forced, worn out on the way, and at the end of its means."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine import workspace as problem_module
from mbdkit.engine.assembly import assemble
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.elimination_order import PivotChoice, pivot_order
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.observe import constraints_at
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.methods import gauss, rk4
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method

from .random_mechanisms import loop

METHODS = {"rk4": {"name": "rk4"}, "gauss2": {"name": "gauss"}, "gauss3": {"name": "gauss", "stages": 3}}
integrators = pytest.mark.parametrize("integrator", METHODS.values(), ids=METHODS)


def with_crumb(m: Mechanism) -> Mechanism:
    """Add a free point mass so light that the masses count as badly scaled: the run takes the pivoted system."""
    m.body("crumb", mass=1e-7)
    assert not compile_mechanism(m).well_scaled
    return m


def long_rods(length: float = 40.0) -> Mechanism:
    """Return two rods that turn over, so long that pivots are best taken from the columns of their angles."""
    m = Mechanism()
    for i in range(2):
        x = (i + 0.5) * length
        moving = {"velocity": (0.0, x * 1.5), "angular_velocity": 1.5}
        m.body(f"rod{i}", mass=1.0, inertia=length**2 / 12, position=(x, 0.0), **moving)
        m.revolute(f"J{i}", m.ground if i == 0 else "rod0", f"rod{i}", at=(i * length, 0.0))
    return m


def final_angles(m: Mechanism, integrator: dict[str, Any], end: float = 3.0, step: float = 0.01) -> np.ndarray:
    run = mbdkit.run(m, integrator=integrator, time={"end": end, "step": step}).check()
    return np.array([run[name].angle[-1] for name in m.bodies if name != "crumb"])


@integrators
def test_the_pivoted_system_gives_the_motion_of_the_schur_complement(integrator: dict[str, Any]) -> None:
    # expected: the same rods without the crumb
    expected = final_angles(long_rods(), integrator)
    assert np.abs(expected).min() > 1.5
    np.testing.assert_allclose(final_angles(with_crumb(long_rods()), integrator), expected, rtol=0, atol=1e-9)


@integrators
def test_a_body_whose_centre_stands_still_does_not_stop_the_pivoted_system(integrator: dict[str, Any]) -> None:
    # expected: the same loop without the crumb; its last rod is pinned at its centre, whose acceleration is zero
    def closed(seed: int = 0) -> Mechanism:
        m = loop(np.random.default_rng(seed))
        del m.joints["motor"], m.joints["rod"]
        still = {"velocity": (0.0, 0.0), "angular_velocity": 0.0}
        m.bodies = {name: body.model_copy(update=still) for name, body in m.bodies.items()}
        return m

    expected = final_angles(closed(), integrator, end=0.5)
    np.testing.assert_allclose(final_angles(with_crumb(closed()), integrator, end=0.5), expected, rtol=0, atol=1e-9)


def doomed_order(n: int, row: np.ndarray, column: np.ndarray, values: np.ndarray, *_: Any) -> Any:
    """Order pivots so that the first one is d(A.y)/d(theta) of body 0, which vanishes at a right angle."""
    matrix = np.zeros((n, n))
    matrix[row, column] = values
    pivots = [(n - 1, 2)]
    while len(pivots) < n:
        i, j = pivots[-1]
        matrix -= np.outer(matrix[:, j], matrix[i]) / matrix[i, j]
        matrix[i], matrix[:, j] = 0.0, 0.0
        left = np.abs(matrix)
        pivots.append(tuple(int(x) for x in np.unravel_index(np.argmax(left), left.shape)))  # type: ignore[arg-type]
    rows, columns = (np.array(x) for x in zip(*pivots, strict=True))
    return PivotChoice(rows, columns, np.ones(n), np.ones(n))


@pytest.mark.parametrize(
    ("method", "late"),
    [
        pytest.param(ExplicitRungeKutta(rk4.tableau()), 0.0, id="rk4"),
        pytest.param(ImplicitRungeKutta(gauss.tableau(1)), 0.5, id="gauss1"),
        pytest.param(ImplicitRungeKutta(gauss.tableau(3)), 0.5, id="gauss3"),
    ],
)
def test_pivots_that_wear_out_on_the_way_are_chosen_anew(
    method: Method, late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # expected: uniform rotation; a stage meets the angle at which the pivot chosen at the start vanishes
    step, rate = 0.01, np.pi / 2
    begin = -late * step * rate
    m = Mechanism(gravity=(0.0, 0.0))
    arm = 0.5 * np.array([np.cos(begin), np.sin(begin)])
    moving = {"velocity": (-rate * arm[1], rate * arm[0]), "angular_velocity": rate}
    m.body("rod", mass=1.0, inertia=1 / 12, position=arm, angle=begin, **moving)
    m.revolute("A", m.ground, "rod", points=((0.0, 0.0), (-0.5, 0.0)))
    compiled = compile_mechanism(with_crumb(m))
    start = assemble(m, 0.0, compiled)
    q, v = with_ground(start.q), with_ground(start.v)
    workspace = Workspace(compiled, 0.0, q, v)
    constraints_at(compiled.topology, workspace.scratch, 0.0, q, v)
    with monkeypatch.context() as patch:
        patch.setattr(problem_module, "pivot_order", doomed_order)
        workspace.use_pivots()
    stepper = start_method(method, workspace, Timetable(0.0, 3.0, step=step, steps=300))
    at_start = workspace.pivotings
    rows = []
    while not stepper.finished:
        rows.append(stepper.advance())
        assert stepper.failure is None
    assert at_start < workspace.pivotings <= at_start + 3
    angles = np.concatenate([stretch.q[:, 2] for stretch in rows])
    np.testing.assert_allclose(angles, begin + rate * step * np.arange(1, 301), rtol=0, atol=1e-11)


@integrators
def test_a_start_at_a_dead_centre_is_refused_and_says_where(integrator: dict[str, Any]) -> None:
    m = Mechanism()
    for i in range(2):
        m.body(f"rod{i}", mass=1.0, inertia=0.1, position=(i + 0.5, 0.0))
        m.revolute(f"J{i}", m.ground if i == 0 else "rod0", f"rod{i}", at=(i, 0.0))
    m.revolute("end", "rod1", m.ground, at=(2.0, 0.0))  # three pins on a line: a singular position
    with pytest.raises(mbdkit.SpecError, match=r"singular position at the start.*joints J0, J1 and end"):
        mbdkit.run(m, integrator=integrator, time={"end": 0.1, "step": 0.01})


def test_a_redundant_mechanism_whose_pivots_wear_out_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    # expected: the run with pivots that were chosen well
    def pinned_twice() -> Mechanism:
        m = with_crumb(long_rods())
        m.revolute("twin", "rod0", "rod1", at=(40.0, 0.0))
        return m

    expected = final_angles(pinned_twice(), METHODS["rk4"], end=0.5)
    calls = []

    def first_doomed(*arguments: Any) -> Any:
        calls.append(1)
        return (doomed_order if len(calls) == 1 else pivot_order)(*arguments)

    monkeypatch.setattr(problem_module, "pivot_order", first_doomed)
    np.testing.assert_allclose(final_angles(pinned_twice(), METHODS["rk4"], end=0.5), expected, rtol=0, atol=1e-9)


def test_infinite_derivatives_left_by_another_state_do_not_prevent_new_pivots() -> None:
    # expected: the accelerations of a workspace without such derivatives
    plain, left = (workspace_at_start(with_crumb(long_rods()))[0] for _ in range(2))
    left.scratch.stiff[:] = np.inf
    found = []
    for workspace in (plain, left):
        observer = StateObserver(workspace)
        out = observer.arrays(1)
        assert workspace.pivotings == 0
        assert observer.observe(np.zeros(1), workspace.q0[None], workspace.v0[None], out) is None
        assert workspace.pivotings == 1
        found.append(out.acc)
    np.testing.assert_array_equal(found[0], found[1])
    assert np.all(np.isfinite(found[0]))


def test_the_jacobian_for_scipy_chooses_pivots_that_it_lacks() -> None:
    # expected: the Jacobian of equations that have pivots already
    workspace, _ = workspace_at_start(with_crumb(long_rods()))
    first, second = EquationsOfMotion(workspace), EquationsOfMotion(replace(workspace))
    first.accelerations(0.0, first.q0, first.v0)
    assert workspace.pivotings == 1
    expected = first.jacobian(0.0, first.q0, first.v0, first.z0)
    np.testing.assert_array_equal(second.jacobian(0.0, first.q0, first.v0, first.z0), expected)
