"""Sampled controllers whose outputs a Python function computes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any

from mbdkit.base.called_functions import Returned
from mbdkit.base.text import listed, one_line, shortened, shown
from mbdkit.engine.compiled_mechanism import SampledController

#: Larger integers, with which `math.isfinite` raises an exception, are no numbers of a run either.
LARGEST = sys.float_info.max


class PythonControllers:
    """Calls the functions of controllers, once for each sample, and keeps what they return.

    All simulations of a run, such as the comparison runs of a check, share this object. They get the outputs of a
    sample that has been taken already, so that the function is not called again.

    `functions`: functions by name of the controller; none for a run that repeats recorded outputs. `returned`: outputs
    that are known, by name of the controller.

    - `returned`: outputs of all samples so far, one list for each controller.
    - `failure`: sentence on the first call that failed, from which on outputs are zero; empty if none has failed.
    - `cause`: the exception that the function raised, if it did.
    """

    def __init__(self, functions: Mapping[str, Callable[..., Any]], returned: Returned):
        self._functions = functions
        self.returned = {name: [tuple(values) for values in samples] for name, samples in returned.items()}
        self.failure = ""
        self.cause: BaseException | None = None

    def stop_calling(self) -> None:
        """From now on, only repeat outputs."""
        self._functions = {}

    def outputs(self, controller: SampledController, number: int, t: float, values: Mapping[str, float]) -> list[float]:
        """Return the outputs of a controller in their order.

        `number`: number of the sample, from 0. `t`: its time [s]. `values`: its quantities by name.
        """
        known, names = self.returned.setdefault(controller.name, []), controller.output_names
        if number < len(known) and len(known[number]) == len(names):
            return list(known[number])
        if not self.failure:
            where = f"controller '{controller.name}' ({controller.python}), at its sample at t = {t:.10g} s,"
            why = self._call(controller, t, values)
            if isinstance(why, list):
                known.append(tuple(why))
                return why
            self.failure = f"{where} {why}"
        return [0.0] * len(names)

    def _call(self, controller: SampledController, t: float, values: Mapping[str, float]) -> list[float] | str:
        """Return the outputs, or a clause that says what is wrong."""
        if controller.name not in self._functions:
            return "has no recorded outputs, and its function is not called again"
        try:
            return _outputs(self._functions[controller.name](t, dict(values)), controller.output_names)
        except BaseException as error:  # also SystemExit, and what reading the returned object raises
            self.cause = error
            return f"raised {one_line(error)}"


def _outputs(given: object, names: Sequence[str]) -> list[float] | str:
    """Return the outputs that a function has returned, or a clause that says what is wrong."""
    what = f"returned {shortened(shown(repr(given)))}"
    if not isinstance(given, Mapping):
        return f"{what}, not a dict of its outputs"
    if missing := [name for name in names if name not in given]:
        return f"{what}, which lacks the output{'s' * (len(missing) > 1)} {listed(missing, 'and')}"
    if unknown := [str(name) for name in given if name not in names]:
        return f"{what}, but has no output {listed(map(shown, unknown), 'or')}"
    for name in names:
        value = given[name]
        if isinstance(value, bool) or not isinstance(value, Real) or not abs(value) <= LARGEST:  # type: ignore[operator]
            return f"{what}, in which {name} is not a finite number"
    return [float(given[name]) for name in names]
