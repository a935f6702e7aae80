"""Tables of measured data with the faults of real files: read as OpenSim and ezc3d read them, or refused.

Numbers are drawn, and written with faults. What is read must equal what was drawn or what the witness reads.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tests.inverse_dynamics.c3d_files import DEC, INTEL, MIPS, Convention, Plate, c3d_bytes

from mbdkit.base.errors import MbdkitError
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.measured import si_values, times_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ObservedColumn, TimeColumn

from .attack import LONGEST_MESSAGE, Attack, in_child
from .opensim_attacks import is_missing

Random = np.random.Generator
Columns = dict[str, np.ndarray]
"""Values in SI units by heading, gaps are nan; the times are called ``time``."""

LABELS = ("hip", "knee_r", "L.ASIS", "Subject:LKNE", "Marker 1", "*12", "é", "x" * 40)
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}


def pick(random: Random, values: Any) -> Any:
    """Return one of some values."""
    return values[int(random.integers(len(values)))]


def ours(path: Path, names: list[str] | None, unit: str) -> Columns:
    """Return columns of a table in the SI unit `unit`, as inverse dynamics reads them; all if `names` is None."""
    table = read_table(path, "motion.file")
    if names is None:
        names = ["time", *(name for name in table.headings if name and name.lower() not in ("time", "frame#"))]
    return {
        name: times_of(table, TimeColumn(), "motion.time")
        if name == "time"
        else si_values(ObservedColumn(column=name), table, unit, "motion.columns")
        for name in names
    }


def ours_in_child(path: Path, names: list[str] | None, unit: str) -> Columns | str:
    """Return `ours`, or the message of the error, computed in a process that a damaged file may crash."""
    ending = in_child(_ours_or_message, path, names, unit)
    if ending.exit_status != 0:
        raise RuntimeError(f"the process ended with {ending.exit_status}: {ending.errors[-1000:]}")
    value: Columns | str = ending.value
    return value


def _ours_or_message(path: Path, names: list[str] | None, unit: str) -> Columns | str:
    try:
        return ours(path, names, unit)
    except MbdkitError as error:
        return str(error)


def compare(
    path: Path, truth: Columns | None, unit: str, witness: Callable[[str], Columns], *, must_refuse: bool = True
) -> list[str]:
    """Return what differs from both the drawn values (None if a fault destroyed their meaning) and the witness.

    If neither exists, the file must be refused, unless `must_refuse` is false.
    """
    theirs = in_child(witness, str(path)).value
    wanted = theirs if truth is None else truth
    read = ours_in_child(path, None if wanted is None else [*wanted], unit)
    if isinstance(read, str):
        bad = len(read) > LONGEST_MESSAGE or "\n" in read.strip() or "bug in mbdkit" in read
        return [f"the message is not a sentence: {read[:300]!r}"] * bad
    if wanted is None:
        return ["it was read, although the witness does not read it and its numbers have no meaning"] * must_refuse
    problems = []
    for name, values in read.items():
        close = [
            of is not None
            and name in of
            and of[name].shape == values.shape
            and np.allclose(values, of[name], rtol=1e-6, atol=1e-9, equal_nan=True)
            for of in (truth, theirs)
        ]
        if not any(close):
            problems.append(f"{name}: {values[:5]} instead of {wanted[name][:5]}")
    return problems


class Text(NamedTuple):
    """A file as text, with the drawn columns; None if a fault destroyed the meaning of the numbers."""

    text: str
    truth: Columns | None


def faulty(random: Random, text: str, truth: Columns | None, row_start: int, order: list[str]) -> Text:
    """Return a file with faults that any text may have.

    Rows of numbers begin with the line `row_start`; `order` names the columns, those without a name are empty.
    """
    lines = text.split("\n")
    last = len(lines) - 2
    fault = int(random.integers(12))
    row = int(random.integers(row_start, last + 1))
    cells = lines[row].split("\t")
    at = int(random.integers(1, len(cells)))
    word = ("1,5", "1_5", "abc", "inf", "1e999", "#REF!", "1.5.2", "0x1p3", "12:30", "\u0663")
    if fault == 0:
        cells[at] = pick(random, word)
        lines[row], truth = "\t".join(cells), None if order[at] else truth  # columns without a name are not used
    elif fault == 1:  # a row without its end
        lines[row] = "\t".join(cells[:at])
        for name in order[at:] if truth else ():
            if name:
                assert truth is not None
                truth[name][row - row_start] = np.nan
    elif fault == 2:
        lines[row] += "\t7.5"
        truth = None
    elif fault == 3 and last > row_start:  # times that do not increase
        lines[row_start], lines[last], truth = lines[last], lines[row_start], None
    elif fault == 4:
        lines = [*lines[: row + 1], "", *lines[row + 1 :]]
    elif fault == 5:
        lines = [line.replace("\t", " ") for line in lines]
    elif fault == 6:
        lines[row] += "\t"
    elif fault == 7:
        lines[row], truth = lines[row].replace(".", ","), None
    elif fault == 8:
        at = row_start - 1 - int(random.integers(2))
        truth = truth if not lines[at] else None
        del lines[at]
    end = pick(random, ("\n", "\r\n", "\n", "\n"))
    return Text(("\ufeff" if random.random() < 0.1 else "") + end.join(lines), truth)


def drawn_rows(random: Random, count: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return times (T,), values (T, count), and the texts of gaps."""
    frames = int(random.integers(3, 12))
    first, rate = int(random.integers(0, 200)), pick(random, (50.0, 100.0, 120.0, 1000.0))
    values = np.round(random.uniform(-1000, 1000, (frames, count)), int(random.integers(0, 7)))
    gap = pick(random, ([""], ["nan"], ["NaN"], ["-nan"]))
    values[random.random(values.shape) < pick(random, (0.0, 0.1))] = np.nan
    return np.round((first + np.arange(frames)) / rate, 6), values, gap


