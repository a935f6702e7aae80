"""Which joints are redundant, which starts are singular or contradictory, and how long it takes to tell."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.assembly import assemble
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.redundancy import without_redundancy
from mbdkit.engine.self_stress import looped_rows
from mbdkit.mechanism.mechanism import Mechanism

from .random_mechanisms import KINDS


def add_rod(m: Mechanism, name: str, start: tuple[float, float], end: tuple[float, float]) -> None:
    along = np.subtract(end, start)
    length = float(np.hypot(*along))
    angle = math.atan2(along[1], along[0])
    m.body(name, mass=length, inertia=length**3 / 12, position=np.add(start, end) / 2, angle=angle)


def analysed(m: Mechanism, end: float = 1.0) -> CompiledMechanism:
    compiled = compile_mechanism(m)
    start = assemble(m, 0.0, compiled)
    return without_redundancy(compiled, 0.0, start.q.ravel(), start.v.ravel(), end)


def parallelogram(angle: float = -1.0, spare: bool = False) -> Mechanism:
    """Return two cranks (or three) and a coupler, with the pins A to D (E and F)."""
    m = Mechanism()
    tip = (math.cos(angle), math.sin(angle))
    bases = (0.0, 2.0, 0.7) if spare else (0.0, 2.0)
    for i, base in enumerate(bases):
        add_rod(m, f"crank{i}", (base, 0.0), (base + tip[0], tip[1]))
    add_rod(m, "coupler", tip, (2.0 + tip[0], tip[1]))
    for i, base in enumerate(bases):
        m.revolute("ACE"[i], m.ground, f"crank{i}", at=(base, 0.0))
        m.revolute("BDF"[i], f"crank{i}", "coupler", at=(base + tip[0], tip[1]))
    return m


def ladder(bays: int, spares: int = 0) -> Mechanism:
    """Return parallelograms one below the other, the first few with a spare crank."""
    m = Mechanism()
    corners, above = [np.zeros(2), np.array([2.0, 0.0])], m.ground
    for i in range(bays):
        tilt = -1.2 + 0.3 * math.sin(1.7 * i)
        step = np.array([math.cos(tilt), math.sin(tilt)])
        starts = [*corners, *([corners[0] + [0.7, 0.0]] if i < spares else [])]
        corners = [corner + step for corner in corners]
        add_rod(m, f"rung{i}", tuple(corners[0]), tuple(corners[1]))
        for k, start in enumerate(starts):
            add_rod(m, f"side{k}_{i}", tuple(start), tuple(start + step))
            m.revolute(f"A{k}_{i}", above, f"side{k}_{i}", at=start)
            m.revolute(f"B{k}_{i}", f"side{k}_{i}", f"rung{i}", at=start + step)
        above = f"rung{i}"
    return m


def chain_of(n: int) -> Mechanism:
    m = Mechanism()
    before = m.ground
    for i in range(n):
        add_rod(m, f"r{i}", (float(i), 0.0), (i + 1.0, 0.0))
        m.revolute(f"J{i}", before, f"r{i}", at=(float(i), 0.0))
        before = f"r{i}"
    return m


def three_pins() -> Mechanism:
    m = Mechanism()
    add_rod(m, "left", (0.0, 0.0), (1.0, 0.0))
    add_rod(m, "right", (1.0, 0.0), (2.0, 0.0))
    m.revolute("J0", m.ground, "left", at=(0.0, 0.0))
    m.revolute("J1", "left", "right", at=(1.0, 0.0))
    m.revolute("J2", "right", m.ground, at=(2.0, 0.0))
    return m


def stretched_crank(*, held: bool) -> Mechanism:
    """Return a slider-crank in its outer dead centre, its slider held there by a driver or not."""
    m = Mechanism()
    add_rod(m, "crank", (0.0, 0.0), (1.0, 0.0))
    add_rod(m, "rod", (1.0, 0.0), (3.0, 0.0))
    m.body("slider", mass=1.0, inertia=1.0, position=(3.0, 0.0))
    m.revolute("A", m.ground, "crank", at=(0.0, 0.0))
    m.revolute("B", "crank", "rod", at=(1.0, 0.0))
    m.revolute("C", "rod", "slider", at=(3.0, 0.0))
    m.prismatic("guide", m.ground, "slider", at=(3.0, 0.0), axis=(1.0, 0.0))
    if held:
        m.driver("hold", m.ground, "slider", coordinate="x", motion=3.0)
    return m


def slide_on_two_guides() -> Mechanism:
    m = Mechanism()
    m.body("block", mass=1.0, inertia=1.0)
    m.prismatic("P", m.ground, "block", points=((0.0, 0.0), (0.0, 0.0)), axis=(1.0, 1.0))
    m.prismatic("Q", m.ground, "block", points=((1.0, 0.0), (1.0, 0.0)), axis=(1.0, 1.0))
    return m


def driven(first: str, second: str) -> Mechanism:
    m = Mechanism()
    add_rod(m, "rod", (0.0, 0.0), (1.0, 0.0))
    m.revolute("pin", m.ground, "rod", at=(0.0, 0.0))
    m.driver("D1", m.ground, "rod", coordinate="angle", motion=first)
    m.driver("D2", m.ground, "rod", coordinate="angle", motion=second)
    return m


def point_mass_on_rods() -> Mechanism:
    m = Mechanism()
    m.body("node", mass=1.0, position=(0.0, -1.0))
    for i, x in enumerate((-1.0, 0.0, 1.0)):
        m.distance(f"bar{i}", m.ground, "node", from_=(x, 0.0), to=(0.0, -1.0))
    return m


BOTH = "0.1*t**2"


def repeated() -> Mechanism:
    """Return a rod that is pinned twice and driven twice."""
    m = driven("sin(t)", "sin(t)")
    m.revolute("again", m.ground, "rod", at=(0.0, 0.0))
    return m


@pytest.mark.parametrize(
    ("build", "expected"),
    [
        (lambda: parallelogram(), "1 degree of freedom, 4 joints"),
        (
            lambda: parallelogram(spare=True),
            "1 degree of freedom, 6 joints, 1 redundant row: joints A, B, C, D, E and F",
        ),
        (lambda: ladder(3, 2), "3 degrees of freedom, 16 joints, 2 redundant rows: joints "),
        (slide_on_two_guides, "1 degree of freedom, 2 joints, 2 redundant rows: joints P and Q"),
        (lambda: driven(BOTH, BOTH), "0 degrees of freedom, 1 joint, 2 drivers, 1 redundant row: drivers D1 and D2"),
        (point_mass_on_rods, "0 degrees of freedom, 3 joints, 1 redundant row: joints bar0, bar1 and bar2"),
        (repeated, "0 degrees of freedom, 2 joints, 2 drivers, 3 redundant rows: joints "),
        (lambda: stretched_crank(held=False), "1 degree of freedom, 4 joints"),
    ],
)  # expected: Gruebler's count with the loops that close by themselves left out, by hand
def test_freedoms_are_counted_by_rank(build: Callable[[], Mechanism], expected: str) -> None:
    assert analysed(build()).freedoms().startswith(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_mechanisms_without_redundancy_are_left_as_they_are(kind: str) -> None:
    # expected: numpy's rank of the dense Jacobian is full, as test_accelerations.py needs it
    compiled = compile_mechanism(KINDS[kind](np.random.default_rng(0)))
    start = assemble(KINDS[kind](np.random.default_rng(0)), 0.0, compiled)
    assert without_redundancy(compiled, 0.0, start.q.ravel(), start.v.ravel(), 1.0) is compiled


@pytest.mark.parametrize(
    ("build", "names"),
    [
        (lambda: parallelogram(0.0), {"A", "B", "C", "D"}),
        (lambda: parallelogram(0.0, spare=True), {"A", "B", "C", "D", "E", "F"}),
        (three_pins, {"J0", "J1", "J2"}),
        (lambda: stretched_crank(held=True), {"A", "B", "C", "hold"}),
    ],
)
def test_a_start_that_is_dependent_there_alone_is_refused_as_singular(
    build: Callable[[], Mechanism], names: set[str]
) -> None:
    # expected: by hand; rods on one line carry a force along it that nothing balances but themselves
    with pytest.raises(mbdkit.SpecError, match="singular position at the start") as caught:
        analysed(build())
    listed = str(caught.value).split("solution: joints ")[1].split(" are dependent")[0]
    assert set(listed.replace(" and ", ", ").split(", ")) == names


@pytest.mark.parametrize(
    ("second", "why"),
    [
        ("0.1", "cannot be assembled"),
        ("t", "cannot have consistent velocities"),
        ("t**2", "different accelerations"),
        ("t**3", "can no longer be satisfied together"),
    ],
)
def test_drivers_that_contradict_each_other_are_named(second: str, why: str) -> None:
    with pytest.raises(mbdkit.SpecError, match=why) as caught:
        analysed(driven("0*t", second))
    assert "D1" in str(caught.value)
    assert "D2" in str(caught.value)
    assert "pin" not in str(caught.value)


def test_a_guide_across_the_path_of_a_slider_is_refused_with_what_to_correct() -> None:
    m = Mechanism()
    m.body("crank", mass=1.0, inertia=0.1, position=(0.0, -0.5), angle=-math.pi / 2)
    m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -2.0), angle=-math.pi / 2)
    m.body("slider", mass=1.0, inertia=0.1, position=(0.0, -3.0))
    m.revolute("A", m.ground, "crank", at=(0.0, 0.0))
    m.revolute("B", "crank", "rod", at=(0.0, -1.0))
    m.revolute("C", "rod", "slider", at=(0.0, -3.0))
    m.prismatic("guide", m.ground, "slider", at=(0.0, -3.0), axis=(1.0, 0.0))
    m.driver("motor", m.ground, "crank", coordinate="angle", motion="3*t - pi/2")
    with pytest.raises(mbdkit.SpecError, match="points and axes of these joints or the motion of driver motor, or rem"):
        mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01})


def test_a_spare_rod_that_is_too_long_is_refused_by_name() -> None:
    m = parallelogram()
    m.distance("strut", m.ground, "coupler", points=((0.7, 0.0), (-0.3, 0.0)), length=1.001)
    with pytest.raises(mbdkit.SpecError, match=r"these joints cannot be assembled .*strut \("):
        analysed(m)


def test_earlier_joints_stay_and_drivers_stay_before_all() -> None:
    # expected: the last joint of the loop goes, but not the driver behind it
    m = parallelogram(spare=True)
    m.joints = {name: m.joints[name] for name in "FEDCBA"}
    m.driver("turn", m.ground, "crank0", coordinate="angle", motion="t - 1")
    compiled = analysed(m)
    (spare,) = compiled.topology.spare[:, 0]
    assert compiled.joints[compiled.topology.pair_joint[spare]] == "A"


def test_reactions_are_not_unique_in_the_redundant_loop_alone() -> None:
    m = parallelogram(spare=True)
    add_rod(m, "tail", (2.0 + math.cos(1.0), -math.sin(1.0)), (3.0, -1.0))
    m.revolute("hinge", "coupler", "tail", at=(2.0 + math.cos(1.0), -math.sin(1.0)))
    assert analysed(m).redundancy.not_unique == ("A", "B", "C", "D", "E", "F")


def test_joints_of_trees_need_no_look() -> None:
    # expected: a tree has no loop; of a tree with one loop the loop is left
    for kind in ("chain", "tree"):
        assert len(looped_rows(compile_mechanism(KINDS[kind](np.random.default_rng(1))))) == 0
    m = parallelogram()
    add_rod(m, "tail", (0.0, 0.0), (0.0, 1.0))
    m.revolute("hinge", m.ground, "tail", at=(0.0, 0.0))
    compiled = compile_mechanism(m)
    assert {compiled.rows[i].label[0] for i in looped_rows(compiled)} == set("ABCD")


@pytest.mark.parametrize(
    ("build", "allowed"),
    [
        pytest.param(lambda: chain_of(3000), 1.0, id="chain of 3000"),
        pytest.param(lambda: ladder(333), 20.0, id="ladder of 999"),
        pytest.param(lambda: ladder(333, 2), 40.0, id="ladder of 1001 with two spare rods"),
    ],
)
def test_large_mechanisms_are_analysed_in_bearable_time(build: Callable[[], Mechanism], allowed: float) -> None:
    # expected: 0.02 s, 1 s and 2 s on an idle machine; a dense decomposition takes minutes
    m = build()
    compiled = compile_mechanism(m)
    start = assemble(m, 0.0, compiled)
    begin = time.perf_counter()
    found = without_redundancy(compiled, 0.0, start.q.ravel(), start.v.ravel(), 1.0)
    assert time.perf_counter() - begin < allowed
    assert found.redundancy.rows == sum(name.startswith("side2") for name in m.bodies)
