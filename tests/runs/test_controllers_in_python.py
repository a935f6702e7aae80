"""Controllers whose outputs a Python function computes, against the same controllers as expressions."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import mbdkit
from mbdkit import SpecError
from mbdkit import run as from_python
from mbdkit.archive.archive_check import check
from mbdkit.archive.recorded_data import recorded_outputs
from mbdkit.base import called_functions
from tests.runs.controller_functions import CALLS, rotor
from tests.runs.resuming.killed_runs import killed

SECTIONS: dict[str, Any] = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.025}}
HERE = "tests.runs.controller_functions"


def spec(python: str = f"{HERE}:pd", **more: Any) -> dict[str, Any]:
    return {"mbdkit": 1, "model": rotor(python).to_spec(), **SECTIONS, **more}


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.23])
@pytest.mark.parametrize(
    "sections",
    [
        SECTIONS,
        {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 1.0, "step": 0.03}},
        {"integrator": {"name": "dopri5", "adaptive": True}, "time": {"end": 1.0}},
        {"integrator": {"name": "scipy-dop853"}, "time": {"end": 1.0}},
        {**SECTIONS, "events": {"zero": {"when": "rotor.angle"}}},
    ],
)
def test_a_function_controls_as_the_same_expression_does(delay: float, sections: dict[str, Any]) -> None:
    expected = mbdkit.run(rotor(None, delay), **sections).check()
    CALLS.clear()
    run = mbdkit.run(rotor(delay=delay), call=True, **sections).check()
    np.testing.assert_allclose(run["rotor"].angle, expected["rotor"].angle, rtol=0, atol=1e-14)
    np.testing.assert_allclose(run.states["pd.u"].value, expected.states["pd.u"].value, rtol=0, atol=1e-13)
    assert run.states["pd.u"].units == "N m"
    np.testing.assert_allclose([t for t, _ in CALLS], np.arange(10) * 0.1, rtol=0, atol=1e-15)  # once for each sample
    assert CALLS[0][1] == {"rotor.angle": 0.3, "rotor.angular_velocity": -0.2}


def test_samples_are_recorded_and_repeated_without_a_call(mbdkit: Any, tmp_path: Path) -> None:
    run = from_python(rotor(), call=True, archive=tmp_path / "run.h5", **SECTIONS)
    assert run.array("samples/output").tolist() == ["pd.u"] * 10
    assert run.array("samples/row_units").tolist() == ["N m"] * 10
    np.testing.assert_allclose(run.array("samples/time"), np.arange(10) * 0.1, rtol=0, atol=1e-15)
    assert recorded_outputs(run) == {"pd": [[value] for value in run.array("samples/value").tolist()]}
    assert list(run.to_frame("samples").columns) == ["sample", "output", "row_units", "value"]
    run.close()
    assert check(tmp_path / "run.h5") == []
    CALLS.clear()
    assert "the same to the bit" in mbdkit("rerun", str(tmp_path / "run.h5")).stdout
    assert CALLS == []


def test_a_spec_from_elsewhere_calls_nothing(mbdkit: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stranger.py").write_text("raise SystemExit('imported')", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(spec("stranger:function")), encoding="utf-8")
    with pytest.raises(SpecError, match=r"only with --call \(call=True in Python\)") as error:
        from_python(tmp_path / "spec.yaml")
    assert error.value.key == "model.controllers.pd.python"
    assert error.value.line is not None
    assert mbdkit("validate", str(tmp_path / "spec.yaml")).exit_code == 0
    assert "stranger" not in sys.modules
    with pytest.raises(SpecError, match="cannot be imported: SystemExit: imported"):
        from_python(tmp_path / "spec.yaml", call=True)


def test_the_command_calls_with_an_option(mbdkit: Any, tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(spec()), encoding="utf-8")
    command = ["run", str(tmp_path / "spec.yaml"), "-o", str(tmp_path / "run.h5")]
    refused = mbdkit(*command)
    assert refused.exit_code == 2
    assert "--call" in refused.stderr
    assert not (tmp_path / "run.h5").exists()
    assert mbdkit(*command, "--call").exit_code == 0


def test_a_function_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("my-pd", f"{HERE}:pd", called_functions.GROUP)
    monkeypatch.setattr(called_functions, "entry_points", lambda group: ([point], []))
    expected = mbdkit.run(rotor(), call=True, **SECTIONS)
    found = mbdkit.run(rotor("my-pd"), call=True, **SECTIONS)
    np.testing.assert_array_equal(found["rotor"].angle, expected["rotor"].angle)
    with pytest.raises(SpecError, match=r"no entry point 'my-pid' .*did you mean 'my-pd'"):
        mbdkit.run(rotor("my-pid"), call=True, **SECTIONS)


@pytest.mark.parametrize(
    ("python", "says"),
    [
        (f"{HERE}:none_such", "cannot be imported: AttributeError"),
        ("no.such.module:f", "cannot be imported: ModuleNotFoundError"),
        (f"{HERE}:A_NUMBER", "is not a function but of the type float"),
    ],
)
def test_functions_that_cannot_be_found_are_refused(python: str, says: str) -> None:
    with pytest.raises(SpecError, match=says) as error:
        mbdkit.run(rotor(python), call=True, **SECTIONS)
    assert error.value.key == "model.controllers.pd.python"


@pytest.mark.parametrize("integrator", [{"name": "rk4"}, {"name": "scipy-dop853"}])
@pytest.mark.parametrize(
    ("function", "says", "rows_until"),
    [
        ("raises", "raised RuntimeError: the sensor is lost", 0.3),
        ("raises_at_once", "raised RuntimeError: no sensor", 0.0),
        ("nothing", "returned None, not a dict of its outputs", 0.3),
        ("not_a_number", "returned {'u': nan}, in which u is not a finite number", 0.3),
        ("text", "returned {'u': '1'}, in which u is not a finite number", 0.0),
        ("array", "in which u is not a finite number", 0.0),
        ("huge", "in which u is not a finite number", 0.0),
        ("longer_than_python_prints", "raised ValueError: Exceeds the limit", 0.0),
        ("interrupting", "raised KeyboardInterrupt: stop", 0.0),
        ("unreadable", "raised RuntimeError: no values", 0.0),
        ("another", "returned {'u': 0.0, 'w': 1.0}, but has no output w", 0.0),
        ("lacking", "returned {}, which lacks the output u", 0.0),
    ],
)
def test_a_wrong_result_ends_the_run_with_one_sentence(
    function: str, says: str, rows_until: float, integrator: dict[str, Any], tmp_path: Path
) -> None:
    sections = {**SECTIONS, "integrator": integrator}
    run = mbdkit.run(rotor(f"{HERE}:{function}"), call=True, archive=tmp_path / "run.h5", **sections)
    assert run.status == "failed"
    where = f"controller 'pd' ({HERE}:{function}), at its sample at t = {rows_until:g} s,"
    assert run.status_reason.startswith(f"controller-error: {where}")
    assert says in run.status_reason
    assert "\n" not in run.status_reason
    assert run.time[-1] == pytest.approx(rows_until, abs=1e-12)
    assert len(run.array("samples/time")) == round(rows_until / 0.1)
    assert check(tmp_path / "run.h5") == []
    if function.startswith("raises"):
        with pytest.raises(mbdkit.RunError) as error:
            run.check()
        assert isinstance(error.value.__cause__, RuntimeError)


def test_outputs_are_taken_by_name() -> None:
    m = rotor(f"{HERE}:two")
    m.controllers.clear()
    m.controller("pd", period=0.1, python=f"{HERE}:two", outputs={"a": {}, "b": {"unit": "s"}, "u": {}})
    run = mbdkit.run(m, call=True, **SECTIONS)
    assert "lacks the output u" in run.status_reason
    m.controllers.clear()
    m.controller("pd", period=0.1, python=f"{HERE}:two", outputs={"a": {}, "b": {"unit": "s"}})
    m.forces.clear()
    run = mbdkit.run(m, call=True, **SECTIONS).check()
    assert run.states["pd.b"].value[-1] == pytest.approx(0.9, abs=1e-15)
    assert {*run.states["pd.a"].value.tolist()} == {1.0}


def test_a_check_repeats_the_outputs_and_says_so() -> None:
    CALLS.clear()
    run = mbdkit.run(rotor(), call=True, check=True, measures={"end": "final(rotor.angle)"}, **SECTIONS).check()
    assert len(CALLS) == 10
    assert run.verdict == "good"
    assert run.accuracy is not None
    assert "errors for given outputs of controllers in Python" in run.accuracy.method
    assert "for given outputs of controllers in Python" in run.summary()
    # with given outputs, the motion between samples is a parabola, which rk4 computes exactly
    assert run.accuracy.position_error.max() < 1e-13


def test_a_killed_run_goes_on_with_its_function(tmp_path: Path) -> None:
    longer = spec(time={"end": 100.0, "step": 0.005})
    part = tmp_path / "run.h5.part"
    with called_functions.calls_allowed():
        assert killed(longer, part, delay=0.0)
    with pytest.raises(SpecError, match="--call"):
        mbdkit.resume(part)
    CALLS.clear()
    resumed = mbdkit.resume(part, call=True)
    assert 0 < len(CALLS) < 1000  # the samples before the checkpoint are not taken again
    assert resumed.data_sha256 == mbdkit.run(longer, call=True).data_sha256


@pytest.mark.parametrize(
    ("changes", "key", "says"),
    [
        ({"python": "a file.py"}, "python", "should be module:function or the name of an entry point"),
        ({"states": {"sum": {"next": "1"}}}, "states", "takes effect only without `python`"),
        ({"outputs": {"u": "2*t"}}, "outputs.u", "should be a mapping such as {unit: N m}"),
        ({"outputs": {"u": {"unti": "N"}}}, "outputs.u.unti", "unknown key (did you mean 'unit'?)"),
        ({"python": None}, "inputs", "takes effect only with `python`"),
        ({"inputs": ["rotor.angel"]}, "inputs[0]", "did you mean 'angle'?"),
        ({"inputs": ["rotor.angle", "rotor.angle"]}, "inputs", "has a quantity twice"),
    ],
)
def test_wrong_controllers_in_python_are_refused(changes: dict[str, Any], key: str, says: str) -> None:
    data = spec()
    data["model"]["controllers"]["pd"] |= changes
    with pytest.raises(SpecError) as error:
        mbdkit.run(data, call=True)
    assert error.value.key == f"model.controllers.pd.{key}"
    assert says in error.value.message


def test_what_needs_several_calls_is_refused() -> None:
    with pytest.raises(SpecError, match="would call the functions of controllers") as error:
        mbdkit.run(rotor(), call=True, accuracy=1e-6, time={"end": 1.0})
    assert error.value.key == "accuracy"
    with pytest.raises(SpecError, match="has no derivatives") as error:
        mbdkit.run(spec(measures={"end": "final(rotor.angle)"}, gradients=["model.bodies.rotor.inertia"]), call=True)
    assert error.value.key == "model.controllers.pd.python"


@pytest.mark.parametrize("workers", [1, 2])
def test_studies_call_functions_only_if_they_are_told_to(workers: int, tmp_path: Path) -> None:
    study = {"mbdkit_study": 1, "base": spec(), "axes": [{"model.bodies.rotor.inertia": [0.5, 0.6]}]}
    with pytest.raises(SpecError, match="--call"):
        mbdkit.study(study, out=tmp_path / "refused", workers=workers)
    done = mbdkit.study(study, out=tmp_path / "study", workers=workers, call=True)
    assert [point.status for point in done.points] == ["complete"] * 2
    with done.run(0) as run:
        assert run.data_sha256 == mbdkit.run(spec(), call=True).data_sha256
