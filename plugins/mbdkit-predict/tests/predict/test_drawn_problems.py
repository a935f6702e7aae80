"""Drawn predictions with pulses, steps, contacts, tables, jumps and several local optima, beside the optima of
independent methods.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

import mbdkit
from predict import drawn_jumps, several_optima
from predict.drawn_problems import COUNT, drawn_problem, outcome


@pytest.mark.parametrize("number", range(4))
def test_the_witness_has_the_closed_form_of_a_disturbed_block(number: int) -> None:
    # the control reaches what the disturbance misses: a distance x and a velocity v from rest
    problem = drawn_problem(number)
    end, mass = problem.times[-1], problem.spec["base"]["model"]["bodies"]["block"]["mass"]
    points, weights = np.polynomial.legendre.leggauss(60)
    x, v = 1.0, 0.0
    for begin, stop in pairwise(problem.times):
        for t, weight in zip(
            0.5 * (begin + stop + (stop - begin) * points), 0.5 * (stop - begin) * weights, strict=True
        ):
            rate = problem.rates(np.zeros((2, 1)), np.zeros(1), t, 1.0)[1, 0]
            x, v = x - weight * (end - t) * rate, v - weight * rate
    exact = mass**2 * (12.0 * x**2 / end**3 - 12.0 * x * v / end**2 + 4.0 * v**2 / end)
    assert problem.optimum() == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("number", [1, 10, 18, 20, 21, 23])
def test_some_drawn_problems_are_right(number: int) -> None:
    own = outcome(drawn_problem(number))
    assert own.word == "right", own


@pytest.mark.slow
def test_no_drawn_problem_is_wrong_without_a_word() -> None:
    words = Counter(outcome(drawn_problem(number)).word for number in range(COUNT))
    assert set(words) <= {"right", "told", "told wrongly"}
    assert words["told wrongly"] <= 3


@pytest.mark.parametrize("number", [4, 5, 8, 11, 14])
def test_some_drawn_jumps_are_right(number: int) -> None:
    problem = drawn_jumps.drawn_jump(number)
    run = mbdkit.predict(problem.spec)
    assert drawn_jumps.word_of(run, problem.optimum) == "right", (run.objective, problem.optimum, run.verdict_reasons)


@pytest.mark.slow
def test_no_drawn_jump_is_wrong_without_a_word() -> None:
    problems = map(drawn_jumps.drawn_jump, range(drawn_jumps.COUNT))
    words = Counter(drawn_jumps.word_of(mbdkit.predict(x.spec), x.optimum) for x in problems)
    assert set(words) <= {"right", "told"}
    assert words["right"] >= 18


@pytest.mark.slow
def test_several_starts_find_the_best_of_several_local_optima() -> None:
    problems = map(several_optima.several, several_optima.NUMBERS)
    words = Counter(several_optima.word_of(mbdkit.predict(x.spec), x.optima()) for x in problems)
    assert set(words) <= {"right", "told"}
    assert words["right"] >= 18
