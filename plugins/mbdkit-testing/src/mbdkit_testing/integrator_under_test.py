"""An integrator under test, with given options: its claims, and methods that run it on a model or a workspace."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.errors import PluginError
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Stepper, Stretch, Timetable
from mbdkit.integrators.start import start_method
from mbdkit.methods.kinds import Method
from mbdkit.methods.tableau import ButcherTableau
from mbdkit.registry.items import Claims, IntegratorPlugin
from mbdkit.runs.preparation import build
from mbdkit.runs.run_seams import Progress
from mbdkit.runs.simulation import simulate
from mbdkit.spec.formulation_choice import choice_of
from mbdkit.spec.run_spec import RunSpec
from mbdkit_testing.check import STEP_LIMIT, Skip
from mbdkit_testing.item_checks import ItemUnderTest
from mbdkit_testing.options_under_test import validated

Value = TypeVar("Value")


@dataclass
class IntegratorUnderTest(ItemUnderTest[IntegratorPlugin]):
    """An integrator with options."""

    _cache: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def claims(self) -> Claims:
        """The integrator's claims with these options."""
        claims = self.plugin.claims(validated(self.plugin.options, self.options))
        if not isinstance(claims, Claims):
            raise PluginError(f"{self.item.id} returned its claims as {type(claims).__name__}; mbdkit.Claims is needed")
        return claims

    @property
    def formulation(self) -> str:
        """The formulation used by most checks: the first one that the integrator claims."""
        return self.claims.formulations[0]

    @property
    def order(self) -> float:
        """The claimed order; raises Skip if there is none."""
        if self.claims.order is None:
            raise Skip("it is adaptive and claims no order")
        return self.claims.order

    @property
    def tableau(self) -> ButcherTableau:
        """The integrator's tableau; raises Skip if the integrator has none."""
        if (tableau := self.method().traits.tableau) is None:
            raise Skip("it is not given by a tableau")
        return tableau

    def method(self, **changes: object) -> Method:
        """Return a new method; `changes` are values of options that replace those of this integrator."""
        return cast(Method, self.plugin.create(validated(self.plugin.options, {**self.options, **changes})))

    def spec(self, model: Mapping[str, Any], time: Mapping[str, Any], **sections: Any) -> RunSpec:
        """Return the spec of a run; ``options`` among the `sections` changes options of the integrator, and
        ``formulation`` is a name from the claims.
        """
        integrator = {"name": self.item.id, **self.options, **sections.pop("options", {})}
        formulation = choice_of(sections.pop("formulation", self.formulation))
        return self.run_spec(model, integrator, time, formulation=formulation, **sections)

    def run(
        self,
        model: Mapping[str, object],
        time: Mapping[str, object],
        *,
        progress: Progress | None = None,
        **sections: object,
    ) -> Run:
        """Run a model in memory, and return the run even if it failed.

        An interrupt raises KeyboardInterrupt, unless `progress` is given; a check may interrupt the run by `progress`.

        Raises
        ------
        PluginError
            If the integrator raised an exception other than StepError; no check then gives another reason.
        """
        run = simulate(self.spec(model, time, **sections), progress=progress)
        code, _, sentence = run.status_reason.partition(": ")
        if code == "plugin-error":
            run.close()
            raise PluginError(sentence)
        if run.status == "interrupted" and progress is None:
            run.close()
            raise KeyboardInterrupt
        return run

    def final_state(self, model: Mapping[str, Any], end: float, step: float, **sections: Any) -> np.ndarray:
        """Return positions and velocities at the end of a run in one vector; NaN if the run failed."""
        with self.run(model, {"end": end, "step": step}, output={"every": 10**9}, **sections) as run:
            return final_state(run)

    def workspace(self, model: Mapping[str, object], **sections: object) -> Workspace:
        """Return the arrays and the solver of a model, at an initial state that satisfies its constraints."""
        return build(self.spec(model, {"end": 1.0, "step": 0.5}, **sections))[0]

    def stepper(
        self,
        workspace: Workspace,
        end: float,
        steps: int,
        *,
        every: int = 10**9,
        method: Method | None = None,
        single: bool = False,
    ) -> Stepper:
        """Return a stepper from the start of `workspace` to `end` [s].

        Parameters
        ----------
        end
            End time [s].
        steps
            Number of steps of a method with fixed steps; an adaptive method chooses its own.
        every
            Number of steps between recorded states.
        method
            The method; by default a new one.
        single
            Whether each call of `advance` takes one step.
        """
        step = None if self.claims.adaptive else (end - workspace.t0) / steps
        table = Timetable(
            start=workspace.t0, end=end, step=step, steps=steps, every=every, max_steps=STEP_LIMIT, single=single
        )
        return start_method(method or self.method(), workspace, table)

    def moved(self, workspace: Workspace, end: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities, ground last, after `steps` steps from the start of `workspace` to `end`."""
        return drive(self.stepper(workspace, end, steps))

    def tolerances(self, tolerance: float) -> dict[str, float]:
        """Return those of the options `rtol` and `atol` that the integrator has, with this value."""
        return {name: tolerance for name in ("rtol", "atol") if name in self.plugin.options.model_fields}

    def cached(self, key: str, compute: Callable[[], Value]) -> Value:
        """Return a value that several checks use; it is computed once."""
        if key not in self._cache:
            self._cache[key] = compute()
        value: Value = self._cache[key]
        return value


def drive(stepper: Stepper, before: Callable[[], None] = lambda: None) -> tuple[np.ndarray, np.ndarray]:
    """Advance a stepper to its end and return positions and velocities there; raises Skip if it stops early.

    Parameters
    ----------
    before
        Called before each call of `advance`.
    """
    q = v = np.zeros(0)
    for stretch in stretches(stepper, before):
        if len(stretch.time):
            q, v = stretch.q[-1], stretch.v[-1]
    return q, v


def stretches(stepper: Stepper, before: Callable[[], None] = lambda: None) -> Iterator[Stretch]:
    """Advance a stepper to its end, and yield what each call of `advance` returns; raises Skip if it stops early."""
    while not (stepper.finished or stepper.failure):
        before()
        yield stepper.advance()
    if stepper.failure is not None:
        raise Skip(f"the steps could not be taken: {stepper.failure.sentence}".rstrip("."))


def final_state(run: Run) -> np.ndarray:
    """Return the last recorded positions and velocities in one vector; NaN if the run is not complete."""
    state = np.concatenate(
        [np.asarray(run.array(f"trajectory/{name}")[-1]).ravel() for name in ("position", "velocity")]
    )
    return state if run.status == "complete" else np.full_like(state, np.nan)


def require_complete(run: Run, what: str = "the run", error: type[Exception] = Skip) -> None:
    """Raise Skip if a run did not complete; another exception, such as MbdkitError, makes the check fail."""
    if run.status != "complete":
        raise error(f"{what} did not complete: {run.status_reason}".rstrip("."))
