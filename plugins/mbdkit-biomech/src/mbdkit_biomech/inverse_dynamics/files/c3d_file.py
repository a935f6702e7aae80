"""Columns of C3D files: markers and force plates, in the conventions of Vicon, Qualisys, Motion Analysis and others.

The package ezc3d decodes the files: integers or floating-point numbers of Intel and DEC processors, scales and offsets
of analog channels, and calibration matrices. It refuses files of MIPS processors; the byte order of such files is
converted here first. It reads some damaged files beyond the end of its memory, and thereby ends its process: files are
read in a process of their own, which costs 0.1 s.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.text import shown
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable

#: A plate counts as unloaded if the force along its normal [N] is below this.
#:
#: The point of application is then the quotient of two small numbers.
UNLOADED = 10.0


#: Largest normal force [N] of a plate that counts as its offset.
#:
#: In frames with a larger force, somebody probably stands on the plate, although the file names them as unloaded.
LARGEST_OFFSET = 50.0


#: Time after which the process that reads a file is ended [s]; files of 128 MB take some seconds.
LONGEST = 300.0


#: Address space of this process [bytes], and what a byte of the file adds; damaged headers announce any number of
#: samples.
MEMORY = 4 * 2**30, 32


#: Coordinates of plates are in mm if a file states no unit and the corners of a plate are farther apart than this.
LARGEST_PLATE = 20.0


class _Columns(NamedTuple):
    """Headings and values of a table.

    Parameters
    ----------
    headings
        ``time``, ``LABEL.x`` and so on for each marker, and ``plate1.force.x``, ``plate1.point.x``, ``plate1.torque.x``
        and so on for each force plate. The headings of markers without a label are empty.
    values
        (T, columns); nan where a marker was not seen, or where a plate has no point of application.
    units
        Units of the coordinates and points by heading; empty if the file states none.
    remark
        Reason why there are no force plates, as a clause; empty if nothing is missing.
    """

    headings: list[str]
    values: np.ndarray
    units: dict[str, str]
    remark: str = ""


def read_c3d(path: Path, most_cells: int, *, channels: bool = False) -> MeasuredTable | None:
    """Read the points and force plates of a C3D file; None if they have more cells than `most_cells`.

    Forces and torques of plates are those in the file, in the frame of the laboratory. They are given at the times of
    the camera frames or, in files without markers, at all samples. If the file names frames in which plates are
    unloaded (FORCE_PLATFORM:ZERO), the mean force and moment in these frames are subtracted. Forces and torques are set
    to zero where the plate is unloaded (`UNLOADED`). With `channels`, the table has the analog channels by their labels
    instead, at their own rate.

    Raises
    ------
    SpecError
        If the file is not a C3D file, or has neither markers nor force plates.
    MbdkitError
        If ezc3d is not installed.
    """
    if find_spec("ezc3d") is None:
        raise MbdkitError(
            "reading C3D files needs the package ezc3d: install it with `pip install mbdkit[c3d]`, or export the "
            "markers as .trc"
        )
    with TemporaryDirectory() as folder:
        columns = Path(folder) / "columns.npz"
        places = [*map(str, sys.path)]
        program = f"import sys; sys.path[:] = {places!r}; from {__name__} import write_columns; write_columns()"
        arguments = map(str, (path.absolute(), columns, most_cells, int(channels)))
        command = [sys.executable, "-c", program, *arguments]
        alone = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # whose threads take address space
        none = subprocess.DEVNULL
        try:
            code = subprocess.run(command, stdin=none, stdout=none, stderr=none, env=alone, timeout=LONGEST).returncode
        except subprocess.TimeoutExpired:
            raise _unreadable(path, f"its reader does not end in {LONGEST:g} s") from None
        if not columns.exists():
            by = f" by the signal {signal.Signals(-code).name}" if code < 0 else ""
            raise _unreadable(path, f"its reader ended{by}, as it does for some damaged files")
        with np.load(columns) as arrays:
            about, values = json.loads(str(arrays["about"])), arrays["values"]
    if "error" in about:
        raise SpecError(about["error"], file=path)
    return MeasuredTable(str(path), cells=values.tolist(), **about) if about else None


def write_columns() -> None:
    """Write the columns of a C3D file, or the reason why there are none, to an archive of NumPy; this is the program of
    the process that reads the file, with the arguments of the command line.
    """
    path, target, most_cells, channels = Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:])
    with suppress(ImportError, OSError, ValueError):  # Windows and macOS have no such limit
        import resource

        most = MEMORY[0] + MEMORY[1] * path.stat().st_size
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        columns = _columns_of(path, most_cells, channels=bool(channels))
        about = {} if columns is None else columns._asdict()
    except SpecError as error:
        about = {"error": error.message}
    values = about.pop("values", np.zeros(0))
    with open(f"{target}.part", "wb") as file:
        np.savez(file, about=json.dumps(about), values=values)
    os.replace(f"{target}.part", target)


def _unreadable(path: Path, why: str) -> SpecError:
    return SpecError(f"this is not a C3D file that can be read: {why}", file=path)


def _columns_of(path: Path, most_cells: int, *, channels: bool) -> _Columns | None:
    try:
        return _decoded(path, most_cells, channels=channels)
    except KeyError as error:
        raise _unreadable(path, f"it has no {shown(str(error))}") from None
    except (OSError, RuntimeError, ValueError, IndexError, TypeError, MemoryError, struct.error) as error:
        raise _unreadable(path, shown(str(error) or type(error).__name__)) from None


def _decoded(path: Path, most_cells: int, *, channels: bool) -> _Columns | None:
    import ezc3d

    remark = ""
    with _readable(path, path.read_bytes()) as readable:
        begin, end = struct.unpack_from("<2H", readable.read_bytes(), _FRAMES)
        try:
            file = ezc3d.c3d(str(readable), extract_forceplat_data=True)
        except RuntimeError as error:
            file = ezc3d.c3d(str(readable))  # the file is valid, but the description of its plates is not
            remark = f"its force plates cannot be read: {shown(' '.join(str(error).split()))}"
    if channels:
        return _channels(file, most_cells)
    points = file["data"]["points"]  # (4, markers, frames)
    if points.size > most_cells:
        return None
    about = file["parameters"]["POINT"]
    parts = sorted((name for name in about if re.fullmatch(r"LABELS\d*", name)), key=lambda name: (len(name), name))
    # each part of the list has up to 255 labels
    labels = [str(label).strip() for name in parts for label in about[name]["value"]]
    labels = [*labels, *[""] * points.shape[1]][: points.shape[1]]
    rate, first = float(file["header"]["points"]["frame_rate"]), int(file["header"]["points"]["first_frame"])
    frames, plates = points.shape[2], file["data"].get("platform", ())
    if not any(labels):
        if not plates:
            why = f"; {remark}" if remark else ""
            raise SpecError(f"this C3D file has neither markers nor force plates{why}", file=path)
        # programs of force plates may write a frame rate of 0; without markers, all samples are rows
        rate, frames = float(file["parameters"]["ANALOG"]["RATE"]["value"][0]), plates[0]["force"].shape[1]
        first, points = 0, np.zeros((4, 0, frames))
        labels = []
    if frames < end - begin + 1 or not frames:  # ezc3d reads what there is
        raise SpecError(f"this C3D file ends after {frames} of its {max(0, end - begin + 1)} frames", file=path)
    if not rate > 0:
        raise SpecError(f"this C3D file has a rate of {rate:g} Hz, from which times do not follow", file=path)
    headings = ["time", *(f"{label}.{axis}" if label else "" for label in labels for axis in "xyz")]
    values = [(first + np.arange(frames)) / rate, *points[:3].transpose(1, 0, 2).reshape(-1, frames)]
    unit = str(next(iter(about.get("UNITS", {"value": ()})["value"]), "")).strip()
    if not unit and any(np.ptp(plate["corners"]) > LARGEST_PLATE for plate in plates):
        unit = "mm"
    if plates and _has_negative_offsets(file["parameters"].get("ANALOG", {})):
        plates = ()
        remark = "its analog channels have negative offsets, which the package ezc3d takes for positive ones"
    for number, plate in enumerate(plates, 1):
        if not frames or plate["force"].shape[1] < frames:
            continue
        samples = plate["force"].shape[1] // frames
        for quantity, columns in _of_plate(plate, samples, unit, _baseline(file, number)).items():
            headings += [f"plate{number}.{quantity}.{axis}" for axis in "xyz"]
            values += list(columns)
    places = [heading for heading in headings[1:] if heading and ".force." not in heading and ".torque." not in heading]
    return _Columns(headings, np.column_stack(values), dict.fromkeys(places, unit) if unit else {}, remark)


def _channels(file: Any, most_cells: int) -> _Columns | None:
    """Return the analog channels at their times; their constant offsets may be wrong, see `_has_negative_offsets`."""
    samples, about, header = file["data"]["analogs"][0], file["parameters"]["ANALOG"], file["header"]["points"]
    if samples.size > most_cells:
        return None
    rate, first = float(about["RATE"]["value"][0]), int(header["first_frame"]) / float(header["frame_rate"])
    if not rate > 0:
        raise ValueError(f"its analog channels have a rate of {rate:g} Hz")
    labels = [str(label).strip() for name, one in about.items() if name.startswith("LABELS") for label in one["value"]]
    labels = [*labels, *[""] * len(samples)][: len(samples)]
    return _Columns(["time", *labels], np.column_stack([first + np.arange(samples.shape[1]) / rate, *samples]), {})


def _has_negative_offsets(about: Any) -> bool:
    """Return whether signed analog channels have negative offsets, whose sign ezc3d loses."""
    given = next(iter(about.get("FORMAT", {"value": ()})["value"]), "")
    offsets = [value for name in about if re.fullmatch(r"OFFSET\d*", name) for value in about[name]["value"]]
    return "UNSIGNED" not in str(given).upper() and any(value < 0 for value in offsets)


def _baseline(file: Any, number: int) -> slice:
    """Return the samples of a plate in the frames of FORCE_PLATFORM:ZERO, which begin with 1; empty without such
    frames.

    It is also empty for plates whose points of application are not computed from force and moment: plates of type 1,
    and those with a polynomial that corrects the points.
    """
    about, frames = file["parameters"]["FORCE_PLATFORM"], file["data"]["points"].shape[2]
    first, last = [*(int(frame) for frame in about.get("ZERO", {"value": ()})["value"]), 0, 0][:2]
    has_polynomial = len(about.get("FPCOPPOLY", {"value": ()})["value"]) > 0
    if not 1 <= first <= last <= frames or has_polynomial or about["TYPE"]["value"][number - 1] == 1:
        return slice(0, 0)
    samples = file["data"]["analogs"].shape[2] // frames
    return slice(samples * (first - 1), samples * last)


def _without_baseline(plate: Any, normal: np.ndarray, baseline: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return force, point of application and free torque of a plate, each (3, R), without its offset.

    The force F and the moment M about the middle of the surface minus their means in `baseline` give the point
    n x M / (n F) and the torque M + F x point, with the normal n.
    """
    given = plate["force"], plate["center_of_pressure"], plate["Tz"]
    offset, turn = (np.mean(plate[name][:, baseline], axis=1, keepdims=True) for name in ("force", "moment"))
    if abs(normal @ offset[:, 0]) > LARGEST_OFFSET:
        return given
    force, moment = plate["force"] - offset, plate["moment"] - turn
    with np.errstate(divide="ignore", invalid="ignore"):
        point = np.cross(normal, moment, axisb=0).T / (normal @ force)
    torque = moment + np.cross(force, point, axis=0)
    return force, point + np.mean(plate["corners"], axis=1, keepdims=True), torque


