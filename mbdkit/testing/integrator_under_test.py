"""An integrator under test: its claims with given options, and ways to run it on a model or on a bare workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.engine.workspace import Workspace
from mbdkit.errors import PluginError
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method
from mbdkit.methods.tableau import ButcherTableau
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.items import Claims, IntegratorPlugin
from mbdkit.run_preparation import build
from mbdkit.simulation import Progress, simulate
from mbdkit.spec.run_spec import RunSpec, spec_type
from mbdkit.stepping.interface import Stepper, Timetable
from mbdkit.testing.check import Skip
from mbdkit.testing.options_under_test import validated

Kept = TypeVar("Kept")
WALL_TIME = 40.0
"""Seconds after which a run of a check is stopped."""


@dataclass
class IntegratorSubject:
    """An integrator with options, ready to be tried.

    Parameters
    ----------
    item
        The integrator in the registry.
    options
        Its options as a spec would give them.
    installed
        The registry in which specs look their models and integrators up.
    """

    item: Registered
    options: dict[str, Any]
    installed: Registry
    _kept: dict[str, Any] = field(default_factory=dict)

    @property
    def plugin(self) -> IntegratorPlugin:
        """The integrator as its plugin registered it."""
        plugin = self.item.plugin
        assert isinstance(plugin, IntegratorPlugin)
        return plugin

    @cached_property
    def spec_type(self) -> type[RunSpec]:
        """The run spec that knows this integrator."""
        return spec_type(self.installed)

    @cached_property
    def claims(self) -> Claims:
        """What it claims with these options."""
        claims = self.plugin.claims(validated(self.plugin.options, self.options))
        if not isinstance(claims, Claims):
            raise PluginError(f"{self.item.id} stated its claims as {type(claims).__name__}, not as Claims")
        return claims

    @property
    def formulation(self) -> str:
        """The formulation that it is tried on: the first that it claims to serve."""
        return self.claims.formulations[0]

    @property
    def order(self) -> float:
        """The order that it claims; raises Skip where it claims none."""
        if self.claims.order is None:
            raise Skip("it controls its own error and claims no order")
        return self.claims.order

    @property
    def tableau(self) -> ButcherTableau:
        """Its tableau; raises Skip where it is none."""
        method = self.method()
        if not isinstance(method, ExplicitRungeKutta | ImplicitRungeKutta):
            raise Skip("it is not a tableau")
        return method.tableau

    def method(self, **changes: Any) -> Method:
        """Return a new method, as a run would get it."""
        options = validated(self.plugin.options, {**self.options, **changes})
        method: Method = self.plugin.create(options)
        return method

    def spec(self, model: Mapping[str, Any], time: Mapping[str, Any], **sections: Any) -> RunSpec:
        """Return the spec of a run; `sections` may bring other integrator options as ``options``."""
        options = sections.pop("options", {})
        data: dict[str, Any] = {
            "mbdkit": 1,
            "model": model,
            "integrator": {"name": self.item.id, **self.options, **options},
            "time": time,
            "formulation": self.formulation,
            "limits": {"wall_time": WALL_TIME},
        }
        return self.spec_type(**data | sections)

    def run(
        self, model: Mapping[str, Any], time: Mapping[str, Any], *, progress: Progress | None = None, **sections: Any
    ) -> Run:
        """Run a model in memory, whatever the end; Ctrl-C is not its end, unless `progress` may have asked for it."""
        run = simulate(self.spec(model, time, **sections), progress=progress, notify=_say_nothing)
        if run.status == "interrupted" and progress is None:
            run.close()
            raise KeyboardInterrupt
        return run

    def final_state(self, model: Mapping[str, Any], end: float, step: float, **sections: Any) -> np.ndarray:
        """Return positions and velocities at the end of a run, all of them in one vector; NaN where it failed."""
        with self.run(model, {"end": end, "step": step}, output={"every": 10**9}, **sections) as run:
            return final_state(run)

    def workspace(self, model: Mapping[str, Any]) -> Workspace:
        """Return a model's workspace at its consistent start."""
        return build(self.spec(model, {"end": 1.0, "step": 0.5}), _say_nothing)[0]

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
        """Return a stepper from the start of `workspace` to `end` [s]; an adaptive method chooses its own steps.

        With `single` it goes on for one step at a time.
        """
        step = None if self.claims.adaptive else (end - workspace.t0) / steps
        table = Timetable(
            start=workspace.t0, end=end, step=step, steps=steps, every=every, max_steps=10**7, single=single
        )
        return (method or self.method()).start(workspace, table)

    def moved(self, workspace: Workspace, end: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities, ground last, at the end of steps from the start of `workspace`."""
        stepper = self.stepper(workspace, end, steps)
        q, v = drive(stepper)
        return q, v

    def kept(self, key: str, make: Callable[[], Kept]) -> Kept:
        """Return what several checks share, made once."""
        if key not in self._kept:
            self._kept[key] = make()
        kept: Kept = self._kept[key]
        return kept


def drive(stepper: Stepper, before: Callable[[], None] = lambda: None) -> tuple[np.ndarray, np.ndarray]:
    """Advance a stepper to its end and return the state there; raises Skip where it stops early.

    Parameters
    ----------
    stepper
        The stepper.
    before
        Called before each stretch.
    """
    q = v = np.zeros(0)
    while not (stepper.finished or stepper.failure):
        before()
        stretch = stepper.advance()
        if len(stretch.time):
            q, v = stretch.q[-1], stretch.v[-1]
    if stepper.failure is not None:
        raise Skip(f"it could not be carried out: {stepper.failure.sentence}".rstrip("."))
    return q, v


def final_state(run: Run) -> np.ndarray:
    """Return all positions and velocities of the last row in one vector; NaN where the run is not complete."""
    state = np.concatenate(
        [np.asarray(run.array(f"trajectory/{name}")[-1]).ravel() for name in ("position", "velocity")]
    )
    return state if run.status == "complete" else np.full_like(state, np.nan)


def _say_nothing(message: str) -> None:
    """Take no note of what takes long before the first step."""
