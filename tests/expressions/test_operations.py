"""What follows from the table of operations agrees: derivatives as programs, jets, and values of numbers and arrays."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.expressions.jets import jet_and_switches
from mbdkit.expressions.operations import OPERATIONS, Operation
from mbdkit.expressions.program import Program, derivative_of

TIMES = np.array([0.15, 0.4, 0.83])


def program_of(operation: Operation) -> Program:
    """The operation on t/2, and on 1 + t^2."""
    half: Program = (("const", 0.5), ("t", 0.0), ("mul", 0.0))
    above: Program = (("const", 1.0), ("t", 0.0), ("powi", 2.0), ("add", 0.0))
    operands = (half, above)[: operation.arity]
    return (*(instruction for one in operands for instruction in one), (operation.name, 3.0))


@pytest.mark.parametrize("operation", [one for one in OPERATIONS.values() if not one.switch], ids=lambda one: one.name)
def test_the_derivative_as_a_program_is_the_rate(operation: Operation) -> None:
    program = program_of(operation)
    first = derivative_of(program)
    jet = jet_and_switches(program, TIMES)[0]
    np.testing.assert_allclose(jet_and_switches(first, TIMES)[0].value, jet.rate, rtol=1e-13)
    np.testing.assert_allclose(jet_and_switches(first, TIMES)[0].rate, jet.acceleration, rtol=1e-12)
    np.testing.assert_allclose(jet_and_switches(derivative_of(first), TIMES)[0].value, jet.acceleration, rtol=1e-12)


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=lambda one: one.name)
def test_numbers_arrays_and_jets_have_the_same_values(operation: Operation) -> None:
    jet = jet_and_switches(program_of(operation), TIMES)[0]
    own = (3,) if operation.name == "powi" else ()
    operands = (0.5 * TIMES, 1.0 + TIMES**2)[: operation.arity]
    np.testing.assert_allclose(operation.array(*operands, *own), jet.value, rtol=1e-15)
    numbers = [operation.number(*map(float, row), *own) for row in zip(*operands, strict=True)]
    np.testing.assert_allclose(numbers, jet.value, rtol=1e-15)
