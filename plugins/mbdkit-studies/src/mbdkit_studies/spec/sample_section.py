"""The section `sample` of a study: keys of the run spec whose values are drawn from distributions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, quoted, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.units import Unit, read_quantity
from mbdkit.spec.reading import parse_key
from mbdkit.spec.sections import Section, whole
from mbdkit_studies.spec.value_sets import NUMBER

FORM = "{DISTRIBUTION: PARAMETERS}, such as {uniform: [-1, 1]} or {norm: {loc: 2, scale: 0.1}}"

LIMITS = ("low", "high")  #: Parameters of `uniform`; scipy.stats uses the lower limit and the width instead.
_NORMAL = {"mean": "loc", "std": "scale"}  #: Parameters of `normal`, which scipy.stats calls norm.
_LOCATION = ("loc", "scale")
#: Distributions that samples cannot have, because each quantile takes milliseconds in spite of a formula for it.
_SLOW = ("ksone", "kstwo")


def check_distribution(given: object) -> Any:
    """Check a distribution and return it unchanged.

    Parameters
    ----------
    given
        A mapping of one name to a list or a mapping of parameters.

    Raises
    ------
    SpecError
        If this is not a valid distribution. The error has the key within it.
    """
    frozen(given)
    return given


def frozen(given: object) -> Any:
    """Return the frozen distribution of ``scipy.stats`` for a distribution as written in a spec.

    Raises
    ------
    SpecError
        If this is not a valid distribution. The error has the key within it.
    """
    if not isinstance(given, Mapping) or len(given) != 1:
        raise SpecError(f"should be {FORM}, not {value_text(given)}")
    name, parameters = next(iter(given.items()))
    with SpecError.locate(str(name)):
        return _frozen(str(name), parameters)


def _frozen(name: str, given: object) -> Any:
    distribution = _distribution(name)
    shapes = tuple(distribution.shapes.split(", ")) if distribution.shapes else ()
    names = LIMITS if name == "uniform" else tuple(_NORMAL) if name == "normal" else (*shapes, *_LOCATION)
    values = _values(name, given, names, names if name == "uniform" else shapes)
    if name == "uniform":
        low, high = values["low"], values["high"]
        if not low < high:
            raise SpecError(f"`low` should be less than `high`, but they are {low:g} and {high:g}")
        if not math.isfinite(high - low):
            raise SpecError("the range is too large for double precision")
        values = {"loc": low, "scale": high - low}
    values = {_NORMAL.get(key, key): value for key, value in values.items()}
    if values.get("scale", 1.0) <= 0:
        word = "std" if name == "normal" else "scale"
        raise SpecError(f"`{word}` should be positive, not {values['scale']:g}")
    made = distribution(
        *(values[shape] for shape in shapes), **{key: values[key] for key in _LOCATION if key in values}
    )
    with np.errstate(all="ignore"):
        known = np.isfinite(made.ppf([0.1, 0.5, 0.9]))
    if not np.all(known):
        text = ", ".join(f"{key} {value:g}" for key, value in values.items())
        raise SpecError(f"the distribution does not exist for these parameters: {text}")
    return made


def _values(name: str, given: object, names: Sequence[str], needed: Sequence[str]) -> dict[str, float]:
    """Return the given parameters by name."""
    text = f"'{name}' has the parameters {listed(names, 'and')}"
    if isinstance(given, Mapping):
        for key in given:
            if key not in names:
                raise SpecError(f"unknown parameter{did_you_mean(str(key), names)}; {text}", key=str(key))
        values = dict(given)
    elif isinstance(given, list | tuple):
        if len(given) > len(names):
            raise SpecError(f"has {len(given)} parameters, which are too many: {text}")
        values = dict(zip(names, given, strict=False))
    else:
        raise SpecError(f"needs its parameters as a list or a mapping, not {value_text(given)}: {text}")
    if missing := [one for one in needed if one not in values]:
        raise SpecError(f"needs {listed([f'`{one}`' for one in missing], 'and')}: {text}")
    values, _ = _in_si(values)
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise SpecError(f"should be a number, not {value_text(value)}", key=str(key))
    return {key: float(value) for key, value in values.items()}


def _in_si(values: Mapping[str, object]) -> tuple[dict[str, Any], Unit | None]:
    """Return parameters in SI units, and the unit of the variable; shape parameters have no unit.

    Raises
    ------
    SpecError
        If only one of location and scale (or of two limits) has a unit, if their units are of different kinds, or if a
        shape parameter has a unit.
    """
    numbers, units = dict(values), {}  # type: dict[str, Any], dict[str, Unit]
    for key, value in values.items():
        with SpecError.locate(str(key)):
            quantity = read_quantity(value)
        if quantity is not None:
            numbers[key], units[key] = quantity
    sized = [key for key in values if key in (*LIMITS, *_NORMAL, *_LOCATION)]
    if units and ({*units} != {*sized} or len({unit.si for unit in units.values()}) > 1):
        raise SpecError(f"{listed([f'`{key}`' for key in sized], 'and')} should have units of the same kind, or none")
    return numbers, next(iter(units.values()), None)


def typical_values(given: object) -> list[float]:
    """Return lower limit, mean and upper limit of a valid distribution, without those that are not finite."""
    distribution = frozen(given)
    with np.errstate(all="ignore"):
        low, high = distribution.support()
        values = float(low), float(distribution.mean()), float(high)
    return [value for value in values if math.isfinite(value)]


def central_range(given: object) -> tuple[float, float]:
    """Return the quantiles of 5 and 95 % of a valid distribution, in SI units."""
    low, high = frozen(given).ppf([0.05, 0.95])
    return float(low), float(high)


def unit_of(given: Any) -> Unit | None:
    """Return the unit of the parameters of a valid distribution; None if they are plain numbers."""
    (parameters,) = given.values()
    if isinstance(parameters, Mapping):
        return _in_si(parameters)[1]
    return next((quantity[1] for parameter in parameters if (quantity := read_quantity(parameter))), None)


def _distribution(name: str) -> Any:
    """Return a distribution of ``scipy.stats`` by its name."""
    import scipy.stats

    known = distribution_names()
    found_there = getattr(scipy.stats, "norm" if name == "normal" else name, None)
    if name in known:
        return found_there
    if isinstance(found_there, scipy.stats.rv_continuous):
        raise SpecError(
            "scipy.stats computes quantiles of this distribution too slowly for samples; choose another one"
        )
    if isinstance(found_there, scipy.stats.rv_discrete):
        raise SpecError("is a discrete distribution; samples need continuous ones, and an axis takes a list of values")
    hint = did_you_mean(name, known) or "; examples: uniform, normal, lognorm, triang, truncnorm"
    raise SpecError(f"there is no continuous distribution '{name}' in scipy.stats{hint}")


@cache
def distribution_names() -> tuple[str, ...]:
    """Return the names of the distributions that variables of a sample may have."""
    import scipy.stats

    generic = scipy.stats.rv_continuous
    there = {name: getattr(scipy.stats, name) for name in dir(scipy.stats)}
    fast = (
        name
        for name, one in there.items()
        if isinstance(one, generic) and type(one)._ppf is not generic._ppf and name not in _SLOW
    )
    return (*sorted(fast), "normal")


#: The distribution of a variable, as written in the spec.
Distribution = Annotated[
    Any,
    BeforeValidator(check_distribution),
    WithJsonSchema(
        {
            "type": "object",
            "minProperties": 1,
            "maxProperties": 1,
            "additionalProperties": {
                "anyOf": [{"type": "array", "items": NUMBER}, {"type": "object", "additionalProperties": NUMBER}]
            },
            "description": f"The distribution of the key: {FORM}. The names and parameters are those of continuous "
            "distributions of scipy.stats, in their order: first those of the shape, then loc and scale; but `uniform` "
            "has the limits low and high, and `normal` has mean and std.",
        }
    ),
]


#: Largest number of variables. The Sobol sequence of scipy.stats.qmc has 21201 dimensions; each variable may need
#: two.
MOST_VARIABLES = 1000


def _check_number(variables: object) -> Any:
    """Refuse too many variables before their distributions are checked, which takes 0.3 ms for each."""
    if isinstance(variables, Mapping) and len(variables) > MOST_VARIABLES:
        raise SpecError(f"has {len(variables)} variables; a sample has at most {MOST_VARIABLES}")
    return variables


def _check_variables(variables: dict[str, Any]) -> dict[str, Any]:
    taken: dict[tuple[str, ...], str] = {}
    for key in variables:
        if not (path := parse_key(key)):
            raise SpecError("should be a dotted key of a run spec, such as model.angles.0", key=quoted(key))
        if (parts := comparable(path)) in taken:
            raise SpecError(f"is the same key as '{taken[parts]}'", key=quoted(key))
        taken[parts] = key
    for key in variables:
        path = comparable(parse_key(key))
        for length in range(1, len(path)):
            if path[:length] in taken:
                raise SpecError(f"is part of '{taken[path[:length]]}', which is also a variable", key=quoted(key))
    return variables


def comparable(path: Path) -> tuple[str, ...]:
    """Return a path in a form in which ``angles.0`` and ``angles[0]`` are equal."""
    return tuple(str(part) for part in path)


class Sample(Section):
    """Keys of the run spec whose values are drawn from distributions; each member of the sample is one set of
    values.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("estimates",)

    n: Annotated[int, BeforeValidator(whole), Field(ge=1, le=1_000_000)]
    """Number of members of the sample. The Sobol sequence is balanced if this number is a power of 2."""
    method: Literal["sobol", "halton", "latin-hypercube", "random"] = "sobol"
    """How the members are chosen: the scrambled Sobol or Halton sequence, Latin hypercube, or random numbers. Except
    with `latin-hypercube`, a larger `n` adds members and keeps the others."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the random numbers, on which all members depend."""
    design: Literal["plain", "saltelli"] = "plain"
    """`plain` makes one run for each member. `saltelli` makes d + 2 runs for each member, where d is the number of
    variables; `study.sensitivity` computes Sobol indices from these runs."""
    variables: Annotated[dict[str, Distribution], BeforeValidator(_check_number), AfterValidator(_check_variables)] = (
        Field(default_factory=dict)
    )
    """Distribution of each key, such as `model.angles.0: {uniform: [-1, 1]}`. May be left out with `estimates`."""
    estimates: bool = False
    """Whether the parameters that the base takes from an identification, by `parameters: {from: FILE.h5}`, are drawn
    from their joint normal distribution. Those that `variables`, `overrides` or `axes` set are not drawn."""

    @model_validator(mode="after")
    def _consistent(self) -> Sample:
        if not self.variables and not self.estimates:
            raise SpecError(
                "needs at least one key of a run spec, such as `model.angles.0: {uniform: [-1, 1]}`", key="variables"
            )
        if self.estimates and self.design == "saltelli":
            raise SpecError("needs independent variables, but estimates are correlated; use `plain`", key="design")
        return self

    @property
    def runs_of_member(self) -> int:
        """Number of runs for each member."""
        return len(self.variables) + 2 if self.design == "saltelli" else 1

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.n * self.runs_of_member
