"""The Lobatto methods have the claimed properties, and run like the built-in methods."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_lobatto import mbdkit_integrators
from mbdkit_lobatto.tableaus import tableau

ITEMS = {item.name[-1]: item for item in mbdkit_integrators()}
METHODS = [(kind, s) for kind in "abcd" for s in range(3 if kind == "b" else 2, 6)]
every_method = pytest.mark.parametrize(("kind", "s"), METHODS)
FORCED = {
    "name": "mechanism",
    "bodies": {
        "a": {"mass": 1.0, "inertia": 0.0833, "position": [0.5, 0.0]},
        "b": {"mass": 0.7, "inertia": 0.05, "position": [1.4, 0.0]},
    },
    "joints": {
        "A": {"type": "revolute", "bodies": ["ground", "a"], "points": [[0, 0], [-0.5, 0]]},
        "B": {"type": "revolute", "bodies": ["a", "b"], "points": [[0.5, 0], [-0.4, 0]]},
    },
    "forces": {"t": {"type": "torque", "body": "b", "value": "0.3*cos(3*t)"}},
}


@every_method
def test_what_is_claimed_is_what_the_tableau_is(kind: str, s: int) -> None:
    item = ITEMS[kind]
    claims, t = item.claims(item.options(stages=s)), tableau(kind, s)
    assert claims.order == t.order == 2 * s - 2
    assert claims.symmetric == t.is_symmetric
    assert claims.symplectic == claims.quadratic_invariants == t.is_symplectic
    t.check_trees(t.order)
    with pytest.raises(mbdkit.MbdkitError, match=f"order {t.order + 1}"):
        t.check_trees(t.order + 1)


def test_three_stages_are_those_of_the_book() -> None:
    # expected: Hairer and Wanner, Solving ODEs II, tables IV.5.7, 5.8 and 5.10
    book = {
        "a": [[0, 0, 0], [5 / 24, 1 / 3, -1 / 24], [1 / 6, 2 / 3, 1 / 6]],
        "b": [[1 / 6, -1 / 6, 0], [1 / 6, 1 / 3, 0], [1 / 6, 5 / 6, 0]],
        "c": [[1 / 6, -1 / 3, 1 / 6], [1 / 6, 5 / 12, -1 / 12], [1 / 6, 2 / 3, 1 / 6]],
    }
    for kind, there in book.items():
        np.testing.assert_allclose(tableau(kind, 3).floats()[0], there, rtol=0, atol=1e-16)


@pytest.mark.parametrize("s", range(2, 7))
def test_iiic_damps_infinitely_stiff_parts_away(s: int) -> None:
    # expected: R(infinity) = 1 - b^T A^-1 1 = 0
    a, b, _ = tableau("c", s).floats()
    assert 1 - b @ np.linalg.solve(a, np.ones(s)) == pytest.approx(0.0, abs=1e-12)


def end_of(integrator: dict[str, Any], step: float) -> np.ndarray:
    spec = {"mbdkit": 1, "model": FORCED, "integrator": integrator, "time": {"end": 0.5, "step": step}}
    run = mbdkit.run(spec).check()
    return np.concatenate([run.array("trajectory/position")[-1], run.array("trajectory/velocity")[-1]]).ravel()


@cache
def reference() -> np.ndarray:
    """Return the state at the end of the forced motion, computed by Gauss-6."""
    return end_of({"name": "gauss", "stages": 6}, 0.01)


@pytest.mark.parametrize(("kind", "s"), [x for x in METHODS if x[1] <= 4])
def test_the_order_on_a_forced_double_pendulum(kind: str, s: int) -> None:
    steps = {2: (1 / 640, 1 / 1280), 3: (1 / 160, 1 / 320), 4: (1 / 80, 1 / 160)}[s]
    errors = [np.abs(end_of({"name": f"lobatto-iii{kind}", "stages": s}, h) - reference()).max() for h in steps]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * s - 2, abs=0.2), errors


def test_two_stages_of_iiib_are_refused() -> None:
    with pytest.raises(mbdkit.SpecError, match="stages"):
        end_of({"name": "lobatto-iiib", "stages": 2}, 0.1)


def test_a_study_of_methods_takes_them() -> None:
    # expected: order 2 s - 2
    spec: dict[str, Any] = {
        "mbdkit_study": 1,
        "base": {"model": FORCED, "time": {"end": 1.0, "step": 0.01}},
        "axes": [{"integrator": [{"name": "rk4"}]}, {"time.step": [1 / 160, 1 / 320]}],
        "reference": {"integrator": {"name": "gauss", "stages": 6}, "time.step": 1 / 160},
    }
    study = mbdkit.study(spec, with_=[{"name": "lobatto-iiic", "stages": 2}, "{name: lobatto-iiid, stages: 3}"])
    for label, order in (("lobatto-iiic, stages 2", 2), ("lobatto-iiid, stages 3", 4)):
        errors = [point.values["end_error"] for point in study.points if point.axes["integrator"] == label]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)
