"""Runs in lanes have the bits of single runs: states, recorded values, counters and what the guards saw."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from typing import Any

import numpy as np
import pytest

from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Guards, Timetable
from mbdkit.integrators.lane_stepper import (
    ControlledLaneStepper,
    LaneResults,
    LaneStepper,
    PivotsAtStart,
    VariedStarts,
)
from mbdkit.integrators.lanes.lane_mechanisms import suits_lanes, topology_of
from mbdkit.integrators.start import start_method
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.methods import dop853, dopri5, gauss, radau_iia, rk4, rk_gill
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Tolerances
from mbdkit.methods.step_filter import StepFilter
from mbdkit.runs.preparation import build
from mbdkit.spec import RunSpec
from tests.engine.random_mechanisms import chain, driven_frame, ladder, slides
from tests.integrators.running import driven_chain, workspace_of

METHODS: dict[str, ExplicitRungeKutta | ImplicitRungeKutta] = {
    "rk4": ExplicitRungeKutta(rk4.tableau()),
    "rk-gill": ExplicitRungeKutta(rk_gill.tableau()),
    "dopri5": ExplicitRungeKutta(dopri5.tableau()),  # its last stage is the first of the next step
    "dop853": ExplicitRungeKutta(dop853.tableau()),
    "gauss-2": ImplicitRungeKutta(gauss.tableau(2)),  # a pair of complex eigenvalues
    "gauss-3": ImplicitRungeKutta(gauss.tableau(3)),  # and a real one
    "gauss-2 by fixed points": ImplicitRungeKutta(gauss.tableau(2), "fixed-point"),
    "radau-iia-2": ImplicitRungeKutta(radau_iia.tableau(2)),
}
ALIKE = WIDTH < 8
"""On processors with two or four lanes, these few runs may all take as many iterations and steps by chance."""
IMPLICIT = [name for name, method in METHODS.items() if isinstance(method, ImplicitRungeKutta)]


TIGHT, LOOSE = Tolerances(1e-9, 1e-9, by_size=True), Tolerances(1e-4, 1e-5, max_step=0.2)
H211B = StepFilter((0.25, 0.25), (0.25,))
H321 = StepFilter((1 / 3, 1 / 18, -5 / 18), (-5 / 6, -1 / 6))

CONTROLLED: dict[str, ExplicitRungeKutta | ImplicitRungeKutta] = {
    "adaptive dopri5": ExplicitRungeKutta(dopri5.tableau(), dopri5.pair(), TIGHT),
    "adaptive dop853": ExplicitRungeKutta(dop853.tableau(), dop853.pair(), TIGHT),
    "loose dop853": ExplicitRungeKutta(dop853.tableau(), dop853.pair(), LOOSE),
    "adaptive radau-iia-3": ImplicitRungeKutta(radau_iia.tableau(3), tolerances=TIGHT),
    "loose gauss-2": ImplicitRungeKutta(gauss.tableau(2), tolerances=LOOSE),
    "loose radau-iia-2 by fixed points": ImplicitRungeKutta(radau_iia.tableau(2), "fixed-point", tolerances=LOOSE),
    "dopri5 with three errors": ExplicitRungeKutta(
        dopri5.tableau(), dopri5.pair(), dataclasses.replace(LOOSE, control=H321)
    ),
    "gauss-2 with a filter": ImplicitRungeKutta(gauss.tableau(2), tolerances=dataclasses.replace(LOOSE, control=H211B)),
}
RECORDED: dict[str, dict[str, Any]] = {
    "adaptive dopri5": {"every": 1}, "adaptive dop853": {"interval": 0.011}, "loose dop853": {"every": 3},
    "adaptive radau-iia-3": {"every": 2}, "loose gauss-2": {"interval": 0.011},
    "loose radau-iia-2 by fixed points": {"every": 1}, "dopri5 with three errors": {"every": 1},
    "gauss-2 with a filter": {"interval": 0.011},
}  # fmt: skip


def with_laws(rng: np.random.Generator) -> Mechanism:
    """Return a chain with force laws, whose compiled functions are called for each lane, a table and markers."""
    m = chain(rng, 3)
    options = {"stiffness": float(rng.uniform(50, 100)), "damping": 1.0, "free_length": 0.5, "acts": "tension"}
    m.law("stop", m.ground, "r2", points=((1.0, 1.0), (0.1, 0.0)), law="one-sided", **options)
    m.torque("drive", "r1", value={"table": [[0.0, 0.1, 0.3], [0.0, float(rng.uniform(1, 3)), -1.0]]})
    m.force("push", "r2", value=[1.0, "2*t"], point=(0.1, 0.2), frame="body")
    m.marker("tip", "r2", point=(0.5, 0.1))
    return m


def rolling(rng: np.random.Generator) -> Mechanism:
    """Return a disc that rolls on a swinging body: a center moves with the angle, by a table and an expression."""
    m = Mechanism()
    base = m.body("base", mass=1.0, inertia=0.3, position=(0.4, -0.2), angle=float(rng.uniform(-0.1, 0.1)))
    m.revolute("pivot", m.ground, base, at=(0.0, 0.0))
    disc = m.body("disc", mass=float(rng.uniform(1, 2)), inertia=0.1, position=(0.5, 0.1), angular_velocity=1.0)
    heights = [0.0, float(rng.uniform(0.01, 0.02)), 0.03, 0.02, 0.0]
    center = {"x": f"-{rng.uniform(0.1, 0.2)}*sin(angle)", "y": {"table": [[-2.0, -1.0, 0.1, 1.0, 2.0], heights]}}
    m.revolute("rolls", base, disc, at=(0.5, 0.1), center=center)
    m.driver("lift", m.ground, m.body("weight", mass=1.0), coordinate="y", motion="0.1*sin(t)")
    return m


def blade(rng: np.random.Generator) -> Mechanism:
    """Return a curved, damped beam on a swinging body, with elements of three nodes."""
    m = Mechanism()
    crank = m.body("crank", mass=1.0, inertia=0.1, position=(0.2, 0.0), angular_velocity=float(rng.uniform(1, 2)))
    m.revolute("hub", m.ground, crank, at=(0.0, 0.0))
    stiffness = {"axial": 100.0, "shear": 50.0, "bending": float(rng.uniform(1, 2))}
    points = ((0.4, 0.0), (0.9, float(rng.uniform(0.1, 0.2))), (1.4, 0.0))
    nodes = m.beam("blade", points=points, elements=2, nodes=3, stiffness=stiffness, mass_per_length=1.0, damping=0.01)
    m.weld("clamp", crank, nodes[0], at=(0.4, 0.0))
    return m


KINDS = {
    "blade": blade, "chain": chain, "ladder": ladder, "driven frame": driven_frame, "slides": slides, "laws": with_laws,
    "rolling": rolling, "springs": lambda rng: driven_chain(float(rng.uniform(10, 50)), float(rng.uniform(0.1, 1))),
}  # fmt: skip


class Nearby(np.random.Generator):
    """Draws the numbers of one seed, changed by a share that grows with the lane."""

    def __init__(self, lane: int):
        super().__init__(np.random.PCG64(8))
        self.share = 1.0 + 1e-4 * lane

    def uniform(self, *values: Any, **options: Any) -> Any:
        """See `numpy.random.Generator.uniform`."""
        return self.share * super().uniform(*values, **options)

    def normal(self, *values: Any, **options: Any) -> Any:
        """See `numpy.random.Generator.normal`."""
        return self.share * super().normal(*values, **options)


def tables(count: int, steps: int = 40, every: int = 3, **guards: float) -> list[Timetable]:
    """Return timetables with different starts and steps, and a shorter last step."""
    return [
        Timetable(
            start=0.1 * i, end=0.1 * i + (steps - 0.5) * (0.001 + 1e-4 * i), step=0.001 + 1e-4 * i, steps=steps,
            every=every, guards=Guards(**guards),
        )
        for i in range(count)
    ]  # fmt: skip


def workspaces_of(kind: str, planned: list[Timetable], *, near: bool = False) -> list[Workspace]:
    """Return mechanisms of one kind with different numbers, at the starts of their timetables.

    If they are `near` each other, their stage matrices have the same pivots.
    """
    draws = [Nearby(i) if near else np.random.default_rng(i) for i in range(len(planned))]
    return [workspace_of(KINDS[kind](draw), table.start) for draw, table in zip(draws, planned, strict=True)]


def rows_of(table: Timetable) -> int:
    """Return the number of recorded states, the initial one included."""
    return 1 + math.ceil(table.steps / table.every)


def advanced(method: str, workspaces: list[Workspace], planned: list[Timetable]) -> LaneResults:
    pivots = [PivotsAtStart().of(METHODS[method], *one) for one in zip(workspaces, planned, strict=True)]
    assert len({one and one.key for one in pivots}) == 1
    stepper = LaneStepper(METHODS[method], workspaces[0], rows_of(planned[0]), pivots[0])
    return stepper.advance(VariedStarts.of_starts(workspaces, pivots), planned)


def assert_same_bits(results: LaneResults, lane: int, method: str, workspace: Workspace, table: Timetable) -> None:
    """Assert that a lane has the bits of a run by the driver of single runs."""
    assert not results.lost[lane]
    own = workspace.for_another_run(workspace.formulation, workspace.stabilization)
    stepper = start_method((METHODS | CONTROLLED)[method], own, table)
    rows = slice(1, results.rows[lane])
    parts = []
    while not stepper.finished:
        parts.append(stepper.advance())
        assert stepper.failure is None
    for name in ("time", "q", "v"):
        np.testing.assert_array_equal(
            getattr(results, name)[lane, rows], np.concatenate([getattr(x, name) for x in parts])
        )
    for k, name in enumerate(("work", "dissipated")):
        np.testing.assert_array_equal(results.energy[lane, rows, k], np.concatenate([getattr(x, name) for x in parts]))
    iterations = np.concatenate([x.intervals[:, 3:5] for x in parts])
    np.testing.assert_array_equal(results.iterations[lane, rows], iterations)
    if results.work is not None:
        work = np.concatenate([x.intervals[:, [1, 2, 5]] for x in parts])
        np.testing.assert_array_equal(results.work[lane, rows], work)
    np.testing.assert_array_equal(results.worst[lane], stepper.worst_pairs)
    assert results.evidence_of(lane) == stepper.evidence
    assert {name: int(values[lane]) for name, values in results.counters.items()} == vars(stepper.counters)
    observer = StateObserver(workspace.with_own_pivots())
    expected = observer.arrays(len(results.time[lane]))
    assert observer.observe(results.time[lane], results.q[lane], results.v[lane], expected) is None
    for name in expected._fields:
        found = getattr(results.observed, name)[lane]
        np.testing.assert_array_equal(found, getattr(expected, name), err_msg=name)


COVER = [
    (kind, method)
    for number, kind in enumerate(KINDS)
    for place, method in enumerate(METHODS)
    if (number + place) % 4 == 0
]
"""Every kind with two methods, one of them implicit, and every method with two kinds."""


@pytest.mark.parametrize(("kind", "method"), COVER)
def test_every_lane_has_the_bits_of_the_single_run(kind: str, method: str) -> None:
    # expected: the driver of single runs, compiled from the same source for numbers
    planned = tables(WIDTH)
    workspaces = workspaces_of(kind, planned, near=method in IMPLICIT)
    assert all(suits_lanes(METHODS[method], one.mechanism, planned[0]) for one in workspaces)
    assert len({topology_of(one.mechanism) for one in workspaces}) == 1
    results = advanced(method, workspaces, planned)
    for lane, (workspace, table) in enumerate(zip(workspaces, planned, strict=True)):
        assert_same_bits(results, lane, method, workspace, table)


@pytest.mark.parametrize("kind", ["chain", "slides"])
@pytest.mark.parametrize("method", IMPLICIT)
def test_lanes_iterate_as_often_as_their_single_runs(kind: str, method: str) -> None:
    # different mechanisms take different numbers of iterations, and evaluate their tangents again at different times
    steps = [0.006 * (1.0 + 0.1 * i) for i in range(3 * WIDTH)]
    planned = [Timetable(0.0, 50 * step, step=step, steps=50, every=7) for step in steps]
    groups = defaultdict(list)
    for workspace, table in zip(workspaces_of(kind, planned), planned, strict=True):
        pivots = PivotsAtStart().of(METHODS[method], workspace, table)
        assert pivots is not None
        groups[pivots.key].append((workspace, table))
    members = max(groups.values(), key=len)[:WIDTH]
    workspaces, chosen = [one for one, _ in members], [table for _, table in members]
    results = advanced(method, workspaces, chosen)
    differing = {name: len(np.unique(values)) > 1 for name, values in results.counters.items()}
    assert ALIKE or differing["newton_iterations"]
    assert ALIKE or kind != "chain" or "fixed" in method or differing["jacobian_evaluations"]
    for lane in range(len(members)):
        assert_same_bits(results, lane, method, workspaces[lane], chosen[lane])


COVER_CONTROLLED = [
    (kind, method)
    for number, kind in enumerate(KINDS)
    for place, method in enumerate(CONTROLLED)
    if (number + place) % 3 == 1
]
"""Every kind with one explicit and one implicit method."""


def controlled(method: str, workspaces: list[Workspace], planned: list[Timetable]) -> LaneResults:
    pivots = [PivotsAtStart().of(CONTROLLED[method], *one) for one in zip(workspaces, planned, strict=True)]
    assert len({one and one.key for one in pivots}) == 1
    stepper = ControlledLaneStepper(CONTROLLED[method], workspaces[0], pivots[0])
    return stepper.advance(VariedStarts.of_starts(workspaces, pivots), planned)


def spans(count: int, recorded: dict[str, Any]) -> list[Timetable]:
    """Return timetables with different starts and ends, every second one with a first step that is too large."""
    return [Timetable(0.1 * i, 0.4 + 0.15 * i, step=(None, 0.4)[i % 2], **recorded) for i in range(count)]


@pytest.mark.parametrize(("kind", "method"), COVER_CONTROLLED)
def test_lanes_with_controlled_steps_have_the_bits_of_their_single_runs(kind: str, method: str) -> None:
    planned = spans(WIDTH, RECORDED[method])
    workspaces = workspaces_of(kind, planned, near=not CONTROLLED[method].traits.is_explicit)
    assert all(suits_lanes(CONTROLLED[method], one.mechanism, planned[0]) for one in workspaces)
    results = controlled(method, workspaces, planned)
    assert ALIKE or len(np.unique(results.counters["steps"])) > 1
    assert ALIKE or np.any(results.counters["rejected"])
    for lane, (workspace, table) in enumerate(zip(workspaces, planned, strict=True)):
        assert_same_bits(results, lane, method, workspace, table)


@pytest.mark.parametrize("method", CONTROLLED)
def test_a_stepper_of_controlled_lanes_remembers_nothing_of_earlier_runs(method: str) -> None:
    planned = spans(WIDTH, RECORDED[method])
    workspaces = workspaces_of("springs", planned, near=True)
    pivots = [PivotsAtStart().of(CONTROLLED[method], *one) for one in zip(workspaces, planned, strict=True)]
    stepper = ControlledLaneStepper(CONTROLLED[method], workspaces[0], pivots[0])
    stepper.advance(VariedStarts.of_starts(workspaces, pivots), planned)
    again = stepper.advance(VariedStarts.of_starts(workspaces[1:], pivots[1:]), planned[1:])
    assert len(again.lost) == WIDTH - 1
    for lane in (0, WIDTH - 2):
        assert_same_bits(again, lane, method, workspaces[lane + 1], planned[lane + 1])


def test_rows_by_interval_of_a_long_run_fit_beside_those_of_short_ones() -> None:
    planned = [Timetable(0.0, end, interval=0.001) for end in (0.01, 0.7)]
    workspaces = workspaces_of("chain", planned)
    results = controlled("adaptive dop853", workspaces, planned)
    assert results.rows.tolist() == [11, 701]
    for lane in range(2):
        assert_same_bits(results, lane, "adaptive dop853", workspaces[lane], planned[lane])


LOST_CONTROLLED: dict[str, dict[str, Any]] = {
    "steps": {"max_steps": 2},
    "misalignment": {"guards": Guards(misalignment=1e-17, angle_misalignment=1e-17)},
    "energy": {"guards": Guards(energy_jump=1e-16)},
}


@pytest.mark.parametrize("limit", LOST_CONTROLLED)
def test_a_run_with_controlled_steps_that_a_limit_stops_is_left_to_the_driver_of_single_runs(limit: str) -> None:
    planned = spans(WIDTH, {})
    planned[1] = dataclasses.replace(planned[1], **LOST_CONTROLLED[limit])
    workspaces = workspaces_of("chain", planned)
    results = controlled("loose dop853", workspaces, planned)
    assert results.lost.tolist() == [i == 1 for i in range(WIDTH)]
    assert_same_bits(results, 0, "loose dop853", workspaces[0], planned[0])


def test_a_run_with_controlled_steps_that_needs_other_pivots_is_left_to_the_driver_of_single_runs() -> None:
    method, planned = CONTROLLED["adaptive radau-iia-3"], [Timetable(0.0, 0.4), Timetable(0.7, 1.45)]
    workspaces = [workspace_of(with_laws(Nearby(7 * i)), table.start) for i, table in enumerate(planned)]
    pivots = [PivotsAtStart().of(method, *one) for one in zip(workspaces, planned, strict=True)]
    assert pivots[1] is not None
    weight = pivots[1].pattern.weight.copy()
    weight[: len(weight) // 2] = 0.0  # with the equations scaled like this, pivots vanish
    pivots[1] = pivots[1]._replace(pattern=pivots[1].pattern._replace(weight=weight))
    results = ControlledLaneStepper(method, workspaces[0], pivots[0]).advance(
        VariedStarts.of_starts(workspaces, pivots), planned
    )
    assert results.lost.tolist() == [False, True]
    assert_same_bits(results, 0, "adaptive radau-iia-3", workspaces[0], planned[0])


def test_a_run_that_would_be_projected_near_a_singular_position_is_left_to_the_driver_of_single_runs() -> None:
    def windows(speed: float) -> Workspace:
        spec = {"model": {"name": "n-four-bar", "n": 1, "speed": speed}, "time": {"end": 1.0, "step": 0.1}}
        return build(RunSpec(mbdkit=1, integrator={"name": "rk4"}, **spec))[0]

    planned = [Timetable(0.0, 0.2), Timetable(0.0, 3.0)]  # the second passes its flat position
    workspaces = [windows(1.0), windows(4.0)]
    single = start_method(CONTROLLED["adaptive dop853"], workspaces[1], planned[1])
    while not single.finished and single.failure is None:
        single.advance()
    assert single.counters.projections > 0
    results = controlled("adaptive dop853", [windows(1.0), windows(4.0)], planned)
    assert results.lost.tolist() == [False, True]
    assert_same_bits(results, 0, "adaptive dop853", workspaces[0], planned[0])


@pytest.mark.parametrize("method", IMPLICIT)
def test_a_run_whose_iteration_fails_is_left_to_the_driver_of_single_runs(method: str) -> None:
    planned = tables(WIDTH)
    workspaces = workspaces_of("chain", planned, near=True)
    workspaces[1].v0[:] *= 3000.0  # far too fast for these steps
    results = advanced(method, workspaces, planned)
    assert results.lost.tolist() == [i == 1 for i in range(WIDTH)]
    for lane in {0, WIDTH - 1} - {1}:
        assert_same_bits(results, lane, method, workspaces[lane], planned[lane])


@pytest.mark.parametrize("method", ["rk4", *IMPLICIT])
def test_a_stepper_of_lanes_remembers_nothing_of_earlier_runs(method: str) -> None:
    planned = tables(WIDTH)
    workspaces = workspaces_of("springs", planned)
    pivots = [PivotsAtStart().of(METHODS[method], *one) for one in zip(workspaces, planned, strict=True)]
    stepper = LaneStepper(METHODS[method], workspaces[0], rows_of(planned[0]), pivots[0])
    stepper.advance(VariedStarts.of_starts(workspaces, pivots), planned)
    again = stepper.advance(VariedStarts.of_starts(workspaces[::-1], pivots[::-1]), planned[::-1])
    assert_same_bits(again, 0, method, workspaces[-1], planned[-1])


@pytest.mark.parametrize("limit", [{"misalignment": 1e-12, "angle_misalignment": 1e-12}, {"energy_jump": 1e-9}])
def test_a_run_that_a_guard_would_stop_is_left_to_the_driver_of_single_runs(limit: dict[str, float]) -> None:
    planned = tables(WIDTH, steps=200)
    planned[1] = tables(2, steps=200, **limit)[1]
    workspaces = workspaces_of("springs", planned)
    workspaces[1] = workspace_of(driven_chain(1e4), planned[1].start)
    results = advanced("rk4", workspaces, planned)
    assert results.lost.tolist() == [i == 1 for i in range(WIDTH)]
    assert_same_bits(results, 0, "rk4", workspaces[0], planned[0])


def test_a_run_that_overflows_does_not_disturb_its_neighbours() -> None:
    planned = tables(WIDTH, steps=400)
    workspaces = workspaces_of("springs", planned)
    workspaces[1] = workspace_of(driven_chain(1e9), planned[1].start)  # far too stiff for these steps
    results = advanced("rk4", workspaces, planned)
    assert results.lost.tolist() == [i == 1 for i in range(WIDTH)]
    for i in {0, WIDTH - 1} - {1}:
        assert_same_bits(results, i, "rk4", workspaces[i], planned[i])


def test_what_lanes_cannot_do_is_refused() -> None:
    method, table = METHODS["rk4"], tables(1)[0]
    mechanism = workspaces_of("springs", [table])[0].mechanism
    assert suits_lanes(method, mechanism, table)
    assert not suits_lanes(method, mechanism, Timetable(0.0, 1.0, step=0.1, steps=10, interval=0.05))
    assert not suits_lanes(method, mechanism, Timetable(0.0, 1.0, step=0.1, steps=10, single=True))
    assert not suits_lanes(method, mechanism, Timetable(0.0, 1.0, step=0.1, steps=10, max_steps=9))
    assert topology_of(mechanism) != topology_of(workspace_of(chain(np.random.default_rng(1), 4)).mechanism)
