"""Errors of checked runs by their estimated parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.runs.accuracy.parameter_errors import COVERAGE
from tests.identified import COVARIANCE, MASS, STIFFNESS, sliding, write_fit

GRAVITY = 10.0
MEASURES = {"end": "final(block.x)", "load": {"value": "max(abs(joints.rail.force))", "unit": "kN"}}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with the estimates."""
    monkeypatch.chdir(tmp_path)
    write_fit(tmp_path)
    return tmp_path


def deviations(time: np.ndarray) -> np.ndarray:
    """Return the standard deviation of x = 1 + 0.1 cos(w t), w = sqrt(k/m), from its derivatives by k and m."""
    w = np.sqrt(STIFFNESS / MASS)
    by_w = -0.1 * time * np.sin(w * time)
    jacobian = np.stack([by_w * w / (2 * STIFFNESS), -by_w * w / (2 * MASS)])
    return np.asarray(np.sqrt(np.einsum("it,ij,jt->t", jacobian, COVARIANCE, jacobian)))


@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"integrator": {"name": "gauss", "stages": 3}, "output": {"every": 3}},
        {"integrator": {"name": "dop853", "adaptive": True}, "time": {"end": 3.0}, "output": {"interval": 0.1}},
        {"integrator": {"name": "radau-iia", "stages": 3, "adaptive": True}, "time": {"end": 3.0}},
    ],
    ids=["dop853", "gauss", "interval", "radau"],
)
def test_errors_by_parameters_are_those_of_the_closed_form(folder: Path, sections: dict[str, Any]) -> None:
    # The reaction is m g, whatever the stiffness. Terms of second order in the deviations are left out.
    run = mbdkit.run(sliding(check=True, measures=MEASURES, **sections))
    accuracy = run.accuracy
    assert accuracy is not None
    assert accuracy.position_error_parameters is not None
    assert accuracy.reaction_error_parameters is not None
    expected = 1.96 * deviations(np.asarray(run.time))
    scale = expected.max()
    np.testing.assert_allclose(accuracy.position_error_parameters[:, 0, 0], expected, atol=2e-3 * scale)
    np.testing.assert_allclose(accuracy.position_error_parameters[:, 0, 1:], 0.0, atol=1e-12)
    load = 1.96 * 0.01 * GRAVITY
    np.testing.assert_allclose(accuracy.reaction_error_parameters[:, 0], load, rtol=1e-4)
    assert run.measures.parameter_errors["end"] == pytest.approx(1.96 * deviations(np.array([3.0]))[0], rel=5e-3)
    assert run.measures.parameter_errors["load"] == pytest.approx(1e-3 * load, rel=1e-4)
    assert accuracy.position_error[-1, 0, 0] < 1e-3 * expected[-1]  # of the integration alone


def test_drawn_parameters_give_the_same_errors(folder: Path) -> None:
    # expected: the spread of 400 closed forms with parameters drawn from the joint distribution of the estimates
    run = mbdkit.run(sliding(check=True))
    drawn = np.random.default_rng(5).multivariate_normal([STIFFNESS, MASS], COVARIANCE, 400)
    time = np.asarray(run.time)[:, None]
    spread = np.std(0.1 * np.cos(np.sqrt(drawn[:, 0] / drawn[:, 1]) * time), axis=1)
    assert run.accuracy is not None
    assert run.accuracy.position_error_parameters is not None
    bound = run.accuracy.position_error_parameters[:, 0, 0]
    np.testing.assert_allclose(bound / COVERAGE, spread, rtol=0.12, atol=0.01 * spread.max())


def test_the_archive_is_enough(folder: Path) -> None:
    made = mbdkit.run(sliding(check=True, measures=MEASURES), archive="run.h5")
    (folder / "fit.h5").unlink()
    assert check(folder / "run.h5") == []
    with mbdkit.load("run.h5") as stored:
        assert [file.name for file in stored.files] == ["fit.h5"]
        again = mbdkit.run(dict(stored.spec))
        for run in (stored, again):
            assert run.accuracy is not None
            assert made.accuracy is not None
            for name in ("position_error_parameters", "reaction_error_parameters"):
                np.testing.assert_array_equal(getattr(run.accuracy, name), getattr(made.accuracy, name))
            assert dict(run.measures.parameter_errors) == dict(made.measures.parameter_errors)
        assert stored.accuracy is not None
        column = stored.accuracy.further["position_error_parameters"]
        assert (column.axes, column.units, column.row_units) == (("time", "body", "coordinate"), "mixed", "row_units")
        assert "bound of 95 %" in column.long_name


def test_the_summary_says_what_limits_the_answer(folder: Path) -> None:
    run = mbdkit.run(sliding(check=True, measures=MEASURES))
    lines = run.summary().splitlines()
    limited = next(line for line in lines if line.startswith("limited"))
    assert "positions by the data (" in limited
    assert "forces by the data (0.2 N from parameters, " in limited
    assert any(line.startswith("measures      end") and line.endswith(" m by parameters") for line in lines)
    coarse = {"integrator": {"name": "rk4"}, "time": {"end": 3.0, "step": 0.05}}
    write_fit(folder, 1e-12 * COVARIANCE)
    assert "positions by the integration (" in mbdkit.run(sliding(check=True, **coarse)).summary()


def test_errors_are_unknown_where_a_run_with_other_parameters_does_not_exist(folder: Path) -> None:
    write_fit(folder, np.diag([0.2**2, 12.0**2]))  # a negative mass within a quarter of the deviation
    run = mbdkit.run(sliding(check=True))
    assert run.accuracy is not None
    assert run.accuracy.is_complete
    assert run.accuracy.position_error_parameters is not None
    assert np.all(np.isnan(run.accuracy.position_error_parameters))
    assert (
        "are unknown, because a run with other values is not possible: model.bodies.block.mass" in run.accuracy.method
    )
    assert "limited       positions by unknown" in run.summary()


def test_runs_without_check_or_estimates_have_none(folder: Path) -> None:
    assert mbdkit.run(sliding()).accuracy is None
    known = mbdkit.run(sliding(check=True, parameters={"stiffness": 40.0, "mass": 2.0})).accuracy
    assert known is not None
    assert known.position_error_parameters is known.reaction_error_parameters is None
