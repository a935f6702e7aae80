"""A method that works in place, or uses its arrays again, never changes what is recorded."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mbdkit import StepState

from .step_methods import RungeKutta, run_with

PENDULUM = {"name": "double-pendulum"}
TIME = {"end": 0.5, "step": 0.01}


class ReturnsItsBuffer(RungeKutta):
    """Returns its results in the same arrays in every step, the multipliers and its memory included."""

    carries_multipliers = True
    buffer: dict[str, np.ndarray] | None = None

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        _, lam = equations.accelerations(t + h, new.q, new.v)
        arrays = {"q": new.q, "v": new.v, "multipliers": lam, "last": np.array([t])}
        if self.buffer is None:
            self.buffer = {name: array.copy() for name, array in arrays.items()}
        if state.memory is not None:
            assert state.memory["last"][0] < t  # not overwritten by a step that was discarded
        for name, array in arrays.items():
            self.buffer[name][:] = array
        b = self.buffer
        return StepState(b["q"], b["v"], b["multipliers"], memory={"last": b["last"]})


class ReturnsNewArrays(ReturnsItsBuffer):
    """The same with new arrays in every step."""

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        self.buffer = None
        return super().step(equations, t, state, h)


@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"output": {"every": 7}},
        {"stabilization": {"name": "projection"}},
        {"stabilization": {"name": "projection", "symmetric": True}},
        {"events": {"down": {"when": "rod1.angle + 1.2"}}},
    ],
    ids=["plain", "every 7", "projection", "symmetric projection", "event"],
)
def test_a_method_that_returns_its_buffer_gives_the_same_run_as_one_that_returns_new_arrays(sections):
    runs = [run_with(method, PENDULUM, TIME, **sections).check() for method in (ReturnsItsBuffer(), ReturnsNewArrays())]
    assert runs[0].data_sha256 == runs[1].data_sha256
    assert runs[0].array("constraints/method_multiplier").std(axis=0).max() > 0


@pytest.mark.parametrize("name", ["q", "v", "mass", "q0", "memory"])
def test_work_in_place_on_what_belongs_to_the_run_is_a_plugin_error(name):
    class InPlace(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            new = super().step(equations, t, state, h)
            if t > 0.2:
                owner: Any = equations if name in ("mass", "q0") else state
                array = getattr(owner, name)
                (array["a"] if name == "memory" else array)[0] += 1.0
            return StepState(new.q, new.v, memory={"a": np.zeros(1)})

    run = run_with(InPlace(), PENDULUM, TIME)
    assert run.status == "failed"
    assert run.status_reason.startswith("plugin-error: integrator acme:mine raised ValueError: InPlace.step changes an")
    assert "read-only" in run.status_reason
    assert run.time[-1] > 0.2
