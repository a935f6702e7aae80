"""Pareto fronts and searches without gradients, on distances of a point from places in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.designs.oscillator import distance, moved, tuned

import mbdkit
from mbdkit import SpecError
from mbdkit_design import search
from tests.margins import assert_within

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
ROUGH = {"name": "slsqp", "tolerance": 1e-6}
CMA = {"name": "cma-es", "tolerance": 1e-5}


def places(points: Any) -> np.ndarray:
    return np.array([[*one.variables.values()] for one in points])


def goals_of(corners: np.ndarray) -> dict[str, str]:
    return {f"from_{k}": distance(*corner) for k, corner in enumerate(corners)}


def test_the_front_of_two_distances_is_the_segment_between_the_places() -> None:
    found = mbdkit.design(moved(goals_of(CORNERS[:2]), front=4, optimizer=ROUGH))
    points = places(found.front)
    np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-3)
    # expected: (1 - x)^2 falls evenly from 1 to 0
    np.testing.assert_allclose((1 - points[:, 0]) ** 2, np.linspace(1, 0, 4), atol=1e-4)
    lines = found.summary().splitlines()
    place = next(k for k, line in enumerate(lines) if line == "Points of the Pareto front")
    assert [line.split()[0] for line in lines[place + 2 : place + 6]] == list("1234")
    assert sum("(best)" in line for line in lines) == 1


@pytest.mark.slow
def test_the_front_of_three_distances_is_the_triangle() -> None:
    found = mbdkit.design(moved(goals_of(CORNERS), front=4, optimizer=ROUGH))
    points = places(found.front)
    assert len(points) > 8
    assert np.all(points > -1e-3)
    assert np.all(points.sum(axis=1) < 1 + 1e-3)
    for corner in CORNERS:
        assert_within(np.min(np.linalg.norm(points - corner, axis=1)), 1e-3)
    inside = (points > 0.02).all(axis=1) & (points.sum(axis=1) < 0.98)
    assert np.any(inside)
    assert found.best in found.front


@pytest.mark.slow
def test_a_front_within_limits_and_a_bound_that_fixes_a_variable() -> None:
    # expected: y = 0.5 at its bound, and x between the limit 0.25 and 1, the nearest places to the corners
    variables = moved("")["variables"]
    variables["model.bodies.point.position.1"] = {"bounds": [0.5, 2.0]}
    limits = {"left": {"value": "final(point.x)", "min": 0.25}}
    found = mbdkit.design(
        moved(goals_of(CORNERS[:2]), variables=variables, subject_to=limits, front=3, optimizer=ROUGH)
    )
    points = places(found.front)
    np.testing.assert_allclose(points[:, 1], 0.5, atol=1e-6)
    np.testing.assert_allclose(points[[0, -1], 0], [0.25, 1.0], atol=1e-5)
    assert np.all(np.diff(points[:, 0]) > 0)


def test_a_point_that_is_worse_in_one_goal_and_better_in_none_is_not_on_the_front() -> None:
    # the first goal is 0.2 for all x up to 0.2, and the second one is least at x = -1: this is the whole front
    goals = {"flat": "max(final(point.x), 0.2)", "other": "(final(point.x) + 1)**2 + final(point.y)**2"}
    found = mbdkit.design(moved(goals, front=3))
    np.testing.assert_allclose(places(found.front), [[-1.0, 0.0]] * len(found.front), atol=1e-3)


def test_a_front_without_a_point_that_satisfies_the_limits_says_so() -> None:
    limits = {"far": {"value": "final(point.x)", "min": 5.0}}
    found = mbdkit.design(moved(goals_of(CORNERS[:2]), subject_to=limits, front=3))
    assert not found.is_feasible
    assert "There is no gain of from_0, which grows by 3.02" in found.summary()  # from 0.98 to 2^2 at the bound
    assert "which is worse by more than the errors; but the start is not allowed" in found.summary()
    assert "No point that satisfies all limits was found" in found.summary()


def test_bounds_without_room_say_how_to_fix_a_variable() -> None:
    variables = moved("")["variables"] | {"model.bodies.point.position.1": {"bounds": [0.5, 0.5]}}
    with pytest.raises(SpecError, match="to fix it, set its key under `overrides`"):
        mbdkit.design(moved(distance(0, 0), variables=variables))


@pytest.mark.slow
def test_cma_es_finds_the_nearest_point_within_a_limit() -> None:
    # expected: (0.3, 0), and with x + y >= 1 the foot (0.65, 0.35) of the perpendicular to the line
    pytest.importorskip("cma")
    free = mbdkit.design(moved(distance(0.3, 0), optimizer=CMA))
    np.testing.assert_allclose(places([free.best])[0], [0.3, 0.0], atol=5e-3)
    limits = {"sum": {"value": "final(point.x) + final(point.y)", "min": 1.0}}
    found = mbdkit.design(moved(distance(0.3, 0), optimizer=CMA, subject_to=limits))
    assert found.is_feasible
    np.testing.assert_allclose(places([found.best])[0], [0.65, 0.35], atol=1e-2)
    assert found.best.goals["goal"] == pytest.approx(0.245, rel=1e-3)


@pytest.mark.slow
def test_cma_es_with_one_seed_finds_one_result() -> None:
    pytest.importorskip("cma")
    first, second = (mbdkit.design(moved(distance(0.3, 0), optimizer=CMA)) for _ in range(2))
    assert first.to_dict() == second.to_dict()


def test_cma_es_without_its_package_or_for_one_variable_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "find_spec", lambda name: None)
    with pytest.raises(SpecError, match=r"optimizer\.name: cma-es needs the package cma.*pip install"):
        mbdkit.design(moved(distance(0, 0), optimizer=CMA))
    with pytest.raises(SpecError, match="needs two variables or more"):
        mbdkit.design(tuned(optimizer=CMA))
