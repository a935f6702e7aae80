"""Derivatives of products of vectors and numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit_gradients.derived_values import DerivedValue, of_operands


@pytest.mark.parametrize("count", [1, 2, 3])
def test_products_of_vectors_and_numbers_pair_their_own_axes(count: int) -> None:
    # expected: the product rule, component by component
    rng = np.random.default_rng(1)
    x, y = (
        DerivedValue(rng.normal(size=(2, 5)), rng.normal(size=(count, 2, 5))),
        DerivedValue(rng.normal(size=5), rng.normal(size=(count, 5))),
    )
    for one, other in ((x, y), (y, x)):
        found = of_operands("mul", 0.0, one, other)
        assert found.value == pytest.approx(x.value * y.value)
        for k in range(count):
            for i in range(2):
                assert found.slope[k, i] == pytest.approx(x.slope[k, i] * y.value + x.value[i] * y.slope[k])
