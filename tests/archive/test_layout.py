"""The layout is the one that users were promised, and its document is fresh."""

from __future__ import annotations

from typing import get_args

from mbdkit.archive.layout import (
    QUANTITIES,
    every_array,
    is_timing,
)
from mbdkit.quantities.entries import ChosenGroup
from mbdkit.quantities.registered_kinds import groups
from tests import history_columns, layout_document
from tests.archive.making import DOCUMENT

LAYOUT = every_array()
BY_PATH = {array.path: array for array in LAYOUT}

PROMISED = {
    "trajectory": "time T, body B, coordinate 3, position TB3, velocity TB3, acceleration TB3, elapsed_s T",
    "joints": "time T, joint J, axis 2, misalignment TJ, velocity_misalignment TJ, angle_misalignment TJ, angle TJ, "
    "reaction_force TJ2, reaction_torque TJ, reaction_force_first TJ2, reaction_force_second TJ2, driver_power TJ",
    "forces": "time T, force F, length TF, rate TF, value TF, power TF, potential TF",
    "markers": "time T, marker K, axis 2, body K, position TK2, velocity TK2",
    "beams": "time T, element L, beam L, axial TL, shear TL, moment TL, strain_energy TL",
    "constraints": "time T, constraint m, row_units m, position_residual Tm, velocity_residual Tm, multiplier Tm, "
    "method_multiplier Tm",
    "energy": "time T, kinetic T, potential T, total T, dissipated T, work T, balance T",
    "steps": "interval N, time N, steps N, size N, iterations N, iterations_max N, rejected N",
    "events": "event E, body B, coordinate 3, name E, time E, direction E, position EB3, velocity EB3",
}
ARRAYS = {
    f"{group}/{name}": axes
    for group, arrays in PROMISED.items()
    for name, axes in (array.split() for array in arrays.split(", "))
}
AXES = {"T": "time", "B": "body", "3": "coordinate", "J": "joint", "F": "force", "K": "marker", "2": "axis"}
AXES |= {"L": "element", "m": "constraint", "N": "interval", "E": "event"}


def test_layout_has_every_promised_array_with_its_axes() -> None:
    for path, axes in ARRAYS.items():
        assert BY_PATH[path].dims == tuple(AXES[axis] for axis in axes)


def test_layout_adds_nothing_but_row_units_the_bodies_of_joints_and_what_is_optional() -> None:
    added = {array.path for array in LAYOUT} - set(ARRAYS)
    assert all(path.endswith(("row_units", "_body")) or BY_PATH[path].optional for path in added)
    assert {array.group for array in LAYOUT} == set(groups())


def test_every_axis_has_its_scale_in_the_same_group() -> None:
    for array in LAYOUT:
        for dim in array.dims:
            assert BY_PATH[f"{array.group}/{dim}"].is_scale


def test_every_array_with_mixed_units_names_them_on_one_of_its_axes() -> None:
    for array in LAYOUT:
        assert (array.units == "mixed") == bool(array.row_units)
        if array.row_units:
            (dim,) = BY_PATH[f"{array.group}/{array.row_units}"].dims
            assert dim in array.dims


def test_specs_choose_groups_of_the_table() -> None:
    assert frozenset(get_args(ChosenGroup)) == QUANTITIES


def test_elapsed_time_is_the_only_timing() -> None:
    assert [array.path for array in LAYOUT if is_timing(array.path)] == ["trajectory/elapsed_s"]


def test_declarations_of_columns_are_fresh() -> None:
    text = history_columns.TARGET.read_text(encoding="utf-8")
    assert history_columns.declarations() == text, "run: python -m tests.history_columns"


def test_document_is_fresh() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert layout_document.renewed(text) == text, "run: python -m tests.layout_document schemas/archive.md"
