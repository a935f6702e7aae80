"""Controllers of adaptive steps that a plugin adds."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

import mbdkit
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.plugin import StepControl, StepFilter
from mbdkit.registry.manager import Registry


def run_of(control: dict[str, Any], end: float) -> mbdkit.Run:
    integrator = {"name": "dopri5", "adaptive": True, "step_control": control}
    return mbdkit.run("double-pendulum", integrator=integrator, time={"end": end})


class Gains(BaseModel):
    gain: float = 0.5


def integral(options: Gains) -> StepFilter:
    return StepFilter((options.gain,), safety=0.8, limits=(0.5, 2.0))


def test_a_plugin_adds_a_controller(installed: Callable[..., Registry]) -> None:
    installed(acme=[StepControl("integral", "An integral controller.", Gains, integral)])
    control = {"name": "integral", "gain": 0.4}
    run = run_of(control, 10.0).check()
    assert run.spec["integrator"]["step_control"] == {"name": "acme:integral", "gain": 0.4}
    assert run.provenance["step_control_distribution"] == "acme"
    sizes = np.diff(run.time)[:-1]
    assert np.max(sizes[1:] / sizes[:-1]) <= 2.0 + 1e-9
    with pytest.raises(SpecError, match=r"integrator.step_control.gain: should be a number"):
        run_of(control | {"gain": "x"}, 1.0)


@pytest.mark.parametrize(
    ("create", "sentence"),
    [
        (
            lambda options: StepFilter((2.5,)),
            "a pole of the closed loop has the modulus 1.5, which must be less than 1",
        ),
        (lambda options: StepFilter((1.0,), (0.5, 0.5, 0.5)), "not a tuple of at most 2 numbers"),
        (lambda options: StepFilter((1.0,), safety=1.0), "the safety factor of the controller is 1.0, not a number"),
        (lambda options: StepFilter((1.0,), limits=(2.0, 3.0)), "the limits of the controller are (2.0, 3.0), not"),
        (lambda options: (1.0,), "returned an object of type tuple, not an object of type StepFilter"),
    ],
)
def test_a_wrong_controller_is_an_error_of_its_plugin(
    create: Callable[[Gains], Any], sentence: str, installed: Callable[..., Registry]
) -> None:
    installed(acme=[StepControl("wrong", "A wrong controller.", Gains, create)])
    with pytest.raises(PluginError, match=re.escape(sentence)) as error:
        run_of({"name": "wrong"}, 1.0)
    assert "the step control 'acme:wrong'" in str(error.value)
