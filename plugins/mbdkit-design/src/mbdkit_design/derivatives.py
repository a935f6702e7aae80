"""Derivatives of goals and limits of designs with respect to the variables.

They are exact if the gradients of all scenarios can be computed; otherwise, they are differences of runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import path_text
from mbdkit.base.text import counted, told_apart
from mbdkit_gradients import Gradient, resolved
from mbdkit_gradients.differentiated_expressions import definitions_of
from mbdkit_gradients.gradient_check import GradientCheck, inaccurate_entries

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbdkit_design.evaluation import Evaluator

#: Largest error of a derivative that is not reported, times the distance between the bounds, as a share of the goal.
UNREPORTED = 1e-2
STEP = 1e-4  #: Step of central differences, as a share of the bounds.


def derivatives(evaluator: Evaluator, x: np.ndarray) -> np.ndarray:
    """Return the derivatives (S, K, n) of K goals and limits in S scenarios with respect to the n scaled variables.

    The derivatives at a point `x` (n,) are exact unless a scenario has no gradients (see `Evaluator.why_differences`),
    or a run fails at this point.
    """
    if evaluator.why_differences or np.any(np.isnan(evaluator.values(x[None]))):
        return differences(evaluator, x)
    try:
        jacobians = np.array([gradient.jacobian for gradient in gradients(evaluator, x, check=False)])
    except MbdkitError as error:
        evaluator.why_differences = str(error).rstrip(".")
        return differences(evaluator, x)
    evaluator.gradients += 1
    return np.asarray(jacobians * evaluator.widths)


def differences(evaluator: Evaluator, x: np.ndarray, places: Sequence[int] | None = None) -> np.ndarray:
    """Return derivatives (S, K, n) by central differences, or by one-sided differences at a bound; those with respect
    to the variables at some `places` only, if they are given.
    """
    some = slice(None) if places is None else list(places)
    low, high = np.maximum(x - STEP, 0.0), np.minimum(x + STEP, 1.0)
    sides = [np.where(np.eye(len(x), dtype=bool)[some], side, x) for side in (low, high)]
    below, above = np.split(evaluator.values(np.concatenate(sides)), 2)
    return np.asarray(np.moveaxis((above - below) / (high - low)[some, None, None], 0, -1))


def checked(evaluator: Evaluator, x: np.ndarray) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return sentences about derivatives of goals and limits at a point that fail their check: those that differences
    of runs do not confirm, and those that are confirmed, but have a discretization error that matters.

    A frequent cause of the first is a one-sided force law that begins to act exactly at a frame of a measured motion.
    """
    if evaluator.why_differences:
        return (), ()
    try:
        every = gradients(evaluator, x, check=True)
    except MbdkitError:
        return (), ()
    failed = [
        (one.check, m) for one in every if one.check is not None for m in np.flatnonzero(~one.check.agrees).tolist()
    ]
    value = np.max(np.abs([one.value for one in every]), axis=0)
    unconfirmed = tuple(_disagreement(check, m) for check, m in failed if not check.is_like_steps[m])
    matters = (
        (check, m)
        for check, m in failed
        if check.is_like_steps[m] and np.max(check.entry_error[m] * evaluator.widths) > UNREPORTED * value[m]
    )
    return unconfirmed, tuple(f"At the best point, {inaccurate_entries(check, m)}." for check, m in matters)


def _disagreement(check: GradientCheck, m: int) -> str:
    """Return a sentence that says that differences do not confirm the derivative of a goal or limit."""
    name = check.names[m]
    exact, by_differences = told_apart(check.derivative[m], check.extrapolated[m], 4)
    return (
        f"The derivative of {name} at the best point is not confirmed by differences, {exact} and {by_differences} in "
        f"a random direction: {name} may not be smooth there."
    )


def gradients(evaluator: Evaluator, x: np.ndarray, *, check: bool) -> list[Gradient]:
    """Return the gradients of goals and limits with respect to the variables at a point (n,), for each scenario.

    Parameters
    ----------
    check
        Whether the gradients are checked by differences of runs.

    Raises
    ------
    MbdkitError
        If a scenario has no gradients.
    """
    settings, results = evaluator.settings(x), []
    for scenario in evaluator.scenarios:
        spec = scenario.at(settings)
        parameters = resolved(spec, [path_text(path) for path, _ in settings])
        definitions = definitions_of(spec, [measure.name for measure in spec.defined_measures()])
        with one_thread_of_linear_algebra():
            differentiate = spec.spec_kind.differentiate
            assert differentiate is not None
            results.append(cast("Callable[..., Gradient]", differentiate())(spec, definitions, parameters, check=check))
    return results


def derivatives_sentence(evaluator: Evaluator) -> str:
    """Return a sentence that says how the derivatives were computed; empty if none were needed."""
    if evaluator.why_differences:
        return f"Derivatives are differences of runs: {evaluator.why_differences}."
    return f"Derivatives are exact, computed at {counted(evaluator.gradients, 'point')}." if evaluator.gradients else ""