def shown_number(value: float, gap: str) -> str:
    return gap if np.isnan(value) else repr(float(value))


def motion_file(random: Random) -> Text:
    """Return a .mot or .sto file of angles."""
    count = int(random.integers(1, 5))
    names = [str(pick(random, LABELS)) for _ in range(count)]
    time, values, (gap,) = drawn_rows(random, count)
    says = pick(random, ("inDegrees=yes", "inDegrees=no", "inDegrees = yes", "inDegrees=Yes", "inDegrees=true", "",
                         "indegrees=yes", "inDegrees=1", "inDegrees=yes "))  # fmt: skip
    version = pick(random, ("version=1", "version=3", ""))
    head = ["motion", version, f"nRows={len(time)}", f"nColumns={count + 1}", says]
    if random.random() < 0.15:
        head = ["name motion", f"datacolumns {count + 1}", f"datarows {len(time)}", "range 0 1", says]
    head = [line for line in head if line]
    rows = [
        "\t".join([repr(float(t)), *(shown_number(x, gap) for x in row)]) for t, row in zip(time, values, strict=True)
    ]
    text = "\n".join([*head, "endheader", "\t".join(["time", *names]), *rows, ""])
    yes = says.replace(" ", "").lower() == "indegrees=yes" and says.startswith("inDegrees")
    factor = np.pi / 180 if yes or (not says and not version) or (not says and head[0] == "name motion") else 1.0
    known = says == "" or says.replace(" ", "").split("=")[1].lower() in ("yes", "no")
    truth: Columns | None = {"time": time} | {name: factor * values[:, k] for k, name in enumerate(names)}
    if len({*names}) < count or not known or says.startswith("indegrees"):
        truth = None
    return faulty(random, text, truth, len(head) + 2, ["time", *names])


def motion_witness(path: str) -> Columns:
    """Return the columns of a .mot file as OpenSim reads them, in radians."""
    import opensim

    opensim.Logger.setLevelString("off")
    table, store = opensim.TimeSeriesTable(path), opensim.Storage(path)
    factor = np.pi / 180 if store.isInDegrees() else 1.0
    matrix = table.getMatrix().to_numpy()
    labels = [str(name) for name in table.getColumnLabels()]
    assert len({*labels}) == len(labels)
    return {"time": np.array(table.getIndependentColumn())} | {
        name: factor * matrix[:, k] for k, name in enumerate(labels)
    }


