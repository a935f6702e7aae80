"""The passive muscle follows Thelen's curve, stores what it is stretched with, and only its damper takes energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy

import mbdkit
from mbdkit_muscle import passive_muscle

F0, L0, E0, K = 1000.0, 0.1, 0.6, 5.0


def force(lengths: Any, rate: float = 0.0) -> np.ndarray:
    law = passive_muscle()
    assert isinstance(law.force, sympy.Expr)
    values = {"max_force": F0, "optimal_length": L0, "tendon_length": 0.2, "strain": E0, "shape": K, "damping": 0.1}
    given = {s: values[s.name] for s in law.force.free_symbols if s.name in values}
    length, speed = sympy.symbols("length rate", real=True)
    return np.array([float(law.force.subs(given).subs({length: x, speed: rate})) for x in np.atleast_1d(lengths)])


def hanging(**options: Any) -> mbdkit.Run:
    """Return one second of a mass of 2 kg on a muscle, let go where it is slack."""
    law = {"type": "law", "law": "passive-muscle", "max_force": 100.0, "optimal_length": 0.1}
    pathway = {"type": "two-points", "bodies": ["ground", "load"], "points": [[0, 0], [0, 0]]}
    model = {
        "name": "mechanism",
        "bodies": {"load": {"mass": 2.0, "position": [0.0, -0.09]}},
        "forces": {"muscle": law | {"pathway": pathway} | options},
    }
    integrator, time = {"name": "gauss", "stages": 2}, {"end": 1.0, "step": 0.0005}
    return mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time})


def test_the_curve_is_that_of_thelen() -> None:
    # expected: F/F0 = (exp(k (l/l0 - 1)/e0) - 1)/(exp(k) - 1), Thelen (2003)
    stretch = np.linspace(0.01, E0, 30)
    expected = F0 * np.expm1(K * stretch / E0) / np.expm1(K)
    np.testing.assert_allclose(force(0.2 + L0 * (1 + stretch)), expected, rtol=1e-12)


def test_it_is_slack_up_to_its_optimal_length_and_has_its_maximal_force_at_its_strain() -> None:
    assert force([0.0, 0.25, 0.3]).tolist() == [0.0, 0.0, 0.0]
    assert force(0.2 + L0 * (1 + E0)) == pytest.approx(F0)


def test_beyond_the_maximal_force_it_goes_on_straight_and_without_a_corner() -> None:
    end, h = 0.2 + L0 * (1 + E0), 1e-6
    before, here, after, far = force([end - h, end, end + h, end + 2 * h])
    assert (after - here) / h == pytest.approx((here - before) / h, rel=1e-3)
    assert far - after == pytest.approx(after - here, rel=1e-6)


def test_the_damper_has_a_tenth_of_the_maximal_force_at_ten_lengths_a_second() -> None:
    # expected: Millard et al. (2013), a normalised damping of 0.1
    assert force(0.25, rate=10 * L0) == pytest.approx(0.1 * F0)


def test_without_damping_a_load_keeps_its_energy() -> None:
    run = hanging(damping=0.0).check()
    total = run.energy.total
    assert np.abs(total - total[0]).max() < 1e-5 * run.energy.kinetic.max()
    assert np.ptp(run["load"].position[:, 1]) > 0.05


def test_with_damping_the_balance_closes_and_energy_is_only_lost() -> None:
    run = hanging().check()
    assert np.abs(run.energy.balance).max() < 1e-5 * run.energy.kinetic.max()
    assert np.all(np.diff(run.energy.dissipated) >= 0)
    assert run.energy.dissipated[-1] > 0.01


@pytest.mark.parametrize("wrong", [{"max_force": 0.0}, {"strain": -0.1}, {"shape": 1e3}])
def test_wrong_options_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(mbdkit.SpecError, match=next(iter(wrong))):
        hanging(**wrong)
