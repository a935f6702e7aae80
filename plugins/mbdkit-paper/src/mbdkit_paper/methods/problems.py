"""The table of problems, `problems.yaml`, as values."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml

from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.values import Positive
from mbdkit.spec.loading import load_spec

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.spec.run_spec import RunSpec


PRECISE = {"integrator": {"name": "dop853", "adaptive": True, "rtol": 1e-13}, "stabilization": "projection"}


class Quantity(StrictModel):
    """One result of a problem, in SI units."""

    value: str
    """The result as an expression of a measure."""
    published: float | None = None
    """The result that the source prints; None if it prints none."""
    published_error: Positive | None = None
    """Upper bound of the error of `published`; None if the source prints no result."""
    reference: float
    """The result to more digits."""
    reference_error: Positive
    """Upper bound of the error of `reference`."""


class Problem(StrictModel):
    """A problem with published results."""

    title: str
    """The problem in a few words."""
    example: str
    """The packaged example that is its spec."""
    changes: tuple[str, ...] = ()
    """Assignments that change the example, such as ``model.n=40``."""
    end: Positive
    """The time of the results [s]."""
    step: Positive | None = None
    """The largest fixed step of a comparison [s], which most implicit methods can take; None if all would fail."""
    tightest: Positive | None = None
    """A further tolerance of the whole study, for published results that need it; None if none do."""
    quantities: dict[str, Quantity]
    """The results by name."""
    precise: dict[str, Any] = PRECISE
    """Keys of a run whose forces are the references of forces."""
    formulations: tuple[Literal["index-1", "index-2", "index-3", "ggl", "joint-coordinates"], ...]
    """Formulations in which the problem has this solution."""
    treatments: tuple[Literal["event-driven", "time-stepping"], ...] = ()
    """Treatments of its rigid contacts."""
    source: str
    """Who published the results."""
    reference_source: str
    """Where the references come from."""

    def spec(self, step: float | None = None, **sections: Any) -> RunSpec:
        """Return the spec of the problem, without stabilization, with its results as measures.

        Parameters
        ----------
        step
            Step of methods with fixed steps [s].
        sections
            Sections that replace those of the example, such as `integrator`, `formulation` and `stabilization`.
        """
        time = {"end": self.end} if step is None else {"end": self.end, "step": step}
        measures = {name: quantity.value for name, quantity in self.quantities.items()}
        given = {"time": time, "measures": measures, "stabilization": "none"}
        return load_spec(self.example, self.changes, **given | sections)

    def errors(self, run: Run) -> dict[str, float]:
        """Return the absolute errors of the results of a complete run of `spec`, by name."""
        return {name: abs(run.measures[name] - quantity.reference) for name, quantity in self.quantities.items()}


@cache
def problems() -> dict[str, Problem]:
    """Return the problems by name."""
    table = yaml.safe_load(Path(__file__).with_name("problems.yaml").read_text(encoding="utf-8"))
    return {name: Problem(**values) for name, values in table.items()}
