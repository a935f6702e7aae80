"""Measures of runs with `check: true` have error estimates, in archives and in tables of studies.

Exact values are those of the oscillator x = cos(2 t) until t = 4.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.runs.accuracy.compared_measures import other_methods
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec import load_spec
from mbdkit.trust.measure_error import measure_error
from tests.runs.oscillator import EXACT, TEXTS, oscillator
from tests.slow_cases import slow

STOP = {"stop": {"when": "slider.x + 0.5", "action": "stop"}}


@pytest.mark.parametrize(
    ("integrator", "step"),
    [
        ({"name": "rk4"}, 0.1),
        ({"name": "dop853", "adaptive": True, "rtol": 1e-5}, None),
        *slow(({"name": "gauss", "stages": 2}, 0.1), ({"name": "radau-iia", "stages": 3}, 0.2)),
        ({"name": "scipy-dop853", "rtol": 1e-5, "atol": 1e-5}, None),
    ],
)
def test_errors_of_measures_are_those_of_the_exact_motion(integrator: dict[str, Any], step: float | None) -> None:
    made = mbdkit.run(oscillator(integrator, step, measures=TEXTS, check=True))
    for name, (_, exact, _) in EXACT.items():
        if exact is not None:
            true = abs(made.measures[name] - exact)
            assert true / 3 - 1e-11 <= made.measure_errors[name] <= 5 * true + 1e-11, name


def test_the_time_of_an_event_has_an_error_and_so_has_what_it_ends() -> None:
    measures = {"when": "events.stop.time", "end": "final(slider.vx)", "slow": "at(slider.x, 0.53)"}
    made = mbdkit.run(oscillator({"name": "rk4"}, 0.1, measures=measures, events=STOP, check=True))
    phase = np.arccos(-0.5)
    for name, exact in (("when", phase / 2), ("end", -2 * np.sin(phase)), ("slow", np.cos(1.06))):
        true = abs(made.measures[name] - exact)
        assert true / 3 <= made.measure_errors[name] <= 5 * true


def test_the_last_method_that_stiff_beams_are_compared_with_reaches_the_end() -> None:
    # expected: index-1 accelerations of the strip consist of round-off, so that DOP853 and Gauss run out of steps
    spec = load_spec("leaf-spring", ["time.end=0.1"])
    *others, last = other_methods(RunSetup.of(spec), 20)
    assert [str(one.formulation) for one in others] == ["index-1"] * len(others)
    torque = [mbdkit.run(one, measures=spec.measures).measures["torque"] for one in (spec, last)]
    assert torque[1] == pytest.approx(torque[0], rel=1e-5)
    assert torque[1] != torque[0]


def test_errors_are_stored_and_shown(tmp_path: Path) -> None:
    units = {"peak": TEXTS["peak"]}
    path = tmp_path / "run.h5"
    made = mbdkit.run(oscillator({"name": "rk4"}, 0.1, measures=units, check=True), archive=path)
    error = made.measure_errors["peak"]
    assert 0.0 < error < 1e-3
    with mbdkit.load(path) as read:
        assert read.measure_errors == {"peak": error}
        assert f"+- {error:.2g} m/s" in read.summary()
    assert np.isnan(mbdkit.run(oscillator({"name": "rk4"}, 0.1, measures=units)).measure_errors["peak"])


@pytest.mark.parametrize("store", ["files", *slow("all", "summary")])
def test_tables_of_studies_have_the_errors(store: str, tmp_path: Path) -> None:
    base = oscillator({"name": "rk4"}, 0.1, check=True)
    axes = [{"time.step": [0.1, 0.05]}]
    study = {"mbdkit_study": 1, "store": store, "base": base, "axes": axes, "measures": {"peak": TEXTS["peak"]}}
    found = mbdkit.study(study, out=tmp_path / "study").to_frame()
    errors, true = found["peak_error"].to_numpy(), np.abs(found["peak"].to_numpy() - 2.0)
    assert np.all((true / 3 <= errors) & (errors <= 5 * true))
    with pytest.raises(SpecError, match="column of the error of 'peak'"):
        mbdkit.study(study | {"measures": {"peak": TEXTS["peak"], "peak_error": TEXTS["lowest"]}}, out=tmp_path / "no")


@pytest.mark.parametrize(
    ("value", "compared", "error"),
    [
        (1.0, (0.25, 0.0625, 0.0), 1.0),  # order 2: the error is that of the first run
        (1.0, (0.9, 1.1, 5.0), None),  # another method disagrees
        (1.0, (1.5, 0.2, 0.9), None),  # no convergence
        (1.0, (1.0, 1.0, 1.0), 1e-15),
        (1.0, (1.0 + 1e-9, 1.0 - 1e-9, 1.0), 2e-9),  # rounding errors
        (1.0, (0.5, float("nan"), 0.0), None),
    ],
)
def test_the_error_of_a_number(value: float, compared: tuple[float, ...], error: float | None) -> None:
    found = measure_error(value, compared)
    assert np.isnan(found) if error is None else found == pytest.approx(error, rel=0.1)
