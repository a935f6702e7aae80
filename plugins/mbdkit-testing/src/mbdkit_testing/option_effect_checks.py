"""Requirement on force laws and integrators that each option has an effect."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.mechanism.force_law import ExpressionLaw
from mbdkit.registry.catalogue import Registered
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed, warned
from mbdkit_testing.force_law_checks import RANDOM_OF_VARIANTS, ForceLawUnderTest
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, final_state
from mbdkit_testing.options_under_test import variants
from mbdkit_testing.trial_models import FORCED_PENDULUM

#: Number of random sets of options at which an option that had no effect before is varied again, and number of changes
#: per option from one set to the next.
#:
#: An option may act only in a branch that other options select, as an exponent of a damping does unless the damping is
#: 0.
DRAWS, STRIDE = 16, 2


@check("law.option-effects")
def option_effects(law: ForceLawUnderTest) -> Result:
    """Each option changes the force, the potential, the rate of a state or the valid range for some values."""
    if not (names := list(law.plugin.options.model_fields)):
        raise Skip("it has no options")
    effective = {state.name for state in law.law.states}
    symbols = _symbols(law)
    if symbols is not None and (absent := [name for name in names if name not in symbols | effective]):
        return failed(
            f"its {_options(absent)} no effect, because the expressions of the law do not contain "
            f"{'its symbol' if len(absent) == 1 else 'their symbols'}; use or remove {_pronoun(absent)}"
        )

    def at(options: dict[str, Any]) -> ForceLawUnderTest:
        return replace(law, options=options, random=RANDOM_OF_VARIANTS)

    if idle := _idle(law.item, law.options, names, effective, lambda chosen, other: _differ(at(chosen), at(other))):
        return warned(
            f"its {_options(idle)} no effect for {DRAWS} random sets of values; use or remove "
            f"{_pronoun(idle)}, unless {_pronoun(idle)} should act in rare cases only"
        )
    return passed(options=len(names))


def _idle(
    item: Registered,
    given: dict[str, Any],
    names: list[str],
    effective: set[str],
    differ: Callable[[dict[str, object], dict[str, object]], bool],
) -> list[str]:
    """Return the options of these names without an effect in random sets of values, from those that were tried.

    Parameters
    ----------
    effective
        Options that are known to have an effect.
    differ
        Whether two sets of options have different results.
    """
    tried, effective = set[str](), set(effective)
    for chosen in _choices(item, given):
        for name, other in variants(item, chosen):
            option = name.partition(" = ")[0]
            if option in effective or option not in names:
                continue
            try:
                if differ(chosen, other):
                    effective.add(option)
                tried.add(option)
            except SpecError:  # the options refuse the values
                continue
        if effective >= set(names):
            break
    return [name for name in names if name in tried - effective]


def _options(names: list[str]) -> str:
    return f"option {names[0]} has" if len(names) == 1 else f"options {listed(names, 'and')} have"


def _pronoun(names: list[str]) -> str:
    return "it" if len(names) == 1 else "them"


def _choices(item: Registered, chosen: dict[str, object]) -> Iterator[dict[str, object]]:
    """Yield the options under test, and sets of options on a random walk through their variants."""
    generator = np.random.default_rng(5)
    yield chosen
    for _ in range(DRAWS):
        for _ in range(STRIDE * len(item.plugin.options.model_fields)):
            if others := list(variants(item, chosen)):
                _, chosen = others[generator.integers(len(others))]
        yield chosen


def _differ(first: ForceLawUnderTest, second: ForceLawUnderTest) -> bool:
    """Whether two sets of options give different values at the samples of either, or different valid ranges."""
    if not np.array_equal(first.span, second.span):
        return True
    places = np.concatenate([first.places, second.places])
    rates = first.rates(places), second.rates(places)
    return not np.array_equal(first(places), second(places), equal_nan=True) or any(
        not np.array_equal(rates[0][name], rates[1][name], equal_nan=True) for name in rates[0]
    )


def _symbols(law: ForceLawUnderTest) -> set[str] | None:
    """Return the names of the symbols in the expressions of a law; None if functions compute values of it."""
    given = law.plugin.law
    if not isinstance(given, ExpressionLaw) or given.parameters is not None or callable(given.valid_range):
        return None
    expressions = [given.force, given.potential, *(rate for rate, _ in given.rates.values())]
    results = [expression() if callable(expression) else expression for expression in expressions]
    return {str(symbol) for result in results for symbol in getattr(result, "free_symbols", ())}


@check("contract.option-effects")
def method_option_effects(integrator: IntegratorUnderTest) -> Result:
    """Each option changes the end of a run or its counters for some values, except limits, such as ``max_step``."""
    names = [name for name in integrator.plugin.options.model_fields if not name.startswith(("max_", "min_"))]
    if not names:
        raise Skip("it has no options, or only limits")
    ends = dict[str, bytes]()

    def end(options: dict[str, Any]) -> bytes:
        if (key := str(sorted(options.items()))) not in ends:
            other = IntegratorUnderTest(integrator.item, options, integrator.installed)
            time = {"end": 0.6} if other.claims.adaptive else {"end": 0.6, "step": 0.05}
            with other.run(FORCED_PENDULUM, time) as run:
                counts = str({name: count for name, count in run.stats.items() if not name.endswith("_s")})
                ends[key] = final_state(run).tobytes() + counts.encode()
        return ends[key]

    def differ(chosen: dict[str, object], other: dict[str, object]) -> bool:
        return end(chosen) != end(other)

    if idle := _idle(integrator.item, integrator.options, names, set(), differ):
        cause = f"its {_options(idle)} no effect for {DRAWS} random sets of values; use or remove {_pronoun(idle)}"
        return failed(cause)
    return passed(options=len(names))


CHECKS = (option_effects,)
METHOD_CHECKS = (method_option_effects,)
