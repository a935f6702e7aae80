"""The hashes are those that the document defines, and nothing but results changes them."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from mbdkit.archive.fingerprint import attributes_sha256, data_sha256
from mbdkit.archive.finished_run import ArrayHash
from mbdkit.archive.layout import every_array, is_timing
from mbdkit.archive.run_writer import Ending, SharedForces
from tests.archive.making import DOCUMENT

from .making import fill, largest, make, names, rows, steps, writer


@pytest.mark.parametrize("sizes", [(11, 2, 2, 4), (0, 1, 0, 0)])
def test_lines_in_the_document_compute_the_hash(tmp_path: Path, sizes: tuple[int, int, int, int]) -> None:
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    (script,) = (block for block in blocks if "hashlib" in block)
    make(tmp_path / "run.h5", count=sizes[0], named=names(*sizes[1:]))
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "run.h5")], capture_output=True, text=True, check=True
    )
    assert done.stdout == "True\n"


def test_every_array_but_timings_is_covered(archive: Path) -> None:
    unchanged = []
    with h5py.File(archive, "r+") as file:
        for array in every_array():
            if array.optional:
                continue
            before = data_sha256(file)
            dataset = file[array.path]
            at = (0,) * dataset.ndim
            dataset[at] = (
                "other"
                if h5py.check_string_dtype(dataset.dtype)
                else np.nextafter(dataset[at], 9, dtype=float)
                if dataset.dtype.kind == "f"
                else 99
            )
            if data_sha256(file) == before:
                unchanged.append(array.path)
    assert unchanged == [array.path for array in every_array() if not array.optional and is_timing(array.path)]


def test_names_that_run_into_each_other_differ(tmp_path: Path) -> None:
    hashes = set()
    for number, bodies in enumerate((["ab", "c"], ["a", "bc"])):
        named = replace(names(), bodies=bodies)
        make(tmp_path / f"{number}.h5", named=named)
        with h5py.File(tmp_path / f"{number}.h5") as file:
            hashes.add(file.attrs["data_sha256"])
    assert len(hashes) == 2


def test_elapsed_time_statistics_and_provenance_are_not_covered(tmp_path: Path) -> None:
    make(tmp_path / "one.h5")
    into = writer(tmp_path / "two.h5", provenance={"mbdkit": "other"}, run_id="other")
    into.append({**rows(11, names()), "trajectory/elapsed_s": np.arange(11.0)})
    into.append_numbered("steps", steps(10))
    into.finish(Ending("complete", "", {"wall_s": 11.0}, largest(11, names())))
    with h5py.File(tmp_path / "one.h5") as one, h5py.File(tmp_path / "two.h5") as two:
        assert one.attrs["data_sha256"] == two.attrs["data_sha256"]


def test_order_in_the_file_is_not_covered(archive: Path, tmp_path: Path) -> None:
    shutil.copy(archive, tmp_path / "copy.h5")
    with h5py.File(tmp_path / "copy.h5", "r+") as file:
        values, attributes = file["energy/work"][:], dict(file["energy/work"].attrs)
        before = data_sha256(file)
        del file["energy/work"]
        assert data_sha256(file) != before
        file.create_dataset("energy/work", data=values, chunks=(3,), compression="gzip")
        assert attributes
        assert data_sha256(file) == before


def test_attributes_have_the_hash_that_the_document_defines(archive: Path) -> None:
    lines = []
    with h5py.File(archive) as file:
        items = [("", file)]
        file.visititems(lambda path, item: items.append((path, item)))
        for path, item in items:
            if path == "trajectory/elapsed_s":
                digest = hashlib.sha256(item[:].tobytes()).hexdigest()
                lines.append(f"{path} <f8 {len(item)} {digest}\n")
            for name, value in item.attrs.items():
                if name in ("REFERENCE_LIST", "data_sha256", "attributes_sha256"):
                    continue
                array = np.asarray(value)
                if name == "DIMENSION_LIST":
                    array = np.array([scale.name for dim in item.dims for scale in dim.values()])
                shape = ",".join(map(str, array.shape))
                if array.dtype.kind == "S":
                    array = np.asarray(value.decode())
                if array.dtype.kind in "OU":
                    kind, content = "utf-8", b"".join(text.encode() + b"\0" for text in array.ravel().tolist())
                else:
                    kind, content = array.dtype.str, array.tobytes()
                lines.append(f"{path}@{name} {kind} {shape} {hashlib.sha256(content).hexdigest()}\n")
        expected = hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()
        assert file.attrs["attributes_sha256"] == expected


def test_attributes_of_arrays_with_redundant_joints_are_covered(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5", shared=SharedForces("1 redundant row: joint J1", ("J1",), 1.0, ("J1",)))
    fill(into, 3)
    into.finish(Ending("complete", "", {}, largest(3, names())))
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["constraints/multiplier"].attrs["not_unique"] == "J1"
        assert file.attrs["attributes_sha256"] == attributes_sha256(file)


def test_only_digests_of_arrays_with_equal_bits_are_shared() -> None:
    shared = ArrayHash(names(1, 1, 1), ())

    def digests(**values: list[float]) -> dict[str, str]:
        """Return the digests shared by runs, of which each recorded one of the `values` of each array five times."""
        return shared.shared_digests(
            {key: np.repeat(np.array(value)[:, None], 5, axis=1) for key, value in values.items()}
        )

    def digest(value: float) -> str:
        return hashlib.sha256(np.full(5, value).tobytes()).hexdigest()

    assert digests(a=[1.0, 1.0], b=[0.0, -0.0], c=[np.nan, np.nan]) == {"a": digest(1.0), "c": digest(np.nan)}
    assert digests(a=[1.0], b=[3.0], c=[np.nan]) == {"a": digest(1.0), "c": digest(np.nan)}
    assert digests(a=[2.0, 2.0, 2.0], b=[3.0, 3.0, 3.0], c=[0.0, 1.0, 0.0]) == {"a": digest(2.0)}
    assert digests(a=[2.0, 1.0], b=[3.0, 3.0], c=[0.0, 0.0]) == {}
    assert digests(a=[2.0], b=[3.0], c=[0.0]) == {}
