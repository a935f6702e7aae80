"""Wrong input is refused by file, line, column or key, and leaves existing files as they are."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.inverse_dynamics.measured_pendulum import pendulum
from typer.testing import CliRunner

import mbdkit
from mbdkit import MbdkitError, SpecError
from mbdkit.cli import app
from mbdkit_biomech.inverse_dynamics.files import table_files

ROWS = ["time,hip,text", *(f"{0.01 * i:.2f},{0.1 * i:.3f},a" for i in range(20))]


def with_row(number: int, row: str) -> list[str]:
    """Return the table with one of its lines, counted from 1, replaced."""
    return [*ROWS[: number - 1], row, *ROWS[number:]]


@pytest.mark.parametrize(
    ("rows", "change", "message"),
    [
        (ROWS, {"columns": {"hip.angle": "hop"}}, "key motion.columns.\"hip.angle\".column: t.csv has no column 'hop'"),
        (ROWS, {"columns": {"hip.angle": "text"}}, "t.csv:2: column 'text': 'a' is not a number"),
        ([ROWS[0], "raw,raw,-", *ROWS[1:]], {}, "t.csv:2: column 'time': 'raw' is not a number; if this row"),
        (['"' + row.replace(".", "_").replace(",", '","').replace("_", ",") + '"' for row in ROWS], {},
         "'0,00' is not a number; decimal commas are"),
        (with_row(5, "0.03,,a"), {}, "t.csv:5: column 'hip': the value is missing (1 row without a value)"),
        (with_row(5, "0.03,nan,a"), {}, "t.csv:5: column 'hip': the value is missing"),
        (with_row(5, "0.03,inf,a"), {}, "t.csv:5: column 'hip': inf is not a finite number"),
        (with_row(5, "0.02,0.3,a"), {}, "t.csv:5: column 'time': times should increase, but 0.02 s follows 0.02 s"),
        (with_row(5, ",0.3,a"), {}, "t.csv:5: column 'time': the time is missing"),
        (with_row(5, "0.03,0.3,a,7"), {}, "t.csv:5: this row has 4 cells, but there are 3 headings"),
        (["time,hip,hip", *ROWS[1:]], {}, "t.csv: two columns have the heading 'hip'"),
        (ROWS[:1], {}, "t.csv: this table has no rows"),
        (["# nothing"], {}, "t.csv: this table is empty"),
        (ROWS, {"columns": {"knee.angle": "hip"}}, "the mechanism has no quantity 'knee.angle'"),
        (ROWS, {"columns": {"hip": "hip"}}, "the mechanism has no quantity 'hip' (did you mean 'hip.angle'?)"),
        (ROWS, {"columns": {"hip.angle": {"column": "hip", "unit": "mm"}}}, "'mm' is not a unit of an angle"),
        (ROWS, {"columns": {"hip.angle": {"column": "hip", "unit": "ell"}}}, "'ell' is not a known unit"),
        (ROWS, {"columns": {"tip.x": {"column": "hip", "unit": "deg"}}}, "'deg' is not a unit of a length (m, mm)"),
        (ROWS, {"columns": {"hip.angle": {"column": "hip", "rate": "hip"}}}, '"hip.angle".acceleration: is'),
        (ROWS, {"smooth": {"name": "butterworth", "cutoff": 60}}, "smooth.cutoff: 60 Hz is too high: with 100 samples"),
        (ROWS, {"smooth": "butterwort"}, "motion.smooth"),
        (with_row(5, "0.035,0.3,a"), {"smooth": {"name": "butterworth", "cutoff": 5}}, "if rows are missing, add them"),
        (with_row(21, "0.19,,a"), {"gaps": {"longest": 1}}, "t.csv:21: column 'hip': a gap at an end of the motion"),
        (with_row(5, "0.03,,a"), {"gaps": {"longest": 0.01}}, "t.csv:5: column 'hip': a gap of 0.02 s is longer than"),
        (with_row(5, "0.03,-8_9.3,a"), {}, "t.csv:5: column 'hip': '-8_9.3' is not a number"),
        (with_row(5, "0.03,\u0661\u0662,a"), {}, "t.csv:5: column 'hip': '\u0661\u0662' is not a number"),
        (with_row(5, f"0.03,{'1' * 140_000},a"), {}, "t.csv:5: a cell of this row has more than 131072 characters"),
        ([*with_row(5, '0.03,0.3,"a\n\n# b"'), "0.2,x,a"], {}, "t.csv:24: column 'hip': 'x' is not a number"),
        (with_row(5, "0.03,x,a\u2028b"), {}, "t.csv:5: column 'hip': 'x' is not a number"),
        ([*with_row(3, "0.01,0.1,a\x0cb"), "0.2,x,a"], {}, "t.csv:22: column 'hip': 'x' is not a number"),
        (ROWS[:4], {}, "derivatives need at least 6 samples, but the motion has 3"),
    ],
)  # fmt: skip
def test_a_wrong_table_is_refused(rows: list[str], change: dict[str, Any], message: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        mbdkit.inverse(pendulum(str(tmp_path / "t.csv"), **change))
    told = str(caught.value).replace(f"{tmp_path}/", "")
    assert message.removeprefix("key ") in told


@pytest.mark.parametrize(
    ("force", "message"),
    [
        ("-0.03 kN", "loads.hand.force: should be two components, such as [force_x, 0.0]: each the heading"),
        (["-0.03 kN", 0.0], "loads.hand.force[0].column: t.csv has no column '-0.03 kN'"),
        (["-0.03 kN", 0.0], "; for a constant, give the number in SI units without its unit: -30"),
    ],
)
def test_a_wrong_force_of_a_load_is_refused(force: Any, message: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\n".join(ROWS), encoding="utf-8")
    loads = {"hand": {"body": "rod", "force": force}}
    with pytest.raises(SpecError) as caught:
        mbdkit.inverse(pendulum(str(tmp_path / "t.csv")) | {"loads": loads})
    assert message in str(caught.value).replace(f"{tmp_path}/", "")


def test_a_plate_that_starts_late_may_have_shifted_times(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\n".join(ROWS), encoding="utf-8")
    late = ["time,fx", *(f"{0.01 * i + 0.05:.2f},1.0" for i in range(20))]
    (tmp_path / "plate.csv").write_text("\n".join(late), encoding="utf-8")
    loads = {"plate": {"body": "rod", "file": str(tmp_path / "plate.csv"), "force": ["fx", 0.0]}}
    with pytest.raises(SpecError) as caught:
        mbdkit.inverse(pendulum(str(tmp_path / "t.csv")) | {"loads": loads})
    assert "is known from 0.05 to 0.24 s, but the motion lasts from 0 to 0.19 s; cut the motion" in str(caught.value)
    assert "if the times of the two files are shifted against each other, correct those of one" in str(caught.value)


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ("LARGEST_FILE", "t.csv: this file is larger than 0 MiB, the limit for files of this kind; keep the rows and"),
        ("MOST_CELLS", "t.csv: this table has more than 50 cells; keep the rows and columns that are used"),
    ],
)
def test_a_table_that_is_too_large_is_refused(
    limit: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_files, limit, 50)
    (tmp_path / "t.csv").write_text("\n".join(ROWS), encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        mbdkit.inverse(pendulum(str(tmp_path / "t.csv")))
    assert message in str(caught.value)


def test_a_motion_that_leaves_a_body_unobserved_is_refused_by_its_name() -> None:
    m = mbdkit.Mechanism()
    m.body("upper", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("lower", mass=1.0, inertia=0.1, position=(1.5, 0.0))
    m.revolute("hip", m.ground, "upper", at=(0, 0))
    m.revolute("knee", "upper", "lower", at=(1, 0))
    data = {"time": np.arange(10.0), "hip": np.zeros(10)}
    motion = {"data": data, "columns": {"hip.angle": "hip"}}
    with pytest.raises(SpecError, match=r"motion.columns: the columns do not observe lower \(y, angle\): 1 of 2"):
        mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion})


def test_nan_in_data_from_python_is_a_gap_that_the_rule_of_its_column_bridges() -> None:
    t = 0.01 * np.arange(20)
    place = int(np.argmax(t[2:] - t[:-2])) + 1  # where the gap of 0.02 s exceeds 0.02 s by rounding
    assert t[place + 1] - t[place - 1] > 0.02
    hip = np.where(np.arange(20) == place, np.nan, 10 * t)
    spec = pendulum("", columns={"hip.angle": {"column": "hip", "gaps": {"longest": 0.02, "interpolation": "linear"}}})
    spec["motion"] |= {"file": None, "data": {"time": t, "hip": hip}, "gaps": {"longest": 0.01}}
    run = mbdkit.inverse(spec)
    assert np.isnan(run.motion["hip.angle"].raw[place])
    assert run.motion["hip.angle"].fitted[place] == pytest.approx(10 * t[place], abs=1e-12)
    assert run.spec["motion"]["data"]["hip"][place] is None


def test_c3d_files_need_a_package_that_the_message_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    (tmp_path / "m.c3d").write_bytes(b"")
    with pytest.raises(MbdkitError, match="needs the package ezc3d"):
        mbdkit.inverse(pendulum(str(tmp_path / "m.c3d")))


def test_errors_of_a_file_name_its_line(tmp_path: Path) -> None:
    spec = pendulum("t.csv")
    spec["motion"]["columns"] = {"hop.angle": "hip"}
    (tmp_path / "t.csv").write_text("\n".join(ROWS), encoding="utf-8")
    text = yaml.safe_dump(spec)
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")
    line = text[: text.index("hop.angle")].count("\n") + 1
    kept = tmp_path / "out.h5"
    kept.write_text("kept")
    done = CliRunner().invoke(app, ["inverse", str(tmp_path / "s.yaml"), "-o", str(kept), "--overwrite"])
    assert done.exit_code == 2
    assert f's.yaml:{line}: motion.columns."hop.angle": the mechanism has no quantity' in done.stderr
    assert kept.read_text() == "kept"
    assert not list(tmp_path.glob("*.part"))
    done = CliRunner().invoke(app, ["run", str(tmp_path / "s.yaml")])
    assert done.exit_code == 2
    assert "compute it with `mbdkit inverse`" in done.stderr


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"measures": {"peak": "max(abs(actuators.knee.value))"}}, "measures.peak: there is no actuator 'knee'"),
        ({"motion": {"file": "t.csv", "columns": {"rod.angle": "hip"}}}, "actuators: no actuator drives"),
    ],
)
def test_validate_refuses_what_inverse_refuses(tmp_path: Path, wrong: dict[str, Any], told: str) -> None:
    (tmp_path / "t.csv").write_text("\n".join(ROWS), encoding="utf-8")
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(pendulum("t.csv") | wrong), encoding="utf-8")
    done = [CliRunner().invoke(app, [word, str(tmp_path / "s.yaml")]) for word in ("inverse", "validate")]
    assert [one.exit_code for one in done] == [2, 2]
    assert told in done[0].stderr == done[1].stderr


def test_validate_gives_the_warnings_that_need_no_computation(tmp_path: Path) -> None:
    rows = ["time,hip", *(f"{0.01 * i:.2f},{50 * np.sin(0.1 * i) + 1.5 * (i == 12):.3f}" for i in range(30))]
    (tmp_path / "t.csv").write_text("\n".join(rows), encoding="utf-8")

    def told(word: str, accept: list[str]) -> list[str]:
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(pendulum("t.csv") | {"accept": accept}), encoding="utf-8")
        words = [word, str(tmp_path / "s.yaml"), *(["-o", str(tmp_path / "s.h5")] if word == "inverse" else [])]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        return (done.stderr if word == "validate" else done.output).splitlines()

    (units, outlier) = (line.removeprefix("warning: ") for line in sorted(told("validate", []), reverse=True))
    assert units.startswith("units: column of hip.angle: the values reach")
    assert outlier.startswith("outliers: column of hip.angle: the value at t = 0.1")
    of_inverse = "\n".join(told("inverse", []))
    assert units in of_inverse
    assert outlier in of_inverse
    assert told("validate", ["units", "outliers"]) == []


def test_commands_compute_check_and_print(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\n".join(ROWS), encoding="utf-8")
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(pendulum("t.csv")), encoding="utf-8")
    out = str(tmp_path / "out.h5")
    for words in (
        ["validate", str(tmp_path / "s.yaml")],
        ["inverse", str(tmp_path / "s.yaml"), "-o", out],
        ["archive", "check", out],
        ["archive", "info", out],
        ["archive", "export", out, "--to", "csv", "-o", str(tmp_path / "csv")],
        ["archive", "diff", out, out],
        ["workload", out],
        ["workload", out, "--json"],
        ["plot", out, "--kind", "torques", "--element", "hip"],
        ["plot", out, "--kind", "trajectory"],
        ["report", out],
    ):
        done = CliRunner().invoke(app, words, prog_name="mbdkit")
        assert done.exit_code == 0, (words, done.output)
    assert "hip.value" in (tmp_path / "csv" / "actuators.csv").read_text()
    done = CliRunner().invoke(app, ["rerun", out, "--files"], prog_name="mbdkit")
    assert done.exit_code == 0, done.output
    assert "the data are the same to the bit" in done.stdout
    changed = [ROWS[0], *(row.replace("0.300", "0.301") for row in ROWS[1:])]
    (tmp_path / "t.csv").write_text("\n".join(changed), encoding="utf-8")
    done = CliRunner().invoke(app, ["rerun", out, "--files"], prog_name="mbdkit")
    assert (done.exit_code, "its SHA-256 differs" in done.stderr) == (2, True)
    (tmp_path / "t.csv").rename(tmp_path / "other.csv")
    done = CliRunner().invoke(app, ["rerun", out], prog_name="mbdkit")
    assert done.exit_code == 2
    assert "out.h5: its data are in t.csv, which is not in the folder of the archive" in done.stderr


def test_markers_without_data_and_columns_that_are_not_used_are_told(tmp_path: Path) -> None:
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1)
    for name, at in (("HIP", -0.2), ("KNEE", 0.2), ("SHIN", 0.1)):
        m.marker(name, "rod", point=(at, 0.0))
    t = np.linspace(0.0, 1.0, 21)
    # the SHIN of the model is misspelt, the third coordinate of a marker in use is of no interest, and a load has `fx`
    columns = {
        f"{name}.{axis}": 0 * t + at * (axis == "x") for name, at in (("HIP", -0.2), ("KNEE", 0.2)) for axis in "xyz"
    }
    columns |= {"SHYN.x": t, "SHYN.y": t, "fx": t, "emg": t}
    loads = {"push": {"body": "rod", "force": ["fx", 0.0]}}
    motion = {"data": {"time": t.tolist()} | {name: x.tolist() for name, x in columns.items()}, "errors": "none"}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": loads}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(spec), encoding="utf-8")
    for command in (["validate"], ["inverse", "-o", str(tmp_path / "out.h5")]):
        done = CliRunner().invoke(app, [*command, str(tmp_path / "s.yaml")], prog_name="mbdkit")
        assert [
            line.split(maxsplit=2)[2] for line in done.stdout.splitlines() if line.startswith(("no data", "not used"))
        ] == ["markers SHIN of the model", "columns SHYN and emg of the data"]


def test_a_marker_that_differs_in_case_and_signs_only_is_asked_about() -> None:
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1)
    for name, at in (("HIP", -0.2), ("KNEE", 0.2), ("shin_1", 0.1)):
        m.marker(name, "rod", point=(at, 0.0))
    t = np.linspace(0.0, 1.0, 21)
    places = {"HIP": -0.2, "KNEE": 0.2, "Shin-1": 0.1}
    data = {f"{name}.{axis}": (0 * t + at * (axis == "x")).tolist() for name, at in places.items() for axis in "xy"}
    motion = {"data": {"time": t.tolist()} | data, "errors": "none"}
    found = mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion})
    assert any("markers Shin-1 of the table are not used" in text for text in found.warnings)
    assert any("did you mean shin_1?" in text for text in found.warnings)


@pytest.mark.parametrize("name", ["t.csv", "t.c3d"])
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_table_that_is_a_pipe_is_not_read(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(SpecError, match="this is not a regular file but a pipe, a socket or a device; it is not read"):
        mbdkit.inverse(pendulum(str(tmp_path / name)))
