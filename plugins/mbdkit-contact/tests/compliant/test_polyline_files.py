"""Polylines of contacts that are read from tables in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbdkit
from mbdkit.spec import RunSpec, load_spec

SPEC = """
mbdkit: 1
model:
  name: mechanism
  bodies: {ball: {mass: 1.0, inertia: 0.004, position: [0.0, 0.2]}}
  contacts:
    floor:
      bodies: [ground, ball]
      shapes:
      - polyline: {file: ground.csv, y: height, unit: cm}
      - circle: {radius: 0.1}
      compliance: {stiffness: 1.0e+6}
time: {end: 0.02, step: 0.001}
integrator: {name: rk4}
"""
TABLE = "# a ramp\nx; height\n-100; 0\n50; 0\n100; 20\n"


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    (tmp_path / "ground.csv").write_text(TABLE, encoding="utf-8")
    (tmp_path / "run.yaml").write_text(SPEC, encoding="utf-8")
    return tmp_path / "run.yaml"


def test_archives_have_the_points_of_a_file_and_its_name(spec: Path) -> None:
    done = mbdkit.run(spec)
    assert [file.name for file in done.files] == ["ground.csv"]
    done.save(spec.parent / "run.h5")
    (spec.parent / "ground.csv").unlink()
    with mbdkit.load(spec.parent / "run.h5") as stored:
        points = stored.mechanism.contacts["floor"].shapes[0].polyline
        np.testing.assert_allclose(points, [[-1.0, 0.0], [0.5, 0.0], [1.0, 0.2]], rtol=1e-15)
        again = mbdkit.run(stored.spec)
    np.testing.assert_array_equal(again["ball"].position, done["ball"].position)


@pytest.mark.parametrize(
    ("table", "line", "words"),
    [
        ("", None, "this file is empty"),
        ("x,y\n0,0\n", 1, "there should be one column 'height'; columns: x and y"),
        ("x,height\n0,0\n1,high\n", 3, "should have numbers here"),
        ("x,height\n0,0\n\n1\n", 4, "should have numbers here"),
        (None, None, "this file cannot be read"),
    ],
)
def test_bad_tables_are_refused_with_file_and_line(spec: Path, table: str | None, line: int | None, words: str) -> None:
    path = spec.parent / "ground.csv"
    if table is None:
        path.unlink()
    else:
        path.write_text(table, encoding="utf-8")
    with pytest.raises(mbdkit.SpecError, match=words) as caught:
        load_spec(spec)
    assert (caught.value.file, caught.value.line) == (str(path), line)


@pytest.mark.parametrize(
    ("before", "after", "key", "words"),
    [
        ("unit: cm", "unit: kg", ".unit", "a unit of length"),
        ("unit: cm", "units: cm", ".units", "did you mean 'unit'"),
        ("-100", "100", "[1]", "x decreases"),
    ],
)
def test_bad_keys_and_points_are_refused_with_the_key(
    spec: Path, before: str, after: str, key: str, words: str
) -> None:
    for path in spec.parent.iterdir():
        path.write_text(path.read_text(encoding="utf-8").replace(before, after), encoding="utf-8")
    with pytest.raises(mbdkit.SpecError, match=words) as caught:
        load_spec(spec)
    assert caught.value.key == f"model.contacts.floor.shapes[0].polyline{key}"


def test_validated_data_open_no_file(spec: Path) -> None:
    """Archives are read in this way: a file that one of them names is not opened."""
    data = load_spec(spec).model_dump()
    data["model"]["contacts"]["floor"]["shapes"][0]["polyline"] = {"file": str(spec.parent / "ground.csv")}
    with pytest.raises(mbdkit.SpecError, match="files of points are read from spec files only"):
        RunSpec(**data)