def _of_plate(plate: Any, samples: int, unit: str, baseline: slice) -> dict[str, np.ndarray]:
    """Return force [N], point of application [unit] and free torque [N m] of a plate, each (3, T).

    Of the `samples` in each frame, the first is used. The plate is unloaded in the samples `baseline`.
    """
    corners = plate["corners"]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    normal /= np.linalg.norm(normal) or 1.0
    values = plate["force"], plate["center_of_pressure"], plate["Tz"]
    if baseline.stop:
        values = _without_baseline(plate, normal, baseline)
    force, point, torque = (value[:, ::samples].copy() for value in values)
    unloaded = ~(np.abs(normal @ force) >= UNLOADED)
    force[:, unloaded], torque[:, unloaded], point[:, unloaded] = 0.0, 0.0, np.nan
    stated = str(plate["unit_moment"]).replace(" ", "").lower()
    in_metres = stated in ("nm", "n*m", "n.m") and not (plate["unit_position"] == "m" and unit == "mm")
    return {"force": force, "point": point, "torque": torque if in_metres else 1e-3 * torque}


_BLOCK = 512  #: Size of a block [bytes].
_FRAMES = 6  #: Position of the numbers of the first and the last frame in the header.
_INTEL, _MIPS = 84, 86  #: Codes of processors in the file.


