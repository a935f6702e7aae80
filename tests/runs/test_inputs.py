"""Inputs of mechanisms: values from tables, against closed forms and independent solutions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import data_sha256
from mbdkit.runs.corners import stops_of
from mbdkit.spec import load_spec
from tests.integrators.python_methods import Pair, Rk45, run_with
from tests.margins import assert_within
from tests.runs.resuming.killed_runs import killed
from tests.runs.rotor_with_inputs import INERTIA, LONG, OFF_GRID, ON_GRID, TABLES, exact_rotor, given, pieces, rotor


def run(hold: str, table: Any, gravity: float = 0.0, **sections: Any) -> mbdkit.Run:
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.02}, **sections}
    return mbdkit.run(rotor(hold, gravity), inputs=given(table), **sections).check()


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize(
    ("integrator", "more"),
    [
        ({"name": "rk4"}, {}),
        ({"name": "rk4"}, {"formulation": "joint-coordinates"}),
        ({"name": "gauss", "stages": 2}, {"output": {"interval": 0.05}}),
        ({"name": "radau-iia", "stages": 3}, {"formulation": "index-2"}),
        ({"name": "dop853", "adaptive": True}, {"time": {"end": 1.0}}),
        ({"name": "dop853", "adaptive": True}, {"time": {"end": 1.0}, "events": {"e": {"when": "rotor.angle - 0.1"}}}),
        ({"name": "scipy-dop853", "rtol": 1e-10}, {"time": {"end": 1.0}}),
        ({"name": "scipy-radau", "rtol": 1e-10}, {"time": {"end": 1.0}, "output": {"interval": 0.05}}),
    ],
)
def test_a_rotor_turns_as_its_torque_demands(
    hold: str, table: Any, integrator: dict[str, Any], more: dict[str, Any]
) -> None:
    result = run(hold, table, integrator=integrator, **more)
    angle, speed = exact_rotor(table, hold)
    tolerance = 1e-9 if "formulation" in more or "rtol" in integrator else 1e-12
    assert result["rotor"].angle[-1] == pytest.approx(angle, abs=tolerance)
    assert result["rotor"].angular_velocity[-1] == pytest.approx(speed, abs=tolerance)


@pytest.mark.parametrize("method", [Pair(None), Pair(1e-8), Rk45()], ids=["fixed", "controlled", "library"])
@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_methods_in_python_have_inputs(method: Any, hold: str) -> None:
    time = {"end": 1.0, "step": 1e-3} if method.tolerances is None else {"end": 1.0}
    result = run_with(method, rotor(hold).to_spec(), time, inputs=given(OFF_GRID)).check()
    assert result["rotor"].angle[-1] == pytest.approx(exact_rotor(OFF_GRID, hold)[0], abs=1e-5)
    assert result.inputs["torque"].set.time[:4] == pytest.approx(OFF_GRID[0], abs=1e-15)


def exact_pendulum(table: Any, hold: str) -> np.ndarray:
    y = np.zeros(2)
    for a, b, value, slope in pieces(table, hold):

        def rates(t: float, y: np.ndarray, a: float = a, value: float = value, slope: float = slope) -> list[float]:
            torque = value + slope * (t - a) - 9.81 * 0.2 * np.cos(y[0])
            return [y[1], torque / (INERTIA + 0.2**2)]

        y = solve_ivp(rates, (a, b), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return y


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize(
    ("integrator", "step", "order"), [({"name": "rk4"}, 0.05, 4), ({"name": "gauss", "stages": 3}, 0.1, 6)]
)
def test_methods_keep_their_order(hold: str, table: Any, integrator: dict[str, Any], step: float, order: int) -> None:
    # expected: piecewise solutions of SciPy's DOP853
    wanted, errors = exact_pendulum(table, hold), []
    for size in (step, step / 2):
        end = run(hold, table, 9.81, integrator=integrator, time={"end": 1.0, "step": size})["rotor"]
        errors.append(np.abs([end.angle[-1] - wanted[0], end.angular_velocity[-1] - wanted[1]]).max())
    # off the grid, the sizes of parts of steps are not halved
    # margin: order, from errors of mbdkit alone
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35 if table is ON_GRID else 1.0)
    assert_within(errors[1], 1e-6)


def test_a_linear_input_moves_a_pendulum_as_the_same_table_of_a_torque_does() -> None:
    m = rotor("linear", 9.81)
    m.forces.pop("motor")
    m.torque("motor", "rotor", value={"table": [list(x) for x in LONG], "interpolation": "linear"})
    sections = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 1.0, "step": 0.02}}
    table, result = mbdkit.run(m, **sections).check(), run("linear", LONG, 9.81, **sections)
    np.testing.assert_allclose(result["rotor"].angle, table["rotor"].angle, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.forces["motor"].value, table.forces["motor"].value, rtol=0, atol=1e-12)


def test_an_input_without_a_table_keeps_its_initial_value() -> None:
    result = mbdkit.run(rotor(), integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.1}).check()
    assert result["rotor"].angle[-1] == pytest.approx(0.25 / INERTIA / 2, abs=1e-14)
    assert result.inputs["torque"].set.time.tolist() == [0.0]
    assert result.inputs["torque"].set.value.tolist() == [0.25]
    assert list(result.states) == []


def test_values_are_recorded_and_those_that_were_set() -> None:
    result = run("linear", LONG, measures={"at": "at(inputs.torque, 0.5)", "mean": "mean(inputs.torque)"})
    torque = result.inputs["torque"]
    start, end = (np.interp(t, *LONG) for t in (0.0, 1.0))
    np.testing.assert_allclose(torque.value, np.interp(result.time, *LONG), rtol=0, atol=1e-14)
    np.testing.assert_allclose(torque.set.time, [0.0, 0.25, 0.61, 1.0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(torque.set.value, [start, -2.0, 0.5, end], rtol=0, atol=1e-14)
    assert torque.units == "N m"
    assert result.measures["at"] == pytest.approx(np.interp(0.5, *LONG), abs=1e-13)
    area = sum(value * (b - a) + slope * (b - a) ** 2 / 2 for a, b, value, slope in pieces(LONG, "linear"))
    assert result.measures["mean"] == pytest.approx(area, abs=1e-13)
    assert result.measures.units["mean"] == "N m"


def test_a_row_shows_the_value_before_the_change_and_a_fixed_step_on_the_grid_is_not_split() -> None:
    result = run("zero", ON_GRID, time={"end": 1.0, "step": 0.1})
    assert len(result.time) == 11
    assert result.inputs["torque"].value[[1, 2, 3, 4, 7, 8]].tolist() == [3.0, 1.0, 1.0, -2.0, -2.0, 0.5]
    stops = stops_of(result.run_spec)
    assert set(stops.times) <= {0.0 + n * 0.1 for n in range(11)}
    assert stops.margins == (0.0,) * 3


def test_times_of_two_inputs_that_are_equal_up_to_rounding_are_one_stop() -> None:
    m = rotor()
    m.input("other", unit="N m")
    m.torque("brake", "rotor", value="-inputs.other")
    inputs = {"torque": {"table": [[0.1 + 0.2], [1.0]]}, "other": {"table": [[0.3], [1.0]]}}
    spec = load_spec(m, integrator={"name": "dop853", "adaptive": True}, time={"end": 1.0}, inputs=inputs)
    assert len(stops_of(spec).times) == 1
    result = mbdkit.run(spec).check()  # the torques cancel from then on
    assert result["rotor"].angular_velocity[-1] == pytest.approx(0.25 * 0.3 / INERTIA, abs=1e-13)


def test_steps_end_at_the_stops_of_the_spec() -> None:
    time = {"end": 1.0, "stops": [0.123, 0.5, 1.0]}
    result = run("zero", ON_GRID, integrator={"name": "dop853", "adaptive": True}, time=time)
    assert {0.123, 0.5} <= {*result.time.tolist()}
    with pytest.raises(SpecError, match="should be within the run") as error:
        run("zero", ON_GRID, time={"end": 1.0, "step": 0.1, "stops": [0.5, 1.5]})
    assert error.value.key == "time.stops[1]"


def test_a_controller_sees_the_new_value_of_an_input_at_the_same_instant() -> None:
    """The output copies the input at each sample, so that the rotor turns as the input alone demands."""
    m = rotor()
    m.controller("copy", period=0.1, outputs={"u": "inputs.torque"})
    m.forces.pop("motor")
    m.torque("motor", "rotor", value="controllers.copy.u")
    for integrator in ({"name": "rk4"}, {"name": "scipy-dop853"}):
        time = {"end": 1.0, "step": 0.05}
        result = mbdkit.run(m, inputs=given(ON_GRID), integrator=integrator, time=time).check()
        assert result["rotor"].angle[-1] == pytest.approx(exact_rotor(ON_GRID, "zero")[0], abs=1e-12)


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"integrator": {"name": "dop853", "adaptive": True}, "time": {"end": 1.0}, "output": {"interval": 0.1}},
        {"integrator": {"name": "scipy-radau"}, "time": {"end": 1.0}},
    ],
)
def test_the_check_of_a_run_with_inputs_estimates_its_errors(hold: str, sections: dict[str, Any]) -> None:
    result = run(hold, ON_GRID, 9.81, check=True, **sections)
    assert result.verdict == "good"
    accuracy = result.accuracy
    assert accuracy is not None
    error = abs(result["rotor"].angle[-1] - exact_pendulum(ON_GRID, hold)[0])
    assert error <= 1.1 * accuracy.position_error[-1, 0, 2] <= max(100.0 * error, 1e-8)
    assert accuracy.reaction_error.max() < 1e-2  # reactions jump with the torque, in all runs at the same times


def test_equal_specs_give_equal_bits_and_what_was_set_is_part_of_the_hash(tmp_path: Path) -> None:
    result = run("zero", OFF_GRID, archive=tmp_path / "run.h5")
    assert mbdkit.run(result.run_spec).data_sha256 == result.data_sha256
    assert check(tmp_path / "run.h5") == []
    with mbdkit.load(tmp_path / "run.h5") as loaded:
        assert loaded.mechanism.inputs == rotor().inputs
        np.testing.assert_array_equal(loaded.inputs["torque"].set.value, OFF_GRID[1])
    result.close()
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["inputs/set/value"][1] = 7.0
        assert data_sha256(file) != file.attrs["data_sha256"]


def test_the_group_of_settings_is_read_by_xarray() -> None:
    result = run("zero", OFF_GRID)
    settings = result.to_xarray()["inputs/set"]
    assert settings["instant"].values == pytest.approx(OFF_GRID[0], abs=1e-15)
    assert settings["name"].values.tolist() == ["torque"] * 4
    assert list(result.to_frame("inputs").columns) == ["torque.value"]


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_a_killed_run_goes_on_to_the_same_bits(hold: str, tmp_path: Path) -> None:
    times = np.arange(0.0, 100.0, 0.37)
    table = [times.tolist(), np.sin(times).tolist()]
    spec: dict[str, Any] = {"mbdkit": 1, "model": rotor(hold, 9.81).to_spec(), "integrator": {"name": "rk4"}}
    spec |= {"time": {"end": 100.0, "step": 0.005}, "inputs": {"torque": {"table": table}}}
    part = tmp_path / "run.h5.part"
    assert killed(spec, part, delay=0.0)
    resumed, whole = mbdkit.resume(part), mbdkit.run(spec)
    assert resumed.data_sha256 == whole.data_sha256
    np.testing.assert_array_equal(resumed.inputs["torque"].set.value, np.sin(times))


def test_a_file_is_read_with_its_columns_and_unit(tmp_path: Path) -> None:
    (tmp_path / "motor.csv").write_text("t;torque\n0;1000\n0.5;-2000\n", encoding="utf-8")
    spec = {"mbdkit": 1, "model": rotor().to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    spec["inputs"] = {"torque": {"file": "motor.csv", "x": "t", "unit": "mN m"}}
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(spec), encoding="utf-8")
    result = mbdkit.run(tmp_path / "spec.yaml").check()
    assert result.inputs["torque"].set.value.tolist() == [1.0, -2.0]
    assert [file.name for file in result.files] == ["motor.csv"]
    assert result.spec["inputs"]["torque"] == {"table": [[0.0, 0.5], [1000.0, -2000.0]], "unit": "mN m"}
    (tmp_path / "motor.csv").write_text("t;torque\n0;one\n", encoding="utf-8")
    with pytest.raises(SpecError, match="should have a number here") as error:
        mbdkit.run(tmp_path / "spec.yaml")
    assert error.value.line == 2


def test_mechanisms_keep_their_inputs() -> None:
    m = rotor("linear")
    m.input("a.b", bounds=(0.0, 1.0))
    again = Mechanism.from_spec(m.to_spec())
    assert again.inputs == m.inputs
    assert m.to_spec()["inputs"] == {
        "torque": {"initial": 0.25, "unit": "N m", "hold": "linear"},
        "a.b": {"bounds": [0.0, 1.0]},
    }


def test_a_name_with_a_dot_is_quoted() -> None:
    m = rotor()
    m.input("a.b", unit="N m", initial=1.0)
    m.torque("other", "rotor", value='inputs["a.b"] - inputs.torque')
    result = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.1}).check()
    assert result["rotor"].angle[-1] == pytest.approx(1.0 / INERTIA / 2, abs=1e-14)


CASES = yaml.safe_load((Path(__file__).parent / "wrong_inputs.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("case", CASES, ids=[f"{i}-{case['key']}" for i, case in enumerate(CASES)])
def test_wrong_inputs_are_refused_by_key(case: dict[str, Any]) -> None:
    model = rotor().to_spec()
    model["inputs"]["torque"] |= {"bounds": [-5.0, 5.0], **case.get("torque", {})}
    if "value" in case:
        model["forces"]["motor"]["value"] = case["value"]
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    with pytest.raises(SpecError) as error:
        mbdkit.run(spec, inputs=case.get("inputs", {}))
    assert error.value.key == case["key"]
    assert case["says"] in error.value.message
    assert "\n" not in error.value.message
