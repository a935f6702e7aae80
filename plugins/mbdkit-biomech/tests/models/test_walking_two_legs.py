"""The example `walking-two-legs`: forces of the ground that balance the whole body, and two legs that walk alike."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from tests.inverse_dynamics.running import table_of

import mbdkit
from mbdkit import Run
from mbdkit.spec.loading import example_table, read_source
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import load_inverse_spec
from tests.benchmarks.walking_both_legs import LEFT, residuals
from tests.benchmarks.walking_data import ANGLES, GRAVITY, GRID, PERSON_MASS, PHASES, SPEED, STRIDE, series_in

TEXT = example_table("walking-two-legs") or ""
HALF = 50
"""Rows of half a stride."""


@pytest.fixture(scope="module")
def walked() -> Iterator[Run]:
    with mbdkit.inverse(load_inverse_spec("walking-two-legs", ["motion.errors=none"])) as run:
        yield run


def test_the_table_has_the_series_of_its_comments_and_the_left_leg_half_a_stride_later() -> None:
    gait, rows = series_in(TEXT), table_of(TEXT)
    np.testing.assert_allclose(rows["time"], STRIDE * (PHASES - PHASES[0]), atol=1e-6)
    for name, own in gait.series.items():
        unit = np.radians(1.0) if name in ANGLES else 1.0
        atol = (0.006 if name.startswith("force") else 1e-7) + 1e-5 * np.sum(np.abs(own))
        np.testing.assert_allclose(unit * rows[name], gait.at(name, PHASES), rtol=0, atol=atol)
    for name in LEFT:
        later = rows[name][HALF:] - (SPEED * STRIDE / 2 if name == "pressure_x" else 0.0)
        np.testing.assert_allclose(rows[f"{name}_left"][:-HALF], later, rtol=0, atol=1e-5)


def test_the_mean_ground_force_is_the_weight_and_moves_the_whole_body_by_newtons_law() -> None:
    gait, rows = series_in(TEXT), table_of(TEXT)
    assert 2 * np.mean(gait.force(GRID)) == pytest.approx(1j * PERSON_MASS * GRAVITY, abs=1e-2)
    stride = slice(30, 130)
    arm = np.asarray(rows["pressure_x"] - rows["hip_x"])[stride]
    for own, largest in zip(residuals(gait, PHASES[stride], arm), (2.0, 10.0, 5.0), strict=True):
        assert np.max(np.abs(own)) < largest  # N and N m; the series end with the harmonic 20 of the stride


def test_residuals_are_small_and_each_leg_has_the_moments_that_it_has_by_itself() -> None:
    data = read_source("walking-two-legs").data
    motion = {**data["motion"], "smooth": "none", "errors": "none"}
    columns = {name: one for name, one in motion["columns"].items() if not name.endswith("_left")}
    model = {"name": "leg", "root": "trunk"}
    one = {"motion": {**motion, "columns": columns}, "loads": {"ground": data["loads"]["ground"]}, "model": model}
    two = {"motion": motion, "model": {**model, "legs": 2}}
    given = {"recruitment": None, "measures": {}, "accept": ["residuals"]}
    runs = [mbdkit.inverse(load_inverse_spec("walking-two-legs", **given, **own)) for own in (two, one)]
    for name, largest in (("hip_x", 2.0), ("hip_y", 10.0), ("trunk_tilt", 5.0)):
        assert np.max(np.abs(runs[0].actuators[name].value)) < largest
    for name in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        values = [run.actuators[name].value for run in runs]
        np.testing.assert_allclose(values[0], values[1], rtol=0, atol=1e-9)


def test_knees_carry_what_instrumented_knees_measure_in_walking(walked: Run) -> None:
    # I. Kutzner et al. (2010): 2.6 body weights at the peak on average, 1,920 N here; see test_walking_muscles
    names = list(walked.joint_names)
    without = np.max(np.linalg.norm(walked.array("muscles/reaction_force_without"), axis=2), axis=0)
    for side in ("", "_left"):
        assert 2000 < walked.measures[f"knee_force{side}"] < 3400
        assert without[names.index(f"knee{side}")] < 900
    assert np.max(walked.array("muscles/certificate")) < 1e-12
