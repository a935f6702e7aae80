"""Warnings about beams whose elements are too coarse."""

from __future__ import annotations

import json

import numpy as np
import pytest

import mbdkit
from mbdkit.cli.common_options import Printing
from mbdkit.cli.outcome import tell
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.report.run_report import run_report


def rotating_rod(elements: int, *, axial: float = 1e5, rate: float = 6.0) -> Mechanism:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    rod = m.beam(
        "rod", a=(0, 0), b=(1, 0), elements=elements, mass_per_length=1.0, angular_velocity=rate, damping=2e-3,
        stiffness={"axial": axial, "bending": 20.0, "shear": "none"},
    )  # fmt: skip
    m.revolute("hub", m.ground, rod[0], at=(0, 0))
    m.driver("motor", m.ground, rod[0], coordinate="angle", motion=f"{rate}*t")
    return m


@pytest.mark.parametrize(("elements", "is_coarse"), [(4, True), (8, False)])
def test_a_run_of_a_rotating_rod_with_few_elements_is_doubtful(
    elements: int, is_coarse: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    # expected: elongation rho w^2 L^3 / (3 EA) of a rod that rotates about one end
    integrator, time = {"name": "radau-iia", "stages": 2}, {"end": 0.2, "step": 0.004}
    run = mbdkit.run(rotating_rod(elements), integrator=integrator, time=time)
    elongation = float(np.hypot(*run[f"rod.{elements}"].position[-1, :2])) - 1.0
    assert (abs(elongation * 3e5 / 36.0 - 1.0) > 0.01) == is_coarse
    assert (run.verdict == "doubtful") == is_coarse
    coarse = "the elements of beam 'rod' are too coarse: its axial forces or elongations may be wrong by about"
    assert any(reason.startswith(coarse) for reason in run.verdict_reasons) == is_coarse
    assert (coarse in capsys.readouterr().err) == is_coarse


@pytest.mark.parametrize(
    ("elements", "corrected", "is_coarse"), [(1, False, True), (4, False, True), (6, False, False), (2, True, False)]
)
def test_elements_that_are_too_stiff_or_soft_in_bending_are_named(
    elements: int, corrected: bool, is_coarse: bool
) -> None:
    # expected: deflection F L^3 / (3 EI) of a cantilever
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e7, "bending": 1.0, "shear": "none"}
    bar = m.beam(
        "bar", a=(0, 0), b=(1, 0), elements=elements, corrected=corrected, stiffness=stiffness, mass_per_length=0.2
    )
    m.weld("clamp", m.ground, bar[0], at=(0, 0))
    m.force("tip", bar[-1], value=(0, -0.01))
    found = mbdkit.equilibrium(m)
    assert (abs(-3.0 * found[bar[-1]][1] / 0.01 - 1.0) > 0.01) == is_coarse
    assert ["its moments or deflections" in warning for warning in found.warnings] == [True] * is_coarse


def test_inverse_dynamics_doubts_a_beam_of_one_element() -> None:
    # expected: the deflection F L^3 / (4 EI) of one element, 0.75 times that of beam theory
    t = np.linspace(0.0, 1.0, 21)
    spec = {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "gravity": [0, 0],
            "beams": {"bar": {"a": [0, 0], "b": [1, 0], "elements": 1, "mass_per_length": 0.2,
                              "stiffness": {"axial": 1e5, "shear": "none", "bending": 1.0}}},
            "joints": {"clamp": {"type": "weld", "bodies": ["ground", "bar.0"], "at": [0, 0]}},
        },
        "motion": {
            "data": {
                "t": t.tolist(),
                "x": np.ones(21).tolist(),
                "y": (-0.01 * np.sin(t)).tolist(),
                "angle": (-0.02 * np.sin(t)).tolist(),
            },
            "time": "t",
            "columns": {"bar.1.x": "x", "bar.1.y": "y", "bar.1.angle": "angle"},
            "smooth": "none",
        },
        "accept": ["constant"],
    }  # fmt: skip
    run = mbdkit.inverse(spec)
    assert any(one.startswith("elements: the elements of beam 'bar' are too coarse") for one in run.verdict_reasons)


def test_error_bars_of_a_beam_are_said_not_to_include_the_error_of_its_mesh(capsys: pytest.CaptureFixture[str]) -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e3, "bending": 1.0, "shear": 1e3}
    bar = m.beam("bar", a=(0, 0), b=(1, 0), elements=2, stiffness=stiffness, mass_per_length=1.0, damping=1e-2)
    m.weld("clamp", m.ground, bar[0], at=(0, 0))
    m.force("tip", bar[-1], value=(0, "-0.1*t"))
    integrator, time = {"name": "radau-iia", "stages": 3}, {"end": 0.02, "step": 2e-3}
    measures = {"moment": "max(abs(joints.clamp.torque))"}
    run = mbdkit.run(m, integrator=integrator, time=time, measures=measures, check=True)
    assert run.measure_errors["moment"] > 0.0
    assert "error bars do not include the error of the mesh of beams" in run.summary()
    assert ("error bars", "without the error of the mesh of beams") in run_report(run).headline
    assert "The error of the mesh of beams is not included." in str(run.accuracy)
    capsys.readouterr()
    tell(run, Printing(as_json=True))
    assert json.loads(capsys.readouterr().out)["accuracy"]["not_included"] == "the error of the mesh of beams"
