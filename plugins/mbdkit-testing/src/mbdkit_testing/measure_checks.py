"""Checks of a measure: it returns numbers, is repeatable, and modifies nothing."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError
from mbdkit.registry.item_options import named_options
from mbdkit.registry.items import MeasurePlugin
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed, warned
from mbdkit_testing.item_checks import ItemUnderTest, short_runs
from mbdkit_testing.options_under_test import options_result, validated

GROWS = 0.3  #: Least power of the number of rows with which a measure grows that is not independent of them.


class MeasureUnderTest(ItemUnderTest[MeasurePlugin]):
    """A measure with options."""

    def take(self, run: Run) -> Any:
        """Return the value of the measure for a run."""
        return self.plugin.take(run, validated(named_options(self.item), {"name": self.item.id, **self.options}))


@check("measure.options")
def options(measure: MeasureUnderTest) -> Result:
    """The measure's options round-trip through JSON and have descriptions."""
    return options_result(measure.plugin.options, measure.options)


@check("measure.value")
def value(measure: MeasureUnderTest) -> Result:
    """For a run of a suitable packaged example, it returns a number, the same number when called again, and one that
    does not grow with the number of rows.
    """
    values: dict[str, float] = {}
    refused = ""
    for (name, run), *fewer in zip(*map(short_runs, (1, 2, 4)), strict=True):
        try:
            first, second, *others = (measure.take(one) for one in (run, run, *(one for _, one in fewer)))
        except MbdkitError as error:  # for example, the measure needs a body that the example does not have
            refused = refused or f"{name}: {error}"
            continue
        if not isinstance(first, int | float | np.number) or isinstance(first, bool):
            return failed(f"for a run of {name} it returned an object of type {type(first).__name__}, not a number")
        if np.isinf(first):
            return failed(f"for a run of {name} it returned {first!r}; nan means that there is no value")
        if not np.array_equal(first, second, equal_nan=True):
            return failed(f"for a run of {name} it returned {first!r} and then {second!r}")
        values[name] = float(first)
        each = np.array([first, *others], dtype=float)
        if np.all(each[:-1] / each[1:] > 0):  # not zero, not of both signs, not nan
            lengths = [len(run.time), *(len(one.time) for _, one in fewer)]
            powers = np.diff(np.log(np.abs(each))) / np.diff(np.log(lengths))
            if powers.min() > GROWS and np.ptp(powers) < GROWS:
                return failed(f"for runs of {name}, it grows with the number of rows", power=float(powers[0]))
    if not values:
        raise Skip(
            f"it cannot be computed for any packaged example ({refused}); use --set to give options that match one"
        )
    if all(np.isnan(list(values.values()))):
        return warned("it returned nan for every example that it was tried on")
    return passed(**values)


CHECKS = (options, value)
