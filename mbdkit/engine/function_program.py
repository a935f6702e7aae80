"""Programs of functions: the integers that the register machine executes (`mbdkit.engine.kernels.law_programs`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.engine.kernels.law_programs import OPCODES, REGISTERS
from mbdkit.expressions.recorded import UFUNCS, Recorded, Recorder, Term

#: Numbers of operands that are values; operations that cannot be recorded have at most two.
_VALUES = {"select": 3, "power_of_integer": 1, "table": 1} | {
    name: function.nin for function, name in UFUNCS.items() if name in OPCODES
}


class Assembler:
    """Collects the instructions of a program.

    Operations stay in their order; equal ones occur once. Registers of intermediate results are reused after their
    last use.

    Parameters
    ----------
    inputs
        Number of inputs, whose values are numbered from 0 on. The results of instructions follow in their order.
        Constants have negative numbers, since their count is not known yet.
    """

    def __init__(self, inputs: int):
        self._inputs = inputs
        self._constants: dict[str, int] = {}
        self._code: dict[tuple[str, tuple[int, ...]], int] = {}
        self._tables: list[float] = []

    def constant(self, number: float) -> int:
        """Return the number of a constant."""
        # by their bits, since 0.0 and -0.0 are different constants
        return self._constants.setdefault(float(number).hex(), -1 - len(self._constants))

    def append(self, name: str, *operands: int) -> int:
        """Append an instruction; return the number of its value."""
        return self._code.setdefault((name, operands), self._inputs + len(self._code))

    def add_table(self, numbers: Sequence[float]) -> int:
        """Append the numbers of a table; return the index of the first one."""
        self._tables += numbers
        return len(self._tables) - len(numbers)

    def block(self, results: Sequence[int]) -> np.ndarray:
        """Return the program with these results as integers for the kernel, some of which are the bits of numbers."""
        places = self._registers(results)
        block = [len(self._code), len(self._constants), len(results), *(places[result] for result in results)]
        for (name, operands), value in self._code.items():
            count = _VALUES.get(name, 2)
            words = [*(places[operand] for operand in operands[:count]), *operands[count:], 0, 0][:3]
            if name == "table":
                words[1] += len(self._constants)
            block += [OPCODES[name], *words, places[value]]
        numbers = np.array([*map(float.fromhex, self._constants), *self._tables], dtype=float)
        return np.concatenate([np.array(block, dtype=np.int64), numbers.view(np.int64)])

    def _registers(self, results: Sequence[int]) -> dict[int, int]:
        """Return the register of each value."""
        fixed = self._inputs
        count = fixed + len(self._constants)
        places = {i: i for i in range(fixed)} | {-1 - i: fixed + i for i in range(len(self._constants))}
        used = [set(operands[: _VALUES.get(name, 2)]) for name, operands in self._code]
        last = {value: i for i, values in enumerate(used) for value in values}
        last |= dict.fromkeys(results, len(used))
        free: list[int] = []
        for i, values in enumerate(used):
            free += sorted(places[value] for value in values if value >= fixed and last[value] == i)
            if free:
                places[fixed + i] = free.pop()
            else:
                places[fixed + i], count = count, count + 1
            if fixed + i not in last:
                free.append(places[fixed + i])
        if count > REGISTERS:
            raise PluginError(f"its values and derivatives need {count} registers, more than {REGISTERS}")
        return places


def block(inputs: Sequence[Recorded], results: Sequence[Recorded | float]) -> np.ndarray:
    """Return the program of recorded results as integers for the kernel.

    Parameters
    ----------
    inputs
        Inputs in the order of the first registers.

    Raises
    ------
    PluginError
        If the results depend on other inputs, or the program needs more than `REGISTERS` registers.
    """
    recorder = inputs[0].recorder
    wanted = [recorder.constant(result) for result in results]
    assembler, tables = Assembler(len(inputs)), dict[int, int]()
    values = {one.index: i for i, one in enumerate(inputs)}
    needed = recorder.ancestors(wanted, values, _computed)
    for index in sorted(needed, key=lambda index: (recorder.terms[index].place, index)):
        values[index] = _assemble(assembler, recorder, recorder.terms[index], values, tables)
    return assembler.block([values[result.index] for result in wanted])


def _computed(term: Term) -> tuple[int, ...]:
    return term.operands[:1] if term.operation == "root" else term.operands


def _assemble(
    assembler: Assembler, recorder: Recorder, term: Term, values: dict[int, int], tables: dict[int, int]
) -> int:
    """Append the instructions of a term; return the number of its value."""
    operands = [values[operand] for operand in _computed(term)]
    match term.operation:
        case "input":
            raise PluginError(f"its value depends on '{term.data}', which is not one of its inputs")
        case "constant":
            return assembler.constant(term.data)
        case "detached" | "root":
            return operands[0]
        case "power_of_integer":
            return assembler.append("power_of_integer", operands[0], term.data)
        case "minimum" | "maximum":
            name = "less_equal" if term.operation == "minimum" else "greater_equal"
            return assembler.append("select", assembler.append(name, *operands), *operands)
        case "table":
            number, order = term.data
            if number not in tables:
                tables[number] = assembler.add_table(recorder.tables[number])
            return assembler.append("table", operands[0], tables[number], order)
    return assembler.append(term.operation, *operands)
