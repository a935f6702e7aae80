"""Names with dots, brackets, spaces and other printable characters: every place that names elements takes them.

The expected numbers are those of the same mechanism with plain names.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import mbdkit
from mbdkit.base.plain_data import parse_path, path_text, quoted
from mbdkit.cli import app
from mbdkit.spec.reading import parse_key, read_assignment

NAMES = ["Fuß", "x[0].y (left)", 'say "a=b"', "back\\slash.1"]


def spec(name: str) -> dict[str, Any]:
    """Return the spec of a pendulum in which all elements, measures and events have the same name."""
    at = json.dumps(name, ensure_ascii=False)
    model = {
        "name": "mechanism",
        "bodies": {name: {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {name: {"type": "revolute", "bodies": ["ground", name], "points": [[0, 0], [-0.5, 0]]}},
        "markers": {name: {"body": name, "point": [0.5, 0.0]}, f"{name}.2": {"body": name, "point": [0.0, 0.0]}},
        "forces": {
            name: {"type": "torque", "body": name, "value": f"-joints[{at}].angle + states[{at}] + markers[{at}].x"},
            "spring": {"type": "torsion-spring", "bodies": ["ground", name], "stiffness": 5.0},
        },
        "states": {name: {"initial": 0.5, "rate": f"-states[{at}] + bodies[{at}].angular_velocity"}},
        "controllers": {f"{name}'s": {"period": 0.05, "outputs": {name: f"bodies[{at}].angle"}}},
        "coordinates": {f"{name} height": f"{name}.2.y"},
    }
    return {
        "mbdkit": 1,
        "model": model,
        "integrator": {"name": "rk4"},
        "time": {"end": 0.2, "step": 0.01},
        "events": {name: {"when": f"bodies[{at}].angle + 0.05"}},
        "measures": {"peak": f"max(abs(joints[{at}].force))", "when": f"events[{at}].time"},
    }


@pytest.fixture(scope="module")
def plain() -> mbdkit.Run:
    return mbdkit.run(spec("rod"))


@pytest.mark.parametrize("name", NAMES)
def test_a_run_an_archive_and_its_views_keep_the_name(name: str, plain: mbdkit.Run, tmp_path: Path) -> None:
    mbdkit.run(spec(name), archive=tmp_path / "run.h5").close()
    with mbdkit.load(tmp_path / "run.h5") as run:
        assert run.measures == plain.measures
        assert list(run.bodies) == list(run.joints) == [name]
        assert list(run.markers) == [name, f"{name}.2"]
        np.testing.assert_array_equal(run[name].position, plain["rod"].position)
        np.testing.assert_array_equal(run.joints[name].reaction_force, plain.joints["rod"].reaction_force)
        np.testing.assert_array_equal(run.states[name].value, plain.states["rod"].value)
        np.testing.assert_array_equal(run.states[f"{name}'s.{name}"].value, plain.states["rod's.rod"].value)
        assert [event.name for event in run.events] == [name]
        assert name in run.to_frame("joints").to_csv().replace('""', '"')
        assert mbdkit.Mechanism.from_spec(run.spec["model"]).to_spec()["joints"].keys() == {name}
        run.plot.reactions(joints=[name])


@pytest.mark.parametrize("name", ['knee.1 "(left)"=[0]\\Fuß'])
def test_keys_of_a_study_a_gradient_and_the_command_line_name_it(name: str, tmp_path: Path) -> None:
    key, at = f"model.bodies.{quoted(name)}.mass", json.dumps(name, ensure_ascii=False)
    study = mbdkit.study({"mbdkit_study": 1, "base": spec(name), "axes": [{key: [1.0, 2.0]}]}, out=tmp_path / "study")
    heavier = mbdkit.run(spec(name), model=_heavier(name)).measures["peak"]
    assert study.to_frame()["peak"].iloc[1] == heavier
    assert study.select(f"{key} == 2")["peak"].tolist() == [heavier]
    gradient = mbdkit.gradient(_smooth(name), {"peak": f"max(abs(joints[{at}].force))"}, [key], check=False)
    usual = mbdkit.gradient(
        _smooth("rod"), {"peak": "max(abs(joints.rod.force))"}, ["model.bodies.rod.mass"], check=False
    )
    np.testing.assert_array_equal(gradient.jacobian, usual.jacobian)
    (tmp_path / "spec.json").write_text(json.dumps(spec(name)))
    run, report = tmp_path / "run.h5", tmp_path / "report.html"
    for command in (
        ["run", str(tmp_path / "spec.json"), "-o", str(run), "--set", f"{key}=2", "--json"],
        ["plot", str(run), "--kind", "reactions", "--joint", name, "-o", str(tmp_path / "a.svg")],
        ["archive", "export", str(run), "--to", "csv", "-o", str(tmp_path / "csv")],
        ["report", str(run), "-o", str(report)],
    ):
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 0, result.output
    with mbdkit.load(run) as loaded:
        assert loaded.measures["peak"] == heavier


def _smooth(name: str) -> dict[str, Any]:
    """Return the spec without what gradients do not include."""
    of = spec(name)
    of["model"]["forces"][name]["value"] = f"-joints[{json.dumps(name, ensure_ascii=False)}].angle"
    del of["model"]["states"], of["model"]["controllers"], of["events"], of["measures"]
    return of


def _heavier(name: str) -> dict[str, Any]:
    model = spec(name)["model"]
    model["bodies"][name]["mass"] = 2.0
    return model


def test_a_measured_motion_names_markers_with_dots(tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 41)
    angle = 0.3 * np.sin(2.0 * time)
    columns = {"time": time, "R.ASIS.x": np.cos(angle), "R.ASIS.y": np.sin(angle)}
    table = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "m.csv", table, delimiter=",", header=",".join(columns), comments="")
    base = spec("R.ASIS")
    model = {key: base["model"][key] for key in ("name", "bodies", "joints", "markers")}
    run = mbdkit.inverse({
        "mbdkit": 1,
        "model": model,
        "motion": {
            "file": str(tmp_path / "m.csv"),
            "columns": {f"markers.R.ASIS.{axis}": {"column": f"R.ASIS.{axis}", "unit": "m"} for axis in "xy"},
            "smooth": {"name": "none"},
        },
        "actuators": {"R.Hip": {"joint": "R.ASIS"}},
    })  # fmt: skip
    middle = slice(5, -5)
    torque = (0.1 + 0.25) * np.gradient(np.gradient(angle, time), time) + 0.5 * 9.81 * np.cos(angle)
    np.testing.assert_allclose(run.actuators["R.Hip"].value[middle], torque[middle], atol=0.01)


TEXT = st.text(st.characters(blacklist_categories=["C", "Zl", "Zp"], blacklist_characters="/"), min_size=1)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(TEXT | st.integers(0, 99), min_size=1, max_size=6).filter(lambda parts: isinstance(parts[0], str)))
def test_every_key_path_is_read_as_it_was_written(parts: list[str | int]) -> None:
    text = path_text(tuple(parts))
    assert parse_path(text) == tuple(parts)
    assert parse_key(text) == tuple(parts)
    assert read_assignment(f"{text}=1") == (tuple(parts), 1)
