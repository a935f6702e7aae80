"""Gradients of random mechanisms with respect to parameters of all kinds, against differences of whole runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import count as count_from
from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_gradients.differentiated_run import Needs, differentiated_run
from mbdkit_gradients.gradient_parameters import resolved
from mbdkit_gradients.prepared_derivatives import prepared_derivatives
from tests.engine.strategies import Drawn, mechanisms
from tests.margins import assert_within

METHODS = ({"name": "gauss", "stages": 2}, {"name": "rk4"}, {"name": "radau-iia", "stages": 2})

PLACES = np.array([1.0, 2.0, 3.0])
WEIGHTS = np.array([3.0, -0.6, 1.0 / 15.0])
"""Weights of central differences at 1, 2 and 3 distances, of order 6, over their distance."""

STEP = 5e-4
"""Distance as a share of the parameter."""

MOST = 5
"""Parameters of a mechanism that are compared in the study; which ones differs between mechanisms."""


def numbers(data: Any, path: Path = ()) -> Iterator[Path]:
    """Yield the key paths of all numbers."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from numbers(value, (*path, key))
    elif isinstance(data, float):
        yield path


def run_spec(drawn: Drawn, method: dict[str, Any]) -> RunSpec:
    time = {"start": drawn.start, "end": drawn.start + 0.15, "step": 0.025}
    return load_spec(drawn.mechanism, (), integrator=method, time=time)


Groups = list[np.ndarray]
"""Numbers of the last state: positions, velocities, accelerations, reactions, energies."""


def groups_of_run(spec: RunSpec) -> Groups:
    run = mbdkit.run(spec)
    run.check()
    paths = ("trajectory/position", "trajectory/velocity", "trajectory/acceleration")
    motion = [run.array(path)[-1].ravel() for path in paths]
    reactions = [run.array(f"joints/{name}")[-1].ravel() for name in ("reaction_force", "reaction_torque")]
    energy = [run.array(f"energy/{name}")[-1:] for name in ("kinetic", "potential", "work", "dissipated")]
    return [*motion, np.concatenate(reactions), np.concatenate(energy)]


def groups_of_gradient(spec: RunSpec, names: list[str]) -> tuple[Groups, Groups]:
    """Return the same from the differentiated run, and the derivatives (..., K)."""
    parameters = resolved(spec, names)
    seeds = prepared_derivatives(spec, parameters).seeds
    rows = differentiated_run(spec, seeds, Needs()).rows
    assert rows.work.size
    force, torque = rows.reactions[-1, :, :2], rows.reactions[-1, :, 2]
    joined = [
        rows.q[-1, :-3], rows.v[-1, :-3], rows.observed.acc[-1, :-3],
        np.concatenate([force.reshape(2 * len(force), force.shape[-1]), torque]),
        np.stack([rows.observed.kinetic[-1], rows.observed.potential[-1], rows.work[-1], rows.dissipated[-1]]),
    ]  # fmt: skip
    return [x[:, 0] for x in joined], [x[:, 1:] for x in joined]


def differentiable(spec: RunSpec, data: Any, path: Path) -> bool:
    """Return whether a number is a parameter on whose both sides the spec is valid."""
    value = value_at(data, path)
    if value == 0.0 and path[-1] in ("damping", "stiffness", "free_length"):
        return False
    try:
        prepared_derivatives(spec, resolved(spec, [".".join(map(str, path))]))
    except SpecError:  # such as the angle of a point mass, or the time of a knot
        return False
    return True


def compare(drawn: Drawn, index: int, most: int) -> None:
    """Compare gradients with differences of runs."""
    spec = run_spec(drawn, METHODS[index % len(METHODS)])
    data = json.loads(spec.canonical_json())
    every = [path for path in numbers(data["model"], ("model",)) if "assembly" not in path]
    order = np.random.default_rng(index).permutation(len(every))
    used = list(islice((every[place] for place in order if differentiable(spec, data, every[place])), most))
    values, slopes = groups_of_gradient(spec, [".".join(map(str, path)) for path in used])
    specs = VariedSpecs(spec.canonical_json())
    scales = np.array([abs(value_at(data, path)) or 0.1 for path in used])
    expected = [np.zeros_like(x) for x in slopes]
    for k, path in enumerate(used):
        value, step = value_at(data, path), STEP * scales[k]
        for place, weight in zip(PLACES, WEIGHTS, strict=True):
            above, below = (groups_of_run(specs.spec([(path, value + sign * place * step)])) for sign in (1.0, -1.0))
            for group, x, y in zip(expected, above, below, strict=True):
                group[:, k] += weight * (x - y) / (4.0 * step)
    for found, wanted, value in zip(slopes, expected, values, strict=True):
        if not len(found):
            continue
        largest = max(float(np.max(np.abs(wanted) * scales)), float(np.max(np.abs(value))), 1e-3)
        error = np.abs(found - wanted) * scales / largest
        assert_within(error, 1e-8, (spec.integrator_item.name, used, error, found * scales, largest))


def value_at(data: Any, path: Path) -> float:
    for part in path:
        data = data[part]
    return float(data)


def compare_batch(batch: int, count: int, most: int = MOST) -> None:
    """Compare the gradients of a batch of random mechanisms."""
    indices = count_from(1000 * batch)
    chosen = settings(
        max_examples=count, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    seed(batch)(chosen(given(mechanisms())(lambda drawn: compare(drawn, next(indices), most))))()


@pytest.mark.slow
def test_gradients_of_random_mechanisms_agree_with_differences_of_runs() -> None:
    # expected: differences of order 6 of whole runs
    compare_batch(0, 2, most=3)


@pytest.mark.slow
@pytest.mark.parametrize("batch", range(1, 9))
def test_gradients_of_a_hundred_random_mechanisms(batch: int) -> None:
    compare_batch(batch, 13)
