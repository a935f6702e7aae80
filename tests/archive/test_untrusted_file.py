"""What could lead out of an archive, repeat without end or exhaust the memory is refused before it is read."""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.reader import load
from mbdkit.base.errors import ArchiveError, SpecError

Change = Callable[[h5py.File], None]


def replaced(path: str, **options: object) -> Change:
    def change(file: h5py.File) -> None:
        del file[path]
        file.create_dataset(path, **options)

    return change


def linked(link: object) -> Change:
    def change(file: h5py.File) -> None:
        del file["energy/kinetic"]
        file["energy/kinetic"] = link

    return change


def virtual(file: h5py.File) -> None:
    source = h5py.VirtualLayout((11,), "f8")
    source[:] = h5py.VirtualSource("other.h5", "secret", (11,))
    del file["energy/kinetic"]
    file.create_virtual_dataset("energy/kinetic", source)


def doubled(file: h5py.File) -> None:
    group = file.create_group("a")
    for _ in range(40):
        group["y"] = group.create_group("x")
        group = group["x"]


def bomb(file: h5py.File) -> None:
    file.create_dataset("energy/heat", (1 << 24,), "<f8", chunks=(1 << 20,), compression="gzip")
    for start in range(0, 1 << 24, 1 << 20):
        file["energy/heat"][start : start + (1 << 20)] = 0.0


def chunk_bomb(file: h5py.File) -> None:
    dataset = file.create_dataset("energy/heat", (1 << 10,), "<f8", chunks=(1 << 10,), compression="gzip")
    packer = zlib.compressobj()
    pieces = [packer.compress(bytes(1 << 24)) for _ in range(20)]  # 320 MiB
    dataset.id.write_direct_chunk((0,), b"".join(pieces) + packer.flush())


HUGE = 1 << 40

REFUSED: dict[str, tuple[Change, str]] = {
    "external link": (linked(h5py.ExternalLink("other.h5", "/secret")), "energy/kinetic is a link to another file"),
    "soft link": (linked(h5py.SoftLink("/energy/total")), "energy/kinetic is a soft link"),
    "external": (replaced("energy/kinetic", shape=(11,), dtype="<f8", external=[("secret", 0, 88)]), "in another file"),
    "virtual dataset": (virtual, "energy/kinetic is a virtual dataset"),
    "cycle": (lambda file: file["energy"].__setitem__("up", file["/"]), "energy/up is a hard link to a group"),
    "second link": (lambda file: file.__setitem__("e", file["energy/total"]), "is a hard link to a group or array"),
    "forty doubled groups": (doubled, "is a hard link to a group or array"),
    "deep groups": (lambda file: file.create_group("/".join("a" * 20)) and None, "nested more than 8 deep"),
    "never written": (replaced("energy/kinetic", shape=(HUGE,), dtype="<f8"), "declares 8,796,093,022,208 bytes"),
    "in chunks": (replaced("energy/kinetic", shape=(HUGE,), dtype="<f8", chunks=(64,)), "declares 8,796,093,022,208"),
    "gzip bomb": (bomb, "is compressed and unpacks to"),
    "gzip bomb in one chunk": (chunk_bomb, "more than can be unpacked safely"),
    "empty dataset": (replaced("energy/kinetic", data=h5py.Empty("f8")), "has no values"),
    "references": (lambda file: file["stats"].attrs.__setitem__("steps", file["energy"].ref), "neither numbers nor"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_it_is_refused_in_one_sentence(archive: Path, case: str) -> None:
    change, words = REFUSED[case]
    with h5py.File(archive, "r+") as file:
        change(file)
    start = time.perf_counter()
    with pytest.raises(ArchiveError, match=words):
        load(archive)
    assert time.perf_counter() - start < 5
    (problem,) = check(archive)
    assert problem.startswith("this file is refused")


def test_strings_that_share_their_characters_are_refused(archive: Path) -> None:
    with h5py.File(archive, "r+") as file:
        file.create_dataset("notes", (1000,), h5py.string_dtype())
        file["notes"][0] = "x" * 100_000
        start = file["notes"].id.get_offset()
    with archive.open("r+b") as stream:
        stream.seek(start)
        one = stream.read(16)
        stream.seek(start)
        stream.write(1000 * one)
    with pytest.raises(ArchiveError, match="its strings have 100,00"):
        load(archive)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(SpecError, match="not a regular file"):
        load(tmp_path / "pipe.h5")


def test_moderate_compression_is_read(archive: Path) -> None:
    with h5py.File(archive, "r+") as file:
        values = file["energy/kinetic"][:]
        attributes = {name: file["energy/kinetic"].attrs[name] for name in ("units", "long_name")}
        del file["energy/kinetic"]
        packed = file.create_dataset("energy/kinetic", data=values, chunks=(4,), compression="gzip", shuffle=True)
        packed.attrs.update(attributes)
        packed.dims[0].attach_scale(file["energy/time"])
    with load(archive) as run:
        np.testing.assert_array_equal(run.energy.kinetic, values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (replaced("trajectory/position", data=np.zeros((2, 2, 3))), "axis time of"),
        (replaced("trajectory/position", data=np.zeros(4)), "has 1 axes, not 3"),
        (lambda file: file["stats"].attrs.__setitem__("steps", "many"), "steps of stats is not a number"),
        (lambda file: file["provenance"].attrs.__setitem__("x", np.zeros(3)), "neither a string nor a number"),
        (lambda file: file["joints"].attrs.__setitem__("misalignment_max", [0.0]), "for each joint"),
    ],
)
def test_a_structure_that_contradicts_itself_is_damage(archive: Path, change: Change, words: str) -> None:
    with h5py.File(archive, "r+") as file:
        change(file)
        seal(file)
    with pytest.raises(ArchiveError, match=words):
        load(archive)
    assert check(archive)
