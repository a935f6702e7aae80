"""The archive is a netCDF-4 file: three libraries open it, without a warning, whatever its sizes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import netCDF4
import numpy as np
import pytest
import xarray

from mbdkit.archive import writer
from mbdkit.archive.layout import every_array
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.quantities.array import TEXT
from tests.slow_cases import slow

from .making import largest, make, names, rows

SIZES = [
    # rows, bodies, joints, constraint rows
    (11, 3, 2, 5),
    (11, 1, 1, 0),
    (1, 1, 0, 0),
    (0, 2, 2, 4),
]
IN_CHUNKS = [(11, 2, 2, 4), (0, 2, 2, 4)]
"""Sizes whose archives are also flushed after every piece of rows: many rows, and none."""

each = pytest.mark.parametrize(
    ("sizes", "pieces"),
    [(SIZES[0], 1), (SIZES[3], 1), *slow((SIZES[1], 1), (SIZES[2], 1)), *((sizes, 4) for sizes in IN_CHUNKS)],
)
first = pytest.mark.parametrize(("sizes", "pieces"), [(SIZES[0], 1), *slow((SIZES[3], 1), (IN_CHUNKS[0], 4))])


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@cache
def made_once(sizes: tuple[int, int, int, int], after: str) -> bytes:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        if after:
            patch.setattr(writer, "FLUSH_INTERVAL", 0.0)
        count, bodies, joints, constraints = sizes
        path = Path(folder) / "run.h5"
        make(path, count=count, named=names(bodies, joints, constraints), piece=4, after=after)
        return path.read_bytes()


@pytest.fixture
def made(tmp_path: Path, sizes: tuple[int, int, int, int], pieces: int) -> Path:
    path = tmp_path / "run.h5"
    path.write_bytes(made_once(sizes, "flush_if_due" if pieces > 1 else ""))
    return path


def expected(sizes: tuple[int, int, int, int]) -> dict[str, np.ndarray]:
    count, bodies, joints, constraints = sizes
    made = rows(count, names(bodies, joints, constraints))
    return {array.path: made[array.key] for array in every_array() if array.dims[0] == "time" and not array.optional}


@each
def test_xarray_opens_it_with_h5netcdf(made: Path, sizes: tuple[int, int, int, int]) -> None:
    with xarray.open_datatree(made, engine="h5netcdf") as tree:
        for path, values in expected(sizes).items():
            np.testing.assert_array_equal(tree[path].values, values)
        for array in every_array():
            if not array.optional:
                assert tree[array.path].dims == array.dims
                assert tree[array.path].attrs["units"] == array.units
                assert tree[array.path].attrs["long_name"] == array.long_name
        assert tree["joints/joint"].to_numpy().tolist() == list(names(joints=sizes[2]).joints)


@each
def test_netcdf4_opens_it(made: Path, sizes: tuple[int, int, int, int]) -> None:
    with netCDF4.Dataset(made) as file:
        for path, values in expected(sizes).items():
            np.testing.assert_array_equal(file[path][...], values)
        for array in every_array():
            if not array.optional:
                assert file[array.path].dimensions == array.dims
                assert file[array.path].units == array.units
        assert not any(name.startswith("phony") for group in file.groups.values() for name in group.dimensions)
        np.testing.assert_array_equal(
            np.atleast_1d(file["joints"].misalignment_max), largest(0, names(joints=sizes[2]))
        )


@first
def test_to_xarray_is_what_xarray_reads(made: Path, sizes: tuple[int, int, int, int]) -> None:
    with load(made) as run, xarray.open_datatree(made, engine="h5netcdf") as tree:
        xarray.testing.assert_identical(run.to_xarray(), tree)


def test_to_xarray_works_in_memory(tmp_path: Path) -> None:
    make(tmp_path / "run.h5")
    with Run(make(None)) as memory, load(tmp_path / "run.h5") as file:
        one, two = memory.to_xarray(), file.to_xarray()
    for tree in (one, two):  # two runs are never made at the same time
        del tree.attrs["created_utc"]
        tree.attrs.pop("attributes_sha256", None)  # covers the two
        del tree["stats"].attrs["finish_s"]
    xarray.testing.assert_identical(one, two)


def test_strings_are_variable_length_utf8(archive: Path) -> None:
    with h5py.File(archive) as file:
        items = [file]
        file.visititems(lambda _, item: items.append(item))
        checked = 0
        for item in items:
            for name in item.attrs:
                if name in ("CLASS", "NAME"):
                    continue  # HDF5's own, on dimension scales
                info = h5py.check_string_dtype(item.attrs.get_id(name).dtype)
                if info is not None:
                    assert (info.encoding, info.length) == ("utf-8", None)
                    checked += 1
        assert checked > 80
        for array in every_array():
            if array.dtype == TEXT and not array.optional:
                info = h5py.check_string_dtype(file[array.path].dtype)
                assert info is not None
                assert (info.encoding, info.length) == ("utf-8", None)


def test_mixed_units_are_named_row_by_row(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", named=names(constraints=3))
    with h5py.File(tmp_path / "run.h5") as file:
        found = {
            path: list(file[path].parent[file[path].attrs["row_units"]].asstr()[:])
            for path in (array.path for array in every_array())
            if path in file and file[path].attrs["units"] == "mixed"
        }
    assert found == {
        "trajectory/position": ["m", "m", "rad"],
        "trajectory/velocity": ["m/s", "m/s", "rad/s"],
        "trajectory/acceleration": ["m/s^2", "m/s^2", "rad/s^2"],
        "joints/angle": ["rad", "rad"],
        "forces/length": ["m", "rad"],
        "forces/rate": ["m/s", "rad/s"],
        "forces/value": ["N", "N m"],
        "constraints/position_residual": ["m", "m", "rad"],
        "constraints/velocity_residual": ["m/s", "m/s", "rad/s"],
        "constraints/multiplier": ["N", "N", "N m"],
    }


def test_old_readers_are_served(archive: Path) -> None:
    # Superblock version 2 is that of HDF5 1.8 (2008).
    assert archive.read_bytes()[:9] == b"\x89HDF\r\n\x1a\n\x02"
