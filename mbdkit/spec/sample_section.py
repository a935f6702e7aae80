"""The section `sample` of a study: keys of the run spec whose values are drawn from distributions."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path
from mbdkit.spec.distributions import Distribution
from mbdkit.spec.reading import parse_key
from mbdkit.spec.sections import Section, whole

MOST_VARIABLES = 1000
"""Maximum number of variables; the Sobol sequence of scipy.stats.qmc has 21201 dimensions, two for each variable."""


def _check_variables(variables: dict[str, Any]) -> dict[str, Any]:
    if not variables:
        raise SpecError("needs at least one key of a run spec, such as `model.angles.0: {uniform: [-1, 1]}`")
    if len(variables) > MOST_VARIABLES:
        raise SpecError(f"has {len(variables)} variables; a sample has at most {MOST_VARIABLES}")
    taken: dict[tuple[str, ...], str] = {}
    for key in variables:
        path = parse_key(key)
        if not path:
            raise SpecError("should be a dotted key of a run spec, such as model.angles.0", key=key)
        parts = comparable(path)
        if parts in taken:
            raise SpecError(f"is the same key as '{taken[parts]}'", key=key)
        taken[parts] = key
    for key in variables:
        path = comparable(parse_key(key))
        for length in range(1, len(path)):
            if path[:length] in taken:
                raise SpecError(f"is part of '{taken[path[:length]]}', which is also a variable", key=key)
    return variables


def comparable(path: Path) -> tuple[str, ...]:
    """Return a path in which ``angles.0`` and ``angles[0]`` are the same."""
    return tuple(str(part) for part in path)


class Sample(Section):
    """Keys of the run spec whose values are drawn from distributions; each member of the sample is a run."""

    n: Annotated[int, BeforeValidator(whole), Field(ge=1, le=1_000_000)]
    """Number of members of the sample. The Sobol sequence is balanced if it is a power of 2."""
    method: Literal["sobol", "halton", "latin-hypercube", "random"] = "sobol"
    """How the members are chosen: the scrambled Sobol or Halton sequence, Latin hypercube, or random numbers. Except
    with `latin-hypercube`, a larger `n` adds members and keeps the others."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the random numbers, on which all members depend."""
    design: Literal["plain", "saltelli"] = "plain"
    """`plain` makes one run of each member. `saltelli` makes d + 2 runs, where d is the number of variables: from these
    `study.sensitivity` computes Sobol indices."""
    variables: Annotated[dict[str, Distribution], AfterValidator(_check_variables)]
    """Distribution of each key, such as `model.angles.0: {uniform: [-1, 1]}`."""

    @property
    def runs_of_member(self) -> int:
        """Number of runs of each member."""
        return len(self.variables) + 2 if self.design == "saltelli" else 1

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.n * self.runs_of_member
