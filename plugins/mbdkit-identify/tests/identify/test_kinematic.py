"""Kinematic identification finds the lengths of linkages from positions, without masses that matter or a method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit

TRUE = {"a": 0.3, "b": 0.8, "c": 0.62, "zero": 0.05}
GROUND = 0.93


def four_bar() -> dict[str, Any]:
    """Return the base of a four-bar linkage with lengths a, b, c and d, with wrong lengths."""
    bodies = {
        "crank": {"mass": 1, "inertia": 1, "position": [0.1, 0.1], "angle": 0.3},
        "coupler": {"mass": 1, "inertia": 1, "position": [0.5, 0.3], "angle": 0.5},
        "rocker": {"mass": 1, "inertia": 1, "position": [0.8, 0.3], "angle": 1.6},
    }
    joints = {
        "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], ["-a/2", 0]]},
        "B": {"type": "revolute", "bodies": ["crank", "coupler"], "points": [["a/2", 0], ["-b/2", 0]]},
        "C": {"type": "revolute", "bodies": ["coupler", "rocker"], "points": [["b/2", 0], ["c/2", 0]]},
        "D": {"type": "revolute", "bodies": ["ground", "rocker"], "points": [["d", 0], ["-c/2", 0]]},
    }
    return {
        "mbdkit": 1, "parameters": {"a": 0.28, "b": 0.75, "c": 0.6, "d": GROUND},
        "model": {"name": "mechanism", "bodies": bodies, "joints": joints},
    }  # fmt: skip


def rocker(crank: np.ndarray) -> np.ndarray:
    """Return the angle of the rocker by the law of cosines, from the diagonal between its pins."""
    x, y = GROUND - TRUE["a"] * np.cos(crank), -TRUE["a"] * np.sin(crank)
    diagonal = np.hypot(x, y)
    inner = (diagonal**2 + TRUE["c"] ** 2 - TRUE["b"] ** 2) / (2 * diagonal * TRUE["c"])
    return np.asarray(np.arctan2(-y, -x) - np.arccos(inner))


def spec(folder: Path, deviation: float, **sections: Any) -> dict[str, Any]:
    crank, dice = np.linspace(0.3, 6.5, 40), np.random.default_rng(3)
    values = np.column_stack([crank + TRUE["zero"], rocker(crank)]) + dice.normal(0.0, deviation, (40, 2))
    table = np.column_stack([np.arange(40), np.mod(values, 2 * np.pi)])  # the sensors wrap
    np.savetxt(folder / "turn.csv", table, delimiter=",", header="time,crank,rocker", comments="")
    turn = {"file": str(folder / "turn.csv"), "observed": {"crank.angle": "crank", "joints.D.angle": "rocker"}}
    return {
        "mbdkit_identify": 1, "kinematic": True, "base": four_bar(), "experiments": {"turn": turn},
        "sensors": {"crank.angle": {"offset": "zero"}}, "intervals": {"method": "linear"},
        "parameters": {"a": {}, "b": {}, "c": {}, "zero": {"start": 0.0}},
    } | sections  # fmt: skip


def test_lengths_and_the_zero_of_a_four_bar_linkage_follow_from_a_turn(tmp_path: Path) -> None:
    exact = mbdkit.identify(spec(tmp_path, 0.0))
    noisy = mbdkit.identify(spec(tmp_path, 0.002))
    for name, value in TRUE.items():
        assert exact[name].value == pytest.approx(value, abs=1e-7)
        assert abs(noisy[name].value - value) < 4 * noisy[name].deviation
        assert 1e-4 < noisy[name].deviation < 0.01
    assert noisy.verdict == "good"
    assert noisy.residuals[0].deviation == pytest.approx(0.002, rel=0.4)  # of 40 values in all that are not used up


@pytest.mark.parametrize(
    ("change", "key", "sentence"),
    [
        ({"shooting": {"window": 1.0}}, "shooting", "has no effect with `kinematic: true`"),
        ({"candidates": {"more": {"duration": 1.0}}}, "candidates", "has no effect with `kinematic: true`"),
        ({"sensors": {}, "parameters": {"a": {}}, "rate": True}, "experiments.turn.observed", "is a velocity"),
    ],
)
def test_what_positions_do_not_use_is_refused(tmp_path: Path, change: dict[str, Any], key: str, sentence: str) -> None:
    given = spec(tmp_path, 0.0) | change
    if given.pop("rate", False):
        columns = {"crank.angular_velocity": "crank", "joints.D.angle": "rocker"}
        observed = {name: {"column": column, "deviation": 0.1} for name, column in columns.items()}
        given["experiments"]["turn"]["observed"] = observed
    with pytest.raises(mbdkit.SpecError, match=sentence) as error:
        mbdkit.identify(given)
    assert error.value.key == key


def test_a_point_mass_has_no_angle_among_the_unknowns(tmp_path: Path) -> None:
    r, length, offset, count = 0.075, 0.26, 0.155, 30
    angle, dice = np.linspace(3.6, 9.6, count), np.random.default_rng(0)
    height = r * np.sin(angle) + np.sqrt(length**2 - (r * np.cos(angle) + offset) ** 2)
    table = np.c_[np.arange(count), angle + dice.normal(0, 1e-4, count), height + dice.normal(0, 1e-5, count)]
    np.savetxt(tmp_path / "crank.csv", table, delimiter=",", header="time,wheel,collar", comments="")
    start = "r*sin(3.6) + sqrt(l**2 - (r*cos(3.6) + d)**2)"
    bodies = {
        "wheel": {"mass": 1, "inertia": 1, "angle": 3.6},
        "collar": {"mass": 1, "position": ["-d", start]},
    }
    joints = {
        "axle": {"type": "revolute", "bodies": ["ground", "wheel"], "at": [0, 0]},
        "rod": {"type": "distance", "bodies": ["wheel", "collar"], "points": [["r", 0], [0, 0]], "length": "l"},
        "guide": {
            "type": "point-on-line", "bodies": ["ground", "collar"], "points": [["-d", 0], [0, 0]], "axis": [0, 1],
        },
    }  # fmt: skip
    observed = {
        "wheel.angle": {"column": "wheel", "deviation": 1e-4},
        "collar.y": {"column": "collar", "deviation": 1e-5},
    }
    base = {"mbdkit": 1, "parameters": {"r": 0.07, "l": 0.25, "d": 0.15}}
    fit = mbdkit.identify({
        "mbdkit_identify": 1, "kinematic": True, "intervals": {"method": "linear"},
        "base": base | {"model": {"name": "mechanism", "bodies": bodies, "joints": joints}},
        "experiments": {"slow": {"file": str(tmp_path / "crank.csv"), "observed": observed}},
        "parameters": {"r": {}, "l": {}, "d": {}},
    })  # fmt: skip
    assert fit.unknowns == 3 + count  # an angle of the wheel for each sample
    for name, value in {"r": r, "l": length, "d": offset}.items():
        assert abs(fit[name].value - value) < 4 * fit[name].deviation < 1e-3
