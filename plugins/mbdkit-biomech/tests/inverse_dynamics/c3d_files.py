"""Writes C3D files byte by byte, as the public description of the format (c3d.org) defines them.

It shares no code with the package that reads them: processors, number formats, scales and offsets are chosen as
different makers of motion capture systems choose them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

INTEL, DEC, MIPS = 84, 85, 86


@dataclass
class Plate:
    """A force plate.

    Parameters
    ----------
    corners
        (4, 3) corners in the laboratory, in the order +x+y, -x+y, -x-y, +x-y of the plate.
    origin
        (3,) from the sensor to the middle of the surface, in the plate's frame, whose z axis points down.
    channels
        (T * samples, 6) values of its channels; 8 channels for type 3.
    matrix
        (6, 6) calibration matrix of a plate of type 4; None for other types.
    kind
        Type of the plate: 1 to 4.
    zero
        First and last frame of the baseline, of the first plate for all of them.
    """

    corners: np.ndarray
    origin: np.ndarray
    channels: np.ndarray
    matrix: np.ndarray | None = None
    kind: int = 2
    zero: tuple[int, int] = (1, 0)

    @property
    def scales(self) -> np.ndarray:
        """Scales of the channels: moments in N mm are larger numbers than forces."""
        return {1: np.array([1.0] * 5 + [200.0]), 3: np.ones(8)}.get(self.kind, np.repeat([1.0, 200.0], 3))


@dataclass
class Convention:
    """How a maker writes numbers.

    Parameters
    ----------
    processor
        Order of bytes and format of floating-point numbers.
    scale
        Step of the integers of points [unit]; 0 for floating-point numbers.
    analog_scale, analog_offset
        Scale (for all channels) and offset of the analog channels.
    analog_rate
        Rate of the analog channels [Hz]; by default, it follows from that of the frames.
    """

    processor: int = INTEL
    scale: float = 0.0
    analog_scale: float = 1.0
    analog_offset: int = 0
    unit: str = "mm"
    first_frame: int = 1
    analog_rate: float | None = None
    _order: str = field(init=False)

    def __post_init__(self) -> None:
        self._order = ">" if self.processor == MIPS else "<"

    def integers(self, values: Any) -> bytes:
        """Return 16-bit integers."""
        return np.asarray(values).astype(f"{self._order}i2").tobytes()

    def floats(self, values: Any) -> bytes:
        """Return 32-bit numbers; those of DEC have another exponent and swapped halves."""
        values = np.atleast_1d(np.asarray(values, dtype=float))
        if self.processor == DEC:
            return (4.0 * values).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes()
        return values.astype(f"{self._order}f4").tobytes()


def c3d_bytes(
    markers: Mapping[str, np.ndarray], rate: float, how: Convention, plates: Sequence[Plate] = (), samples: int = 1
) -> bytes:
    """Return a file with markers (T, 3), where nan marks a point that no camera saw, and plates with some `samples` a
    frame.
    """
    frames = len(next(iter(markers.values()))) if markers else len(plates[0].channels) // samples
    points = np.stack(list(markers.values()), axis=1) if markers else np.zeros((frames, 0, 3))
    unseen = np.isnan(points[..., :1])
    fourth = np.where(unseen, -1.0, 0.0)
    scale = how.scale or 1.0
    block = np.concatenate([np.where(unseen, 0.0, np.nan_to_num(points)) / (how.scale or 1.0), fourth], axis=2)
    analog = [plate.channels.reshape(frames, -1) for plate in plates]
    channels = sum(plate.channels.shape[1] for plate in plates)
    if plates:
        by_sample = np.concatenate([one.reshape(frames, samples, -1) for one in analog], axis=2)
        steps = np.tile(how.analog_scale * np.concatenate([one.scales for one in plates]), samples)
        raw = by_sample.reshape(frames, -1) / steps + how.analog_offset
        written = np.concatenate([block.reshape(frames, -1), np.round(raw) if how.scale else raw], axis=1)
    else:
        written = block.reshape(frames, -1)
    data = how.integers(np.round(written)) if how.scale else how.floats(written)
    parameters = _parameters(list(markers), rate, how, plates, channels, samples, frames)
    start = 2 + len(parameters) // 512
    parameters = _parameters(list(markers), rate, how, plates, channels, samples, frames, start)
    header = bytes([2, 0x50])
    header += how.integers([len(markers), channels * samples, how.first_frame, how.first_frame + frames - 1, 10])
    header += how.floats([scale if how.scale else -1.0]) + how.integers([start, samples])
    header += how.floats([rate])
    return header.ljust(512, b"\0") + parameters + data.ljust(-(-len(data) // 512) * 512, b"\0")


def _parameters(
    labels: list[str],
    rate: float,
    how: Convention,
    plates: Sequence[Plate],
    channels: int,
    samples: int,
    frames: int,
    start: int = 0,
) -> bytes:
    point: dict[str, Any] = {
        "USED": [len(labels)], "SCALE": float(how.scale or -1.0), "RATE": float(rate), "DATA_START": [start],
        "FRAMES": [frames], "UNITS": [how.unit],
    }  # fmt: skip
    for part in range(-(-len(labels) // 255)):
        point[f"LABELS{part + 1 if part else ''}"] = labels[255 * part : 255 * (part + 1)]
    analog: dict[str, Any] = {
        "USED": [channels], "RATE": float(how.analog_rate or rate * samples), "GEN_SCALE": float(how.analog_scale),
    }  # fmt: skip
    analog |= (
        {"LABELS": [f"ch{k}" for k in range(channels)], "SCALE": np.concatenate([one.scales for one in plates])}
        if channels
        else {}
    )
    analog |= {"OFFSET": [how.analog_offset] * channels} if channels else {}
    platform: dict[str, Any] = {"USED": [len(plates)]}
    if plates:
        platform |= {
            "TYPE": [plate.kind for plate in plates], "ZERO": [*plates[0].zero],
            "CORNERS": np.array([plate.corners for plate in plates]),
            "ORIGIN": np.array([plate.origin for plate in plates]), "CHANNEL": _numbers(plates),
            "CAL_MATRIX": np.array([np.eye(6) if one.matrix is None else one.matrix.T for one in plates]),
        }  # fmt: skip
    body = b""
    for number, (name, found) in enumerate({"POINT": point, "ANALOG": analog, "FORCE_PLATFORM": platform}.items(), 1):
        body += struct.pack("bb", len(name), -number) + name.encode() + how.integers([3]) + b"\0"
        for key, value in found.items():
            content = _content(value, how)
            body += struct.pack("bb", len(key), number) + key.encode() + how.integers([2 + len(content)]) + content
    body += b"\0\0"
    blocks = -(-(len(body) + 4) // 512)
    return (bytes([1, 0x50, blocks, how.processor]) + body).ljust(512 * blocks, b"\0")


def _numbers(plates: Sequence[Plate]) -> list[list[int]]:
    """Return the numbers of the channels of each plate, with zeros after those of plates with fewer channels."""
    counts, first, found = [plate.channels.shape[1] for plate in plates], 1, []
    for count in counts:
        found.append([*range(first, first + count), *[0] * (max(counts) - count)])
        first += count
    return found


def _content(value: Any, how: Convention) -> bytes:
    """Return type, dimensions and values of a parameter, and an empty description; arrays are (last, ..., first)."""
    if isinstance(value, list) and isinstance(value[0], str):
        width = max(map(len, value))
        texts = b"".join(one.encode().ljust(width) for one in value)
        return struct.pack("bbBB", -1, 2, width, len(value)) + texts + b"\0"
    array = np.asarray(value)
    shape = bytes([array.ndim, *array.shape[::-1]])
    if array.dtype.kind == "i":
        return b"\2" + shape + how.integers(array) + b"\0"
    return b"\4" + shape + how.floats(array) + b"\0"
