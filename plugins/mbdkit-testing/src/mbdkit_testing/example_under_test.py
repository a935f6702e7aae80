"""Kinds of elements and of joints under test: the mechanism and the run of their packaged example."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import description
from mbdkit.base.units import described_units
from mbdkit.engine.workspace import Workspace
from mbdkit.registry.element_items import ElementKind, JointKind
from mbdkit.runs.preparation import build
from mbdkit.runs.simulation import simulate
from mbdkit.spec.loading import load_spec
from mbdkit.spec.run_spec import RunSpec
from mbdkit_testing.check import Skip
from mbdkit_testing.item_checks import ItemUnderTest

#: Method for examples with adaptive steps, where it matters.
ADAPTIVE = {"name": "dopri5", "adaptive": True, "rtol": 1e-9}


AnyKind = TypeVar("AnyKind", bound=ElementKind | JointKind)


class ExampleUnderTest(ItemUnderTest[AnyKind]):
    """An item whose checks use its packaged example."""

    @property
    @abstractmethod
    def what(self) -> str:
        """What the example must have, in the plural."""

    @abstractmethod
    def members(self, spec: RunSpec) -> Mapping[str, Any]:
        """Return those elements or joints of a spec, by name, that the item adds."""

    @cached_property
    def spec(self) -> RunSpec:
        """The spec of the example."""
        if not (example := self.plugin.example):
            raise Skip(f"it has no `example`, the name of a packaged run with {self.what}")
        spec = load_spec(example)
        if not self.members(spec):
            raise SpecError(f"its example '{example}' has no {self.what}")
        return spec

    @cached_property
    def elements(self) -> dict[str, Any]:
        """The elements or joints of the example, by name."""
        return dict(self.members(self.spec))

    @cached_property
    def workspace(self) -> Workspace:
        """The compiled mechanism of the example at its start."""
        return build(self.spec)[0].with_own_pivots()

    @cached_property
    def run(self) -> Run:
        """The run of the example."""
        return completed(self.spec)

    @cached_property
    def rows(self) -> tuple[np.ndarray, ...]:
        """Times (T,), positions and velocities (T, 3 (B + 1)), and first-order states (T, Z) of the run."""
        times = self.run.array("trajectory/time")
        q, v = (self.run.array(f"trajectory/{name}").reshape(len(times), -1) for name in ("position", "velocity"))
        z = self.run.array("states/value") if self.workspace.mechanism.states else np.zeros((len(times), 0))
        return times, *(np.hstack([x, np.zeros((len(times), 3))]) for x in (q, v)), z

    def times(self, factor: float = 1.0) -> dict[str, float]:
        """Return the times of the example, with its step times a factor, or with 500 fixed steps if it has none."""
        start, end, step = self.spec.time.start, self.spec.time.final, self.spec.time.step
        return {"start": start, "end": end, "step": factor * ((end - start) / 500 if step is None else step)}

    def changed(self, mechanism: dict[str, Any] | None = None, **sections: Any) -> RunSpec:
        """Return the spec of the example with plain data of another mechanism, and with other sections."""
        data = json.loads(self.spec.canonical_json())
        data.pop("parameters", None)  # whose values the mechanism contains
        model = {"name": "mechanism", **(mechanism or self.spec.mechanism().to_spec())}
        return load_spec({**data, "model": model, **sections})


def with_units(model: type[BaseModel], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of an element or a joint, whose numbers have the unit of their key if it has one."""
    units = {option: described_units(description(model, option)) for option in options}
    return {
        option: f"{value!r} {units[option][0]}" if isinstance(value, float) and len(units[option]) == 1 else value
        for option, value in options.items()
    }


def completed(spec: RunSpec) -> Run:
    """Return the run of a spec; raises SpecError if it did not complete."""
    if (run := simulate(spec)).status != "complete":
        raise SpecError(f"a run of its example did not complete: {run.status_reason}")
    return run
