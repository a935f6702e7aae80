"""A run that uses a force law outside the range for which it is declared says so, or stops there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import RunError
from mbdkit.mechanism.force_law import law_range
from mbdkit.registry.manager import registry
from tests.laws.thrown_mass import FREE, GAUSS, thrown

G = 9.81


def settings(method: dict[str, Any]) -> dict[str, Any]:
    """Return the sections of a spec that belong to a method."""
    time = {"end": 0.6} if method["name"].startswith("scipy") else {"end": 0.6, "step": 0.04}
    formulation = "index-3" if method["name"] == "lobatto-pair" else "index-1"
    return {"integrator": method, "time": time, "formulation": formulation}


def passes(height: float, speed: float = 3.0) -> float:
    """Return the time at which the mass passes a height on its way up [s]."""
    return (speed - np.sqrt(speed**2 - 2 * G * height)) / G


def numbers_in(sentence: str) -> list[float]:
    return [float(word) for word in sentence.replace(",", "").split() if word.replace(".", "").isdigit()]


OUTPUTS = [{"every": 1}, {"every": 100}, {"interval": 0.3}]
METHODS = [
    GAUSS,
    {"name": "gauss", "stages": 1},
    {"name": "rk4"},
    {"name": "dopri5"},
    {"name": "dop853"},
    {"name": "lobatto-pair"},
    {"name": "scipy-dop853", "rtol": 1e-9, "atol": 1e-9},
]


CASES = [
    pytest.param(method, output, id="-".join(map(str, (*method.values(), *output.items()))))
    for method in METHODS
    for output in OUTPUTS
    if "interval" not in output or method["name"] not in ("rk4", "lobatto-pair")  # they have no dense output
]


@pytest.mark.parametrize(("method", "output"), CASES)
def test_an_excursion_between_recorded_states_is_told_with_time_and_value(
    method: dict[str, Any], output: dict[str, Any]
) -> None:
    # expected: the parabola of the throw, whose apex v^2/2g = 0.4587 m is above 0.45 m for 0.084 s
    run = mbdkit.run(thrown(**settings(method), output=output))
    (told,) = run.warnings
    assert told.startswith("the length of force 'spring' leaves the range in which its law mbdkit:table holds")
    assert ", from -3 m to 0.45 m" in told
    first, value, at = numbers_in(told)[-3:]
    # stages of these methods, which are used between recorded states, are less accurate: g h^2 / 8 = 2 mm
    coarse = output != {"every": 1} and method in (METHODS[1], METHODS[5])
    # margin: error of mbdkit's method at these steps
    assert first == pytest.approx(passes(0.45), abs=0.007 if coarse else 1e-6)
    # margin: error of mbdkit's method at these steps
    assert value == pytest.approx(9.0 / (2 * G), rel=6e-3 if coarse else 1e-5)
    assert at == pytest.approx(3.0 / G, abs=0.02 if coarse else 1e-3)
    assert run.verdict == "doubtful"
    assert run.verdict_reasons == [told]


@pytest.mark.parametrize(("method", "output"), CASES)
def test_a_motion_that_just_stays_within_the_range_is_not_told(method: dict[str, Any], output: dict[str, Any]) -> None:
    law = FREE | {"table": [[0.0, 9.0 / (2 * G) * (1 + 1e-8)], [0.0, 0.0]]}
    run = mbdkit.run(thrown(law, **settings(method), output=output))
    assert run.verdict == "unknown"
    assert not run.warnings


@pytest.mark.parametrize("output", OUTPUTS, ids=str)
def test_a_run_stops_where_a_law_leaves_its_range_if_that_is_wanted(output: dict[str, Any]) -> None:
    run = mbdkit.run(thrown(output=output, limits={"law_range": "stop"}))
    assert run.status == "failed"
    assert run.status_reason.startswith(
        f"out-of-range: at t = {passes(0.45):.6g} s the length of force 'spring' leaves"
    )
    assert run.time[-1] <= passes(0.45) + 1e-9
    assert run.verdict == "bad"


def test_a_start_outside_of_the_range_stops_the_run_before_its_first_step() -> None:
    law = FREE | {"table": [[1.0, 2.0], [0.0, 0.0]]}
    run = mbdkit.run(thrown(law, limits={"law_range": "stop"}, measures={"highest": {"value": "max(mass.y)"}}))
    assert run.status_reason.startswith("out-of-range: at t = 0 s the length of force 'spring' is 0 m, outside the")
    assert len(run.time) == 0
    assert "no row recorded" in run.summary()
    run = mbdkit.run(thrown(law))
    assert "at t = 0 s, and reaches" in run.warnings[0]


def test_equilibrium_and_modes_outside_of_the_range_are_told_or_refused() -> None:
    # expected: the force 2 - 10 (y + 1) of the table carries the weight of 9.81 N at y = -1.781 m, below the table
    law = FREE | {"table": [[-1.0, 1.0], [-2.0, 18.0]]}
    told = (
        "the length of force 'spring' is -1.781 m, outside the range in which its law mbdkit:table holds, from -1 m to "
        "1 m"
    )
    spec = thrown(law, 0.0)
    rail = {"type": "prismatic", "bodies": ["ground", "mass"], "at": [0, 0], "axis": [0, 1]}
    spec["model"]["joints"] = {"rail": rail}
    spec["model"]["bodies"]["mass"]["inertia"] = 1.0
    assert mbdkit.equilibrium(spec).warnings == (told,)
    assert mbdkit.modes(spec).warnings == [told]
    assert mbdkit.modes(spec, at="start").warnings == []
    for analysis in (mbdkit.equilibrium, mbdkit.modes, mbdkit.linearize):
        with pytest.raises(RunError, match=f"out-of-range: {told}"):
            analysis(spec | {"limits": {"law_range": "stop"}})


def test_a_gas_spring_beyond_its_stroke_or_its_extended_length_is_doubtful() -> None:
    strut = {"law": "gas-spring", "preload": 10.0, "progression": 1.3, "extended_length": 0.4, "stroke": 0.5}
    told = mbdkit.run(thrown(strut)).warnings[0]
    assert "mbdkit:gas-spring holds, from -0.1 m to 0.4 m" in told


def test_inverse_dynamics_tells_that_the_motion_leaves_the_range_of_a_law() -> None:
    # expected: the parabola of the throw, as above
    time = np.linspace(0.0, 0.6, 31)
    spec = {name: part for name, part in thrown().items() if name in ("mbdkit", "model")}
    rail = {"type": "prismatic", "bodies": ["ground", "mass"], "axis": [0, 1], "at": [0, 0]}
    spec["model"]["joints"] = {"rail": rail}
    spec["model"]["bodies"]["mass"]["inertia"] = 0.1
    data = {"time": time.tolist(), "height": (3.0 * time - G * time**2 / 2).tolist()}
    motion = {"data": data, "time": "time", "columns": {"mass.y": {"column": "height", "unit": "m"}}, "smooth": "none"}
    told = mbdkit.inverse(spec | {"motion": motion, "unbalanced": "report"}).warnings[-1]
    first, value, at = numbers_in(told.removesuffix("."))[-3:]
    assert (first, value, at) == pytest.approx((passes(0.45), 9.0 / (2 * G), 3.0 / G), abs=1e-4)


def test_rate_and_time_have_ranges_too(monkeypatch: pytest.MonkeyPatch) -> None:
    law = registry().get("force-law", "mbdkit:table").plugin.law
    bounds = {"rate": (-1.0, np.inf), "time": (-np.inf, 0.5)}
    monkeypatch.setattr("mbdkit.runs.law_ranges.law_range", lambda *_: {"length": (-9.0, 9.0), **bounds})
    rate, time = mbdkit.run(thrown()).warnings
    # expected: v = 3 - g t
    assert "holds, from -1 m/s on, at t = 0.407747 s, and reaches -2.886 m/s at t = 0.6 s" in rate
    assert "holds, up to 0.5 s, at t = 0.5 s, and reaches 0.6 s at t = 0.6 s" in time
    assert law_range(law, type("O", (), {"table": ((0.0, 1.0), (0.0, 0.0))}), "x")["rate"] == (-np.inf, np.inf)


@pytest.mark.parametrize(
    ("valid_range", "message"),
    [
        ({"lenght": (0.0, 1.0)}, "a mapping whose keys are length, rate or time"),
        ({"length": (1.0, 0.0)}, "valid range of length should be two numbers, the lower one first"),
        ({"rate": (1.0, float("nan"))}, "valid range of rate should be two numbers"),
        ({"time": 3.0}, "valid range of time should be two numbers"),
        ([0.0, 1.0], "a mapping whose keys are"),
        (lambda options: options.nothing, "failed to compute its valid range"),
    ],
)
def test_a_range_that_is_none_is_an_error_of_the_plugin(valid_range: Any, message: str) -> None:
    law = mbdkit.FunctionLaw(lambda s, v, t, p: (0.0, 0.0, 0.0, 0.0), valid_range=valid_range)
    with pytest.raises(mbdkit.PluginError, match=message):
        law_range(law, object(), "acme:mine")
