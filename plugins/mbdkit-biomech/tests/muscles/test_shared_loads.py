"""The convex programmes of recruitment against independent solvers, and their certificates."""

import numpy as np
import pytest
from scipy.optimize import linprog
from tests.muscles.shared_loads import EQUATIONS, FRAMES, by_casadi, problems

from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import share_loads, smallest_supplement
from tests.margins import assert_within


@pytest.mark.parametrize("reserves", [0.0, 20.0])
def test_squares_are_minimised_as_by_an_active_set_method(reserves):
    programme = problems(reserves)
    found = share_loads(programme, 2.0)
    assert_within(found.certificate, 1e-12)
    for row in range(FRAMES):
        np.testing.assert_allclose(found.value[row], by_casadi(programme, row, 2), rtol=0, atol=1e-8)


@pytest.mark.parametrize("p", [3, 4])
@pytest.mark.parametrize("reserves", [0.0, 20.0])
def test_higher_powers_are_minimised_as_by_an_interior_point_method(p, reserves):
    programme = problems(reserves)
    found = share_loads(programme, float(p))
    assert_within(found.certificate, 1e-10)
    begun = share_loads(programme, float(p), np.roll(found.multipliers, 1, axis=0))  # the optimum has no memory
    np.testing.assert_allclose(begun.value / programme.weight, found.value / programme.weight, rtol=0, atol=1e-6)
    for row in range(0, FRAMES, 4):
        other = by_casadi(programme, row, p)
        np.testing.assert_allclose(found.value[row], other, rtol=0, atol=1e-5)  # flat where shares are small
        cost = [np.sum(np.abs(x / programme.weight) ** p) for x in (found.value[row], other)]
        assert cost[0] == pytest.approx(cost[1], rel=1e-8)


@pytest.mark.parametrize("reserves", [0.0, 20.0])
@pytest.mark.parametrize("p", [1.0, np.inf])
def test_linear_programmes_have_the_optimum_of_another_formulation(p, reserves):
    programme = problems(reserves)
    found = share_loads(programme, p)
    assert_within(found.certificate, 1e-10)
    for row in range(FRAMES):
        # with x = weight * s, and |s| <= t: sum of t, or largest t
        count = len(programme.weight)
        eye, tops = np.eye(count), np.ones((count, 1)) if np.isinf(p) else np.eye(count)
        less = np.vstack([np.hstack([eye, -tops]), np.hstack([-eye, -tops])])
        cost = np.append(np.zeros(count), np.ones(tops.shape[1]))
        matrix = np.hstack([programme.matrix[row] * programme.weight, np.zeros((EQUATIONS, tops.shape[1]))])
        bounds = [
            *zip(programme.low[row] / programme.weight, programme.high[row] / programme.weight, strict=True),
            *[(0, None)] * tops.shape[1],
        ]
        best = linprog(cost, less, np.zeros(2 * count), matrix, programme.right[row], bounds, method="highs-ipm")
        share = np.abs(found.value[row] / programme.weight)
        own = np.max(share) if np.isinf(p) else np.sum(share)
        assert own == pytest.approx(best.fun, rel=1e-7)


def test_ties_go_to_the_smallest_sum_of_squares():
    # two equal muscles: any division has the same sum, and the third one sets the largest share
    matrix = np.array([[[50.0, 50.0, 0.0], [0.0, 0.0, 40.0]]])
    programme = Programme(matrix, np.array([[30.0, 36.0]]), np.zeros((1, 3)), np.ones((1, 3)), np.ones(3))
    for p in (1.0, np.inf):
        np.testing.assert_allclose(share_loads(programme, p).value, [[0.3, 0.3, 0.9]], atol=1e-12)


def test_a_programme_without_solution_has_the_smallest_supplement_that_gives_it_one():
    programme = problems()
    right = programme.right.copy()
    right[3] *= 20.0
    beyond = Programme(programme.matrix, right, programme.low, programme.high, programme.weight)
    found = share_loads(beyond, 2.0)
    assert np.flatnonzero(~np.isfinite(found.certificate)).tolist() == [3]
    supplement = smallest_supplement(beyond)
    assert np.flatnonzero(np.max(np.abs(supplement), axis=1) > 1e-6).tolist() == [3]
    for share, is_solved in ((1.0 + 1e-9, True), (0.99, False)):
        less = Programme(beyond.matrix, right - share * supplement, beyond.low, beyond.high, beyond.weight)
        assert np.isfinite(share_loads(less, 2.0).certificate[3]) == is_solved
