"""Problems with published results: three tolerances or steps, whose errors fall to the published digits and below."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_paper.methods.problems import Problem, problems
from mbdkit_paper.textbook_four_bar import textbook_equations
from tests.slow_cases import slow
from tests.witness import ode, published

PROBLEMS = problems()


def particle_four_bar(end: float) -> dict[str, float]:
    """Return the angle of the first link at `end` [s], by the textbook's equations."""
    return {"angle": ode.dop853(textbook_equations.rates, textbook_equations.start(), np.array([end]))[-1][0]}


WITNESSES = [
    ("andrews", published.andrews, (-0.0617138900142764496358948458001, 0.03)),
    ("pendulum", published.point_pendulum, (-1.0, 10.0)),
    ("pendulum-2000", published.point_pendulum, (1.0, 2000.0)),
    ("windows-2", published.windows, (2, 10.0)),
    ("windows-40", published.windows, (40, 20.0)),
    ("light-cart-pole", published.light_cart_pole, (10.0,)),
    ("floating-slider-crank", published.floating_slider_crank, (0.3,)),
    ("spring-slider-crank", published.spring_slider_crank, (1.0,)),
    *slow(
        ("andrews-iftomm", published.andrews, (-0.062, 0.05)),
        ("particle-four-bar", particle_four_bar, (30.0,)),
    ),
]


@pytest.mark.parametrize(("name", "solve", "arguments"), WITNESSES)
def test_references_are_those_of_a_code_without_constraints(name: str, solve: Any, arguments: tuple[Any, ...]) -> None:
    # expected: quadrature, elliptic functions, or DOP853 with rtol 1e-13 in minimal coordinates; at the end of the
    # slider-crank with a spring, the rate has 86 times the error of the angle at the start: up to 1.1e-10 on
    # four processors
    found = solve(*arguments)
    close = 4e-10 if name == "spring-slider-crank" else 2e-11
    for key, quantity in PROBLEMS[name].quantities.items():
        if key in found:
            assert found[key] == pytest.approx(quantity.reference, rel=close, abs=close), key


@pytest.mark.parametrize("name", PROBLEMS)
def test_published_results_are_as_accurate_as_the_table_says_and_not_much_more(name: str) -> None:
    for quantity in PROBLEMS[name].quantities.values():
        if quantity.published is None:
            continue
        error = abs(quantity.published - quantity.reference)
        assert error <= quantity.published_error
        if error > 0:  # where the references are not those of the source
            assert error > 0.8 * quantity.published_error


