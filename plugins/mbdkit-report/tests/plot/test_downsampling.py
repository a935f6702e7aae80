from __future__ import annotations

import h5py
import numpy as np
import pytest

from mbdkit_report import bands
from mbdkit_report.figures import curves
from mbdkit_report.figures.curves import evenly, take


def test_bands_of_a_short_recording_are_its_rows():
    values = np.array([[1.0, -2.0], [3.0, 4.0]])
    cut = bands(np.array([0.0, 1.0]), values)
    assert cut.exact
    np.testing.assert_array_equal(cut.high, values)
    np.testing.assert_array_equal(cut.peaks, [3.0, 4.0])
    np.testing.assert_array_equal(cut.curve(1), [[0.0, 1.0], [-2.0, 4.0]])


@pytest.mark.parametrize("block", [1, 1_000, 4_000_000])
def test_bands_keep_every_extreme_whatever_the_size_of_a_block(monkeypatch, block):
    monkeypatch.setattr(curves, "BLOCK", block)
    rows = 30_011 if block > 1 else 1_009
    values = np.random.default_rng(2).normal(size=(rows, 2))
    values[rows // 2, 1] = -99.0
    cut = bands(np.arange(rows, dtype=float), values, points=100)
    edges = np.linspace(0, rows, len(cut.time) + 1).astype(int)
    for low, high, first, last in zip(cut.low, cut.high, edges[:-1], edges[1:], strict=True):
        np.testing.assert_array_equal(low, values[first:last].min(axis=0))
        np.testing.assert_array_equal(high, values[first:last].max(axis=0))
    assert cut.peaks[1] == 99.0
    assert np.all(np.diff(cut.time) > 0)
    assert cut.curve(1)[1].min() == -99.0


def test_values_that_are_not_finite_leave_no_trace_in_bands():
    values = np.array([[1.0, np.nan], [np.inf, np.nan], [2.0, np.nan]])
    cut = bands(np.arange(3.0), values)
    np.testing.assert_array_equal(cut.high, [[1.0, np.nan], [np.nan, np.nan], [2.0, np.nan]])
    np.testing.assert_array_equal(cut.peaks, [2.0, np.nan])


def test_bands_of_no_curves_are_empty():
    assert bands(np.arange(5.0), np.empty((5, 0))).high.shape == (5, 0)


def test_rows_are_spread_evenly_with_both_ends():
    assert evenly(5, 10).tolist() == [0, 1, 2, 3, 4]
    assert evenly(101, 3).tolist() == [0, 50, 100]
    assert evenly(1, 2).tolist() == [0]


@pytest.mark.parametrize("rows", [[0, 99], list(range(100)), [3, 4, 50], []])
@pytest.mark.parametrize("block", [40, 4_000_000])
def test_rows_taken_from_a_file_are_those_of_the_array(tmp_path, monkeypatch, rows, block):
    monkeypatch.setattr(curves, "BLOCK", block)
    values = np.random.default_rng(3).normal(size=(100, 4, 3))
    wanted = values[np.array(rows, dtype=int)]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("x", data=values, chunks=(10, 4, 3))
        np.testing.assert_array_equal(take(data, np.array(rows, dtype=int)), wanted)
        np.testing.assert_array_equal(take(data, np.array(rows, dtype=int), [2, 0]), wanted[:, [2, 0]])