def marker_file(random: Random) -> Text:
    """Return a .trc file."""
    count = int(random.integers(1, 5))
    names = [str(pick(random, LABELS)) for _ in range(count)]
    if random.random() < 0.1:
        names[int(random.integers(count))] = ""
    time, values, (gap,) = drawn_rows(random, 3 * count)
    unit = str(pick(random, ("m", "mm", "cm", "mm", "mm", "furlong", "")))
    key = str(pick(random, ("Units", "Units", "Units", "Units ", "units", "UNITS", "")))
    number = count if random.random() < 0.9 else count + int(random.integers(-1, 2))
    keys = [
        "DataRate",
        "CameraRate",
        "NumFrames",
        "NumMarkers",
        key,
        "OrigDataRate",
        "OrigDataStartFrame",
        "OrigNumFrames",
    ]
    given = ["100", "100", str(len(time)), str(number), unit, "100", "1", str(len(time))]
    between = "\t" if random.random() < 0.1 else "\t\t\t"
    axes = "\t".join(f"{axis}{k + 1}" for k in range(count) for axis in pick(random, (*["XYZ"] * 19, "YZX")))
    head = ["PathFileType\t4\t(X/Y/Z)\tm.trc", "\t".join(keys), "\t".join(given),
            f"Frame#\tTime\t{between.join(names)}{'' if between == chr(9) else chr(9) * 2}", f"\t\t{axes}"]  # fmt: skip
    blank = [""] if random.random() < 0.7 else []
    first = int(random.integers(0, 100))
    rows = [
        "\t".join([str(first + k), repr(float(t)), *(shown_number(x, gap) for x in row)])
        for k, (t, row) in enumerate(zip(time, values, strict=True))
    ]
    text = "\n".join([*head, *blank, *rows, ""])
    factor = UNITS.get(unit, np.nan)
    columns: Columns = {"time": time}
    for k, name in enumerate(names):
        for axis in range(3):
            if name:
                columns[f"{name}.{'xyz'[axis]}"] = factor * values[:, 3 * k + axis]
    truth: Columns | None = columns
    if unit not in UNITS or not key or number != count or len({*names}) < count or "Y1" in axes.split("\t")[:1]:
        truth = None
    if between == "\t" and "" in names:
        truth = None
    if any(axes.split("\t")[3 * k] == f"Y{k + 1}" for k in range(count)):
        truth = None
    order = ["", "time", *(f"{name}.{axis}" if name else "" for name in names for axis in "xyz")]
    return faulty(random, text, truth, len(head) + len(blank), order)


def marker_witness(path: str) -> Columns:
    """Return the columns of a .trc file as OpenSim reads them, in metres."""
    import opensim

    opensim.Logger.setLevelString("off")
    table = opensim.TimeSeriesTableVec3(path)
    factor = UNITS[table.getTableMetaDataString("Units").strip()]
    labels = [str(name) for name in table.getColumnLabels()]
    assert len({*labels}) == len(labels)
    columns = {"time": np.array(table.getIndependentColumn())}
    for k, label in enumerate(labels):
        column = np.array([table.getRowAtIndex(i)[k].to_numpy() for i in range(table.getNumRows())])
        columns |= {f"{label}.{axis}": factor * column[:, j] for j, axis in enumerate("xyz")}
    return columns


def _mot(random: Random, folder: Path) -> list[str]:
    if is_missing("mot", "opensim"):
        return []
    path = folder / str(pick(random, ("m.mot", "m.sto")))
    text, truth = motion_file(random)
    path.write_bytes(text.encode())
    return compare(path, truth, "rad", motion_witness)


def _trc(random: Random, folder: Path) -> list[str]:
    if is_missing("trc", "opensim"):
        return []
    text, truth = marker_file(random)
    (folder / "m.trc").write_bytes(text.encode())
    return compare(folder / "m.trc", truth, "m", marker_witness)


def c3d_witness(path: str) -> Columns:
    """Return the markers of a C3D file as ezc3d reads them, in metres."""
    import ezc3d

    file = ezc3d.c3d(path)
    points, about = file["data"]["points"], file["parameters"]["POINT"]
    factor = UNITS[about["UNITS"]["value"][0].strip()]
    rate, first = file["header"]["points"]["frame_rate"], file["header"]["points"]["first_frame"]
    # without markers, rows are samples of the plates, which ezc3d does not give times
    columns = {"time": (first + np.arange(points.shape[2])) / rate} if points.shape[1] else {}
    for k, label in enumerate(about["LABELS"]["value"]):
        columns |= {f"{label.strip()}.{axis}": factor * points[j, k] for j, axis in enumerate("xyz")}
    return columns


