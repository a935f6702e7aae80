"""Limits of profiles by lmfit's `conf_interval` and by pyPESTO, of the same residuals.

Both take unknowns in standard deviations, because their resolution is relative to the values.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from mbdkit_identify.estimation import Fit, covariance_of
from mbdkit_identify.problem import Problem

Limits = np.ndarray
"""(L, 2) lower and upper limits of one unknown, by level."""
PLACE = 10.0
"""Value of the best fit in lmfit, whose resolution is 5e-5 of the value."""
STEP = 0.1
"""Distance of the points of pyPESTO's profiles, between which it interpolates linearly, in standard deviations."""


def lmfit_limits(problem: Problem, fit: Fit, places: Sequence[int], levels: Sequence[float]) -> list[Limits]:
    """Return the limits of some unknowns by the test of Fisher."""
    import lmfit

    size = np.sqrt(np.diagonal(covariance_of(fit.jacobian, fit.free)))
    start = lmfit.Parameters()
    for k in range(len(size)):
        start.add(f"p{k}", value=PLACE)

    def x(given: lmfit.Parameters) -> np.ndarray:
        return np.asarray(fit.x + size * (np.array([one.value for one in given.values()]) - PLACE))

    def residuals(given: lmfit.Parameters) -> np.ndarray:
        return problem.residuals(x(given))

    def jacobian(given: lmfit.Parameters) -> np.ndarray:
        return (problem.jacobian(x(given)) * size)[:, [one.vary for one in given.values()]]

    minimizer = lmfit.Minimizer(residuals, start, Dfun=jacobian, xtol=1e-10, ftol=1e-12)
    found = minimizer.leastsq()
    names = [f"p{place}" for place in places]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        intervals = lmfit.conf_interval(minimizer, found, p_names=names, sigmas=[*levels])
    sides = [np.array([value for _, value in intervals[name]]) for name in names]
    count = len(levels)
    return [
        fit.x[place] + size[place] * (np.column_stack([z[:count][::-1], z[count + 1 :]]) - PLACE)
        for place, z in zip(places, sides, strict=True)
    ]


def pypesto_limits(
    problem: Problem, fit: Fit, places: Sequence[int], levels: Sequence[float], threshold: Callable[[float], float]
) -> list[Limits]:
    """Return the limits of some unknowns where the sum of squares has increased by the `threshold` of each level."""
    import logging

    import pypesto
    import pypesto.optimize
    import pypesto.profile

    logging.getLogger("pypesto").setLevel(logging.ERROR)
    size = np.sqrt(np.diagonal(covariance_of(fit.jacobian, fit.free)))

    def residuals(z: np.ndarray) -> np.ndarray:
        return problem.residuals(fit.x + size * z)

    def jacobian(z: np.ndarray) -> np.ndarray:
        return problem.jacobian(fit.x + size * z) * size

    objective = pypesto.Objective(
        fun=lambda z: 0.5 * float(residuals(z) @ residuals(z)),
        grad=lambda z: jacobian(z).T @ residuals(z),
        res=residuals,
        sres=jacobian,
    )
    wide = 20.0 * np.ones(len(size))
    other = pypesto.Problem(objective, lb=-wide, ub=wide, x_guesses=[np.zeros(len(size))])
    optimizer = pypesto.optimize.ScipyOptimizer("ls_trf", tol=1e-12)
    found = pypesto.optimize.minimize(other, optimizer, n_starts=1, progress_bar=False)
    most = threshold(max(levels))
    options = pypesto.profile.ProfileOptions(
        default_step_size_absolute=STEP,
        min_step_size_absolute=STEP,
        max_step_size_absolute=STEP,
        default_step_size_relative=0.0,
        min_step_size_relative=0.0,
        max_step_size_relative=0.0,
        ratio_min=0.9 * float(np.exp(-most / 2)),
        step_size_precheck_mode="off",
    )
    found = pypesto.profile.parameter_profile(
        other, found, optimizer, profile_index=np.array(places), profile_options=options, progress_bar=False
    )
    limits = []
    for place in places:
        profile = found.profile_result.list[0][place]
        z, ratio = profile.x_path[place], profile.ratio_path
        some = [
            pypesto.profile.calculate_approximate_ci(z, ratio, float(np.exp(-threshold(level) / 2))) for level in levels
        ]
        limits.append(fit.x[place] + size[place] * np.array(some))
    return limits