@contextmanager
def _readable(path: Path, content: bytes) -> Iterator[Path]:
    """Yield the file or, for a file of a MIPS processor, a temporary copy in Intel byte order."""
    first = _BLOCK * (max(content[0], 1) - 1) if content else 0
    _require_sound_parameters(content, first)
    if content[first + 3] != _MIPS:
        yield path
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(_in_order_of_intel(content, first))
        yield copy


def _require_sound_parameters(content: bytes, first: int) -> None:
    """Raise ValueError if a group or parameter is not within the file, or if analog channels have no scale or offset;
    ezc3d would read memory beyond its end.

    Parameters
    ----------
    first
        Position of the parameters in the file.
    """
    order = ">h" if content[first + 3 : first + 4] == bytes([_MIPS]) else "<h"
    analog, results = 0, []
    for name, group, place, offset in _entries(content, first, order):
        end = place + offset if offset else len(content)
        if name == b"ANALOG" and group < 0:
            analog = -group
        if group > 0:
            size, count = struct.unpack_from("bB", content, place + 2)
            shape = content[place + 4 : place + 4 + count]
            if size not in (-1, 1, 2, 4) or count > _MOST_AXES:
                raise ValueError("a parameter has an unknown type")
            if place + 4 + count + abs(size) * math.prod(shape) > end:
                raise ValueError("a parameter is longer than its place in the file")
            values = struct.unpack_from(order, content, place + 4 + count)[0] if size == 2 else 0
            results.append((group, name.rstrip(b"0123456789"), values, math.prod(shape)))
    channels = next((value for group, name, value, _ in results if (group, name) == (analog, b"USED")), 0)
    for wanted in (b"SCALE", b"OFFSET"):
        if channels > sum(count for group, name, _, count in results if (group, name) == (analog, wanted)):
            raise ValueError(f"some of its {channels} analog channels have no {wanted.decode().lower()}")