def _c3d(random: Random, folder: Path) -> list[str]:
    """Compare the markers and the forces of a plate."""
    if is_missing("c3d", "ezc3d"):
        return []
    frames, count, samples = int(random.integers(2, 12)), int(random.integers(0, 5)), int(pick(random, (1, 4, 10)))
    unit, processor = str(pick(random, ("mm", "mm", "m", "cm"))), pick(random, (INTEL, DEC, MIPS))
    rate = float(pick(random, (50, 100, 120, 200)))
    size = 1.0 / UNITS[unit]
    how = Convention(
        processor=processor,
        scale=float(pick(random, (0.0, 0.0, 1e-4, 1e-3))) * size,
        unit=unit,
        first_frame=int(pick(random, (1, 1, 17, 3000))),
        analog_scale=float(pick(random, (1.0, 0.5, 0.05))),
        analog_offset=int(pick(random, (0, 0, 0, 2048))),
    )
    names = [f"M{k}" if random.random() < 0.8 else str(pick(random, ("C7", "L.ASIS", "S:LKNE"))) for k in range(count)]
    markers = {name: size * random.uniform(-1, 1, (frames, 3)) for name in names}
    for values in markers.values():
        if how.scale:
            values[:] = np.round(values / how.scale) * how.scale
        values[random.random(frames) < 0.1] = np.nan
    plates = []
    if random.random() < 0.5 or not markers:
        channels = np.round(random.uniform(-300, 300, (frames * samples, 6)))
        channels[:, 2] = np.round(random.uniform(100, 900, frames * samples))
        channels[:, 3:] = np.round(random.uniform(-300, 300, (frames * samples, 3))) * 200.0
        corners = size * (
            np.array([[0.3, 0.2, 0], [-0.3, 0.2, 0], [-0.3, -0.2, 0], [0.3, -0.2, 0]]) + np.array([1, 2, 0])
        )
        plates = [Plate(corners, np.array([0.0, 0.0, -0.04 * size]), channels)]
    content = bytearray(c3d_bytes(markers, rate, how, plates, samples))
    damaged = random.random() < 0.25
    if damaged:
        if random.random() < 0.5:
            del content[int(random.integers(1, len(content))) :]
        else:
            content[int(random.integers(min(len(content), 1536)))] ^= 1 << int(random.integers(8))
    path = folder / "m.c3d"
    path.write_bytes(content)
    if damaged:  # the numbers may have changed; it must be read as by ezc3d, or refused
        return compare(path, None, "m", _unreadable if processor == MIPS else c3d_witness, must_refuse=False)
    per_row = 1 if markers else samples
    rows = frames * per_row
    first = how.first_frame - 1 if markers else 0
    truth: Columns = {"time": (first + np.arange(rows)) / (rate * per_row)}
    for name, values in markers.items():
        truth |= {f"{name}.{axis}": values[:, j] / size for j, axis in enumerate("xyz")}
    problems = compare(path, truth, "m", c3d_witness)
    if plates and not how.analog_offset:
        step = samples if markers else 1
        force = plates[0].channels[::step, :3]  # the axes of the plate, by its corners, are those of the laboratory
        wanted = {f"plate1.force.{axis}": force[:, j] for j, axis in enumerate("xyz")}
        read = ours(path, [*wanted], "N")
        problems += [f"{name}: {read[name][:4]} instead of {wanted[name][:4]}" for name in wanted
                  if not np.allclose(read[name], wanted[name], rtol=1e-5, atol=0.6)]  # fmt: skip
    return problems


def _unreadable(path: str) -> Columns:
    """Stand for ezc3d, which does not read files of MIPS processors."""
    raise ValueError(path)


ATTACKS = (
    Attack("mot", "motion files with faults: read as by OpenSim, or refused in a sentence", 500, _mot),
    Attack("trc", "marker files with faults: read as by OpenSim, or refused in a sentence", 500, _trc),
    Attack("c3d", "C3D files of several makers, and damaged ones: read as by ezc3d, or refused", 500, _c3d),
)
