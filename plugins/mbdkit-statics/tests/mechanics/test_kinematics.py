"""Motions of driven mechanisms, compared with closed formulas."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import mbdkit

CRANK, ROD, SPEED = 0.1, 0.3, 7.0


def slider_crank(rod: float = ROD) -> mbdkit.Mechanism:
    m = mbdkit.Mechanism()
    m.body("crank", mass=0.6, inertia=5e-4, position=(CRANK / 2, 0.0))
    m.body("rod", mass=0.9, inertia=7e-3, position=(CRANK + rod / 2, 0.0))
    m.body("slider", mass=1.5, inertia=8e-4, position=(CRANK + rod, 0.0))
    m.revolute("A", m.ground, "crank", points=((0, 0), (-CRANK / 2, 0)))
    m.revolute("B", "crank", "rod", points=((CRANK / 2, 0), (-rod / 2, 0)))
    m.revolute("C", "rod", "slider", points=((rod / 2, 0), (0, 0)))
    m.prismatic("guide", m.ground, "slider", points=((0, 0), (0, 0)), axis=(1, 0), angle=0.0)
    m.driver("motor", m.ground, "crank", coordinate="angle", motion=f"{SPEED}*t + 0.3*sin(2*t)")
    return m


def test_the_slider_crank_moves_by_its_formulas() -> None:
    # expected: x = r cos(phi) + sqrt(l^2 - r^2 sin(phi)^2), differentiated twice by hand
    found = mbdkit.kinematics(slider_crank(), time={"end": 2.0, "step": 0.013})
    t = found.time
    assert t[-1] == 2.0
    assert len(t) == 155
    phi, w, e = SPEED * t + 0.3 * np.sin(2 * t), SPEED + 0.6 * np.cos(2 * t), -1.2 * np.sin(2 * t)
    s, c = np.sin(phi), np.cos(phi)
    root = np.sqrt(ROD**2 - CRANK**2 * s**2)
    x = CRANK * c + root
    root_1 = -(CRANK**2) * s * c / root  # d root / d phi
    root_2 = -(CRANK**2) * (c * c - s * s) / root - root_1**2 / root
    v = (-CRANK * s + root_1) * w
    a = (-CRANK * s + root_1) * e + (-CRANK * c + root_2) * w**2
    slider = found["slider"]
    np.testing.assert_allclose(slider.position[:, 0], x, rtol=0, atol=1e-14)
    np.testing.assert_allclose(slider.velocity[:, 0], v, rtol=0, atol=1e-12)
    np.testing.assert_allclose(slider.acceleration[:, 0], a, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["crank"].position[:, 2], phi, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found["rod"].position[:, 2], -np.arcsin(CRANK * s / ROD), rtol=0, atol=1e-14)
    np.testing.assert_allclose(slider.position[:, 1:], 0.0, rtol=0, atol=1e-16)


def test_steps_of_more_than_half_a_turn_stay_on_the_same_assembly() -> None:
    # expected: the slider stays on its side of the crank
    found = mbdkit.kinematics(slider_crank(), time={"end": 20.0, "step": 0.9})
    assert np.all(found["slider"].position[:, 0] >= ROD - CRANK - 1e-12)
    phi = SPEED * found.time + 0.3 * np.sin(2 * found.time)
    np.testing.assert_allclose(found["crank"].position[:, 2], phi, rtol=0, atol=1e-13)


def test_the_motion_is_that_of_a_run() -> None:
    # expected: the dynamic run of the packaged crank press, whose drift is below 1e-9
    found = mbdkit.kinematics("crank-press")
    run = mbdkit.run("crank-press")
    at = np.searchsorted(found.time, run.time)
    for name in found.bodies:
        np.testing.assert_allclose(run[name].position, found[name].position[at, :2], rtol=0, atol=1e-8)
        np.testing.assert_allclose(run[name].velocity, found[name].velocity[at, :2], rtol=0, atol=1e-7)


def test_a_rod_too_short_to_turn_the_crank_stops_where_it_is_stretched() -> None:
    # expected: with a rod shorter than the crank the slider can follow until sin(phi) = l / r
    with pytest.raises(mbdkit.RunError, match="cannot follow its drivers beyond t = 0") as caught:
        mbdkit.kinematics(slider_crank(rod=0.08), time={"end": 1.0, "step": 0.01})
    t = float(str(caught.value).split("t = ")[1].split(" s")[0])
    assert CRANK * np.sin(SPEED * t + 0.3 * np.sin(2 * t)) == pytest.approx(0.08, rel=1e-3)


def test_the_table_holds_every_number_to_the_last_digit(tmp_path: Path) -> None:
    found = mbdkit.kinematics(slider_crank(), time={"end": 0.1, "step": 0.02})
    found.write_csv(tmp_path / "motion.csv")
    with (tmp_path / "motion.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time"]) for row in rows] == found.time.tolist()
    assert [float(row["slider.ax"]) for row in rows] == found["slider"].acceleration[:, 0].tolist()