def _entries(content: bytes, first: int, order: str) -> Iterator[tuple[bytes, int, int, int]]:
    """Yield the groups and parameters of a file: name, number of the group (negative for a group itself), and the
    position of the offset to the next entry with this offset, which is 0 in the last one.
    """
    place = first + 4
    while content[place]:  # length of the name; 0 at the end
        length, group = struct.unpack_from("2b", content, place)
        name = content[place + 2 : place + 2 + abs(length)]
        place += 2 + abs(length)
        (offset,) = struct.unpack_from(order, content, place)
        yield name, group, place, offset
        if offset == 0:
            return
        if not 0 < offset <= len(content) - place:
            raise ValueError("the parameters are damaged")
        place += offset


_MOST_AXES = 7  #: Largest number of axes of a parameter.


def _in_order_of_intel(content: bytes, first: int) -> bytes:
    """Return a file of a MIPS processor in Intel byte order, without the events in its header.

    Parameters
    ----------
    first
        Position of the parameters in the file.
    """
    numbers, scale, more, rate = (struct.unpack_from(f">{kind}", content, at) for kind, at in _HEADER)
    header = b"".join(struct.pack(f"<{kind}", *given) for (kind, _), given in
                      zip(_HEADER, (numbers, scale, more, rate), strict=True))  # fmt: skip
    result = bytearray(content)
    result[:_BLOCK] = (content[:2] + header).ljust(_BLOCK, b"\0")
    result[first + 3] = _INTEL
    for _, group, place, offset in _entries(content, first, ">h"):
        result[place : place + 2] = struct.pack("<h", offset)
        if group > 0:
            size, count = struct.unpack_from("bB", content, place + 2)
            begin = place + 4 + count
            length = abs(size) * int(np.prod(list(content[place + 4 : begin]), dtype=int))
            result[begin : begin + length] = _swapped(content[begin : begin + length], abs(size))
    data = _BLOCK * (more[0] - 1)
    result[data:] = _swapped(content[data:], 4 if scale[0] < 0 else 2)
    return bytes(result)


#: Formats of the numbers in the header, and their positions in bytes.
#:
#: The numbers are those of points and analog samples, first and last frame and largest gap; the scale; the first block
#: of data and the number of analog samples per frame; the frame rate.
_HEADER = (("5h", 2), ("f", 12), ("2h", 16), ("f", 20))


def _swapped(content: bytes, size: int) -> bytes:
    """Return bytes with the byte order of each number of `size` bytes reversed."""
    whole = len(content) // size * size
    return np.frombuffer(content[:whole], np.uint8).reshape(-1, size)[:, ::-1].tobytes() + content[whole:]