@pytest.mark.parametrize("time", [0.7, 4.0])
def test_hinged_beam_accelerates_as_in_its_source(time: float) -> None:
    # expected: the equations of Hairer and Wanner, whose links have no mass between point masses
    n = 40
    equations = mbdkit.EquationsOfMotion.of(load_spec("hinged-beam").mechanism())
    angle, rate = np.random.default_rng(0).normal(0.0, 0.3, (2, n))
    along = np.column_stack([np.cos(angle), np.sin(angle)]) / n
    across = np.column_stack([-along[:, 1], along[:, 0]]) * rate[:, None]
    q, v = (
        np.column_stack([np.cumsum(step, axis=0) - step / 2, turn]) for step, turn in ((along, angle), (across, rate))
    )
    a, _ = equations.accelerations(time, q.ravel(), v.ravel())
    expected = published.hinged_beam_accelerations(time, angle, rate)
    np.testing.assert_allclose(a.reshape(n, 3)[:, 2], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def explicit(*tolerances: float) -> list[dict[str, Any]]:
    integrator = {"name": "dop853", "adaptive": True}
    return [{"integrator": integrator | {"rtol": rtol}, "stabilization": "projection"} for rtol in tolerances]


def radau(*tolerances: float) -> list[dict[str, Any]]:
    integrator = {"name": "radau-iia", "stages": 3, "adaptive": True}
    return [{"integrator": integrator | {"rtol": rtol}, "formulation": "ggl"} for rtol in tolerances]


def gauss(stages: int, *steps: float) -> list[dict[str, Any]]:
    return [{"integrator": {"name": "gauss", "stages": stages}, "step": step} for step in steps]


RADAU_5 = [{"integrator": {"name": "radau-iia", "stages": 5}, "step": step} for step in (0.02, 0.005, 0.00125)]
"""Quarters of steps, because Radau IIA does not resolve the fast oscillations of the beam."""

CASES = [
    ("andrews", "dop853", explicit(1e-6, 1e-8, 1e-10), 1e-11),
    ("andrews", "radau-ggl", radau(1e-5, 1e-7, 1e-9), 1e-8),
    ("andrews", "gauss3", gauss(3, 1e-4, 5e-5, 2.5e-5), 2e-13),
    ("andrews-iftomm", "gauss3", gauss(3, 1e-4, 5e-5, 2.5e-5), 1e-12),
    ("pendulum", "dop853", explicit(1e-6, 1e-8, 1e-10), 2e-9),
    ("pendulum", "gauss3", gauss(3, 0.05, 0.025, 0.0125), 1e-10),
    ("windows-2", "gauss2", gauss(2, 0.01, 0.005, 0.0025), 1e-9),
    ("light-cart-pole", "dop853", explicit(1e-6, 1e-8, 1e-10), 2e-9),
    ("floating-slider-crank", "dop853", explicit(1e-6, 1e-8, 1e-10), 1e-12),
    ("floating-slider-crank", "gauss3", gauss(3, 0.01, 0.005, 0.0025), 1e-10),
    ("spring-slider-crank", "dop853", explicit(1e-6, 1e-9, 1e-12), 1e-9),
    ("spring-slider-crank", "gauss3", gauss(3, 0.005, 0.0025, 0.00125), 1e-8),
    ("car-axis", "dop853", explicit(1e-6, 1e-8, 1e-10), 1e-10),
    ("car-axis", "gauss3", gauss(3, 0.02, 0.01, 0.005), 1e-9),
    ("particle-four-bar", "dop853", explicit(1e-6, 1e-8, 1e-10), 1e-7),
    ("particle-four-bar", "gauss3", gauss(3, 0.05, 0.025, 0.0125), 1e-9),
    *slow(
        ("pendulum-2000", "dop853", explicit(1e-9, 1e-11, 1e-13), 2e-8),
        ("pendulum-2000", "gauss3", gauss(3, 0.05, 0.025, 0.0125), 1e-6),
        ("windows-40", "gauss2", gauss(2, 0.01, 0.005, 0.0025), 1e-9),
        ("hinged-beam", "radau5", RADAU_5, 1e-8),
    ),
]


def error(problem: Problem, sections: dict[str, Any]) -> float:
    """Return the largest error of the results of a run, relative to their sizes if these exceed 1."""
    run = mbdkit.run(problem.spec(**sections, output={"every": 10**6}, limits={"max_steps": 10**7})).check()
    sizes = {key: max(1.0, abs(quantity.reference)) for key, quantity in problem.quantities.items()}
    return max(found / sizes[key] for key, found in problem.errors(run).items())


@pytest.mark.parametrize(("name", "method", "settings", "reached"), CASES)
def test_errors_fall_with_the_tolerance_to_the_digits(
    name: str, method: str, settings: list[dict[str, Any]], reached: float
) -> None:
    # expected: the references; a hundredth of the tolerance or half of the step makes errors at least 8 times smaller
    errors = [error(PROBLEMS[name], sections) for sections in settings]
    assert all(after < before / 8 for before, after in pairwise(errors)), errors
    assert errors[-1] < reached


@pytest.mark.slow
def test_hinged_beam_reaches_all_published_digits() -> None:
    # expected: the Test Set for IVP Solvers
    sections = explicit(1e-13)[0] | {"formulation": "joint-coordinates", "stabilization": "none"}
    run = mbdkit.run(PROBLEMS["hinged-beam"].spec(**sections, output={"every": 10**6})).check()
    for key, quantity in PROBLEMS["hinged-beam"].quantities.items():
        assert run.measures[key] == pytest.approx(quantity.published, rel=0.0, abs=quantity.published_error), key
