"""Files as laboratories have them: each is read as what it means, or refused with the key of the spec."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_identify.loading import load_identify_spec
from mbdkit_identify.measured_data import ExperimentData, read_experiment

TIMES = 0.25 * np.arange(8)
ANGLES = 0.5 + 0.125 * np.arange(8)  # rad; exact in few decimals
BASE = {
    "mbdkit": 1,
    "model": {"name": "single-pendulum"},
    "integrator": {"name": "rk4"},
    "time": {"end": 3.0, "step": 0.05},
}


def read(folder: Path, name: str, text: str, column: object, **experiment: Any) -> ExperimentData:
    (folder / name).write_text(text, encoding="utf-8")
    sensors = experiment.pop("sensors", {})
    spec = load_identify_spec(
        {
            "mbdkit_identify": 1,
            "base": BASE,
            "sensors": sensors,
            "parameters": {"model.length": {"bounds": [0.5, 2.0]}},
            "experiments": {"a": {"file": str(folder / name), "observed": {"rod1.angle": column}, **experiment}},
        }
    )
    return read_experiment(spec, "a")


def rows(heading: str, row: Callable[[float, float], str], times: Sequence[float] = tuple(TIMES)) -> str:
    return heading + "\n" + "\n".join(row(t, a) for t, a in zip(times, ANGLES.tolist(), strict=True)) + "\n"


def comma(number: float) -> str:
    return f"{number:.12g}".replace(".", ",")


def clock(second: float) -> str:
    return f"23:59:{50 + second:05.2f}"


def comma_clock(second: float) -> str:
    return f"9:05:{second:05.2f}".replace(".", ",")


COUNTS = 4096 * 5 / np.pi  # per rad, behind a gear of 10
READ = {
    # NumPy's savetxt, with the headings in a comment
    "numpy": ("a.txt", rows("# time angle", lambda t, a: f"{t:.18e} {a:.18e}"), "angle", {}),
    # scripts in MATLAB and Octave
    "matlab": ("a.dat", rows("% rig 2, 3 May\n% t [s]\tphi [rad]", lambda t, a: f"{t}\t{a}"), "phi", {"time": "t"}),
    # rostopic echo -p
    "ros": (
        "a.csv",
        rows("%time,field.header.seq,field.position0", lambda t, a: f"{1.7e18 + 1e9 * t:.0f},7,{a}"),
        "field.position0",
        {"time": {"column": "time", "unit": "ns"}},
    ),
    # LabVIEW on a German system
    "labview": (
        "a.txt",
        rows("Zeit [s]\tWinkel [°]\tMoment [Nm]", lambda t, a: f"{comma(t)}\t{comma(np.degrees(a))}\t0,5"),
        "Winkel",
        {"time": "Zeit"},
    ),
    # phyphox, in both of its formats
    "phyphox": (
        "a.csv",
        rows('"Time (s)","Angle (rad)"', lambda t, a: f"{t:.9E},{a:.9E}"),
        "Angle (rad)",
        {"time": "Time (s)"},
    ),
    "phyphox-excel": (
        "a.csv",
        rows('"Time (s)";"Tilt up/down (deg)"', lambda t, a: f"{comma(t)};{comma(np.degrees(a))}"),
        "Tilt up/down",
        {"time": "Time"},
    ),
    # Logger Pro of Vernier
    "vernier": (
        "a.csv",
        rows("Latest: Time (s),Latest: Angle (rad)", lambda t, a: f"{t},{a}"),
        "Latest: Angle",
        {"time": "Latest: Time"},
    ),
    # Capstone of PASCO, whose headings end with the run
    "pasco": (
        "a.csv",
        rows("Time (s) Run #1;Angle (rad) Run #1", lambda t, a: f"{comma(t)};{comma(a)}"),
        "Angle (rad) Run #1",
        {"time": "Time (s) Run #1"},
    ),
    # Tracker, with the name of the mass above the headings
    "tracker": ("a.txt", rows("mass A\nt\tx\t\u03b8", lambda t, a: f"{t}\t0.1\t{a}"), "\u03b8", {"time": "t"}),
    # Saleae Logic
    "saleae": ("a.csv", rows("Time [s],Channel 0", lambda t, a: f"{t:.9f},{a}"), "Channel 0", {"time": "Time [s]"}),
    # Bioware of Kistler, with units below the headings
    "bioware": (
        "a.txt",
        rows("abs time (s)\tphi\ns\tdeg", lambda t, a: f"{t}\t{np.degrees(a):.12g}"),
        "phi",
        {"time": "abs time (s)"},
    ),
    # OpenSim, in degrees by its header
    "opensim": (
        "a.mot",
        rows(
            "motion\nversion=1\nnRows=8\ninDegrees=yes\nendheader\ntime\thip", lambda t, a: f"{t}\t{np.degrees(a):.12g}"
        ),
        "hip",
        {},
    ),
    # a microcontroller's serial monitor
    "arduino": (
        "a.csv",
        rows("millis,adc", lambda t, a: f"{1000 * t:.0f},{100 * a + 3:.9g}"),
        "adc",
        {"time": {"column": "millis", "unit": "ms"}, "sensors": {"rod1.angle": {"gain": 100.0, "offset": 3.0}}},
    ),
    # an encoder of 4096 counts whose counter has 12 bits
    "encoder": (
        "a.csv",
        rows("t_us;counts", lambda t, a: f"{1e6 * t:.0f};{(COUNTS * (a - 0.5) + 900) % 4096:.9g}"),
        {"column": "counts", "unwrap": 4096.0},
        {
            "time": {"column": "t_us", "unit": "us"},
            "sensors": {"rod1.angle": {"gain": COUNTS, "offset": 900.0 - 0.5 * COUNTS}},
        },
    ),
    # clock times, with a decimal comma
    "clock": (
        "a.csv",
        rows("Uhrzeit;Winkel (rad)", lambda t, a: f"{comma_clock(t)};{comma(a)}"),
        "Winkel",
        {"time": "Uhrzeit"},
    ),
    "iso": ("a.csv", rows("stamp,angle", lambda t, a: f"2025-03-01T{clock(t)}Z,{a}"), "angle", {"time": "stamp"}),
    # Unix times
    "unix": ("a.csv", rows("timestamp,angle", lambda t, a: f"{1.7e9 + t:.6f},{a}"), "angle", {"time": "timestamp"}),
    # a separator that would not be recognized by itself
    "stated": (
        "a.csv",
        rows("time;angle;note", lambda t, a: f"{t};{a};1,5"),
        "angle",
        {"separator": ";", "decimal": "."},
    ),
    # dfki ricmonk and acromonk: long names without units
    "ricmonk": (
        "a.csv",
        rows("meas_time,arm1_des_Ang_pos_store,arm1_meas_Ang_pos", lambda t, a: f"{t:.18e},0.0,{a:.18e}"),
        "arm1_meas_Ang_pos",
        {"time": "meas_time"},
    ),
}


@pytest.mark.parametrize("name", READ)
def test_files_of_laboratories_are_read_in_si_units(tmp_path: Path, name: str) -> None:
    file, text, column, experiment = READ[name]
    data = read(tmp_path, file, text, column, **experiment)
    signal = data.signals[0]
    sensor = signal.sensor
    assert data.time == pytest.approx(TIMES, abs=1e-6)
    assert (signal.values - sensor.offset) / sensor.gain == pytest.approx(ANGLES, abs=1e-9)


@pytest.mark.parametrize(
    ("file", "text", "experiment", "key", "sentence"),
    [
        ("a.lvm", "X_Value\tangle\n0\t1\n", {}, "file", "does not have the suffix of a table"),
        ("a.csv", "PK\x03\x04", {}, "file", "a workbook or an archive, not a text"),
        ("a.csv", "0,1\n1,2\n", {}, "file", "no headings"),
        (
            "a.csv",
            rows("time,angle [N]", lambda t, a: f"{t},{a}"),
            {},
            'observed."rod1.angle".unit',
            "the unit N of the column",
        ),
        ("a.csv", rows("time [%],angle", lambda t, a: f"{t},{a}"), {}, "time", "does not fit the unit s"),
        (
            "a.csv",
            rows("time,angle,angle", lambda t, a: f"{t},{a},{a}"),
            {},
            'observed."rod1.angle".column',
            "two columns",
        ),
        ("a.csv", rows("time,angle", lambda t, a: f"{t},{comma(a)}"), {}, "file", "3 cells, but there are 2 headings"),
        ("a.csv", rows("time,angle", lambda t, a: f"{clock(10 - t)},{a}"), {}, "time", "times should increase"),
        ("a.csv", rows("time;angle", lambda t, a: f"03.05.2025 12:00;{a}"), {}, "time", "is not a number"),
        ("a.csv", rows("t;angle", lambda t, a: f"{t};{a}"), {}, "time", "has no column 'time'"),
    ],
)
def test_other_files_are_refused_with_their_key(
    tmp_path: Path, file: str, text: str, experiment: dict[str, Any], key: str, sentence: str
) -> None:
    with pytest.raises(mbdkit.SpecError, match=sentence) as error:
        read(tmp_path, file, text, "angle", **experiment)
    assert error.value.key == f"experiments.a.{key}"


def test_an_angle_that_wraps_is_continued_and_said_and_a_fast_one_is_not(tmp_path: Path) -> None:
    turning = 2.0 + 0.75 * np.arange(40)  # rad, 30 rad in all
    times = 0.05 * np.arange(40)
    wrapped = "time,angle\n" + "".join(
        f"{t},{np.degrees(a) % 360.0:.12g}\n" for t, a in zip(times, turning, strict=True)
    )
    data = read(tmp_path, "w.csv", wrapped, {"column": "angle", "unit": "deg"})
    assert np.diff(data.signals[0].values) == pytest.approx(np.full(39, 0.75), abs=1e-9)
    assert data.notes == ("the column 'angle' of 'a' wraps in a range of 360 and was unwrapped",)
    fast = "time,angle\n" + "".join(f"{t},{4.0 * k}\n" for k, t in enumerate(times))  # more than half a turn a sample
    for text, column in ((fast, "angle"), (wrapped, {"column": "angle", "unit": "deg", "unwrap": False})):
        data = read(tmp_path, "f.csv", text, column)
        assert not data.notes
        assert np.max(np.abs(np.diff(data.signals[0].values))) > 3.0


def test_two_files_with_clocks_of_their_own_are_joined_by_the_time_of_day(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text(rows("zeit;rate [deg/s]", lambda t, a: f"12:00:{t + 0.1:05.2f};{np.degrees(a)}"))
    rate = {"column": "rate", "file": str(tmp_path / "m.csv"), "time": "zeit"}
    text = rows("time,angle", lambda t, a: f"12:00:{t:05.2f},{a}")
    data = read(tmp_path, "a.csv", text, "angle", observed={"rod1.angle": "angle", "rod1.angular_velocity": rate})
    angle, rates = (signal.values for signal in data.signals)
    assert data.time[np.isfinite(angle)] == pytest.approx(TIMES)
    assert data.time[np.isfinite(rates)] == pytest.approx(TIMES + 0.1)
    assert rates[np.isfinite(rates)] == pytest.approx(ANGLES)
