"""Damaged C3D files are refused or read; none ends the process."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from inverse_dynamics.c3d_files import DEC, INTEL, MIPS, Convention, Plate, c3d_bytes
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table

pytest.importorskip("ezc3d", reason="ezc3d is not installed: pip install mbdkit[c3d]")

FRAMES = 12


def walk(processor: int, scale: float, *, has_plate: bool) -> bytes:
    corners = np.array([[400.0, 600, 0], [0, 600, 0], [0, 0, 0], [400, 0, 0]])
    plates = [Plate(corners, np.array([0.0, 0, -20]), np.ones((2 * FRAMES, 6)))] if has_plate else []
    markers = {"TOE": np.ones((FRAMES, 3)), "HEEL": np.zeros((FRAMES, 3))}
    return c3d_bytes(markers, 100.0, Convention(processor=processor, scale=scale), plates, samples=2)


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Return a file with one of six kinds of damage, most of them in its header and its parameters."""
    kind, at = random.integers(6), int(random.integers(len(content) if random.random() < 0.2 else 2048))
    if kind == 0:  # single bytes
        places = random.integers(0, 2048, random.integers(1, 9))
        return bytes(random.integers(256) if k in places else byte for k, byte in enumerate(content))
    if kind == 1:  # a length or a count
        values = [0, 1, 127, 128, 254, 255]
        return content[:at] + bytes([values[random.integers(6)]]) + content[at + 1 :]
    if kind == 2:  # a number of two bytes
        return content[:at] + struct.pack("<H", [0, 1, 0x7FFF, 0x8000, 0xFFFF][random.integers(5)]) + content[at + 2 :]
    if kind == 3:
        return content[:at]
    if kind == 4:  # bytes are missing, or there are too many
        count = int(random.integers(1, 600))
        return content[:at] + content[at + count :] if random.random() < 0.5 else content[:at] + content[at - count :]
    return content[:at] + bytes(int(random.integers(1, 64))) + content[at + 64 :]


@pytest.mark.parametrize("count", [8, pytest.param(2000, marks=pytest.mark.slow)])
def test_drawn_damages_are_refused_or_read(tmp_path: Path, count: int) -> None:
    random, refused = np.random.default_rng(13), 0
    file = tmp_path / "walk.c3d"
    for _ in range(count):
        processor, scale = [INTEL, DEC, MIPS][random.integers(3)], float(random.integers(2))
        file.write_bytes(damaged(walk(processor, scale, has_plate=bool(random.integers(2))), random))
        try:
            read_table(file, "motion.file")
        except SpecError:
            refused += 1
    assert 0 < refused < count


def test_the_length_of_a_description_beyond_the_file_is_refused(tmp_path: Path) -> None:
    # the reader ends its process by a signal
    content = bytearray(walk(INTEL, 0.0, has_plate=True))
    content[content.index(b"FORCE_PLATFORM") + len("FORCE_PLATFORM") + 2] = 255
    (tmp_path / "walk.c3d").write_bytes(content)
    with pytest.raises(SpecError, match="this is not a C3D file that can be read"):
        read_table(tmp_path / "walk.c3d", "motion.file")


def test_a_header_that_announces_too_many_samples_takes_no_memory(tmp_path: Path) -> None:
    content = bytearray(walk(INTEL, 0.0, has_plate=False))
    content[2:12] = struct.pack("<5H", 32767, 0, 1, 65535, 10)
    (tmp_path / "walk.c3d").write_bytes(content)
    with pytest.raises(SpecError):
        read_table(tmp_path / "walk.c3d", "motion.file")
