"""Warnings about beams whose elements are too coarse."""

from __future__ import annotations

import json

import numpy as np
import pytest

import mbdkit
from mbdkit.cli.common_options import Printing
from mbdkit.cli.outcome import tell
from mbdkit.mechanism.mechanism import Mechanism
from tests.slow_cases import slow


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


def cantilever(
    elements: int, nodes: int = 2, *, force: float = 0.0, load: float = 0.0, damping: float = 0.0
) -> Mechanism:
    """Return a beam with EI = L = 1 and unit mass, with a force across its tip and a distributed load."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e5, "bending": 1.0, "shear": "none"}
    shape = {"a": (0, 0), "b": (1, 0), "elements": elements, "nodes": nodes, "load": (0, -load)}
    bar = m.beam("bar", **shape, stiffness=stiffness, mass_per_length=1.0, damping=damping)
    m.weld("clamp", m.ground, bar[0], at=(0, 0))
    m.force("tip", bar[-1], value=(0, -force))
    return m


@pytest.mark.parametrize("elements", [1, 2, 3])
def test_the_estimate_for_three_nodes_is_the_error_of_the_moments_under_a_distributed_load(elements: int) -> None:
    # expected: the moment q (L - s)^2 / 2 of beam theory
    found = mbdkit.equilibrium(cantilever(elements, nodes=3, load=0.01))
    within = found.beams["bar"][1:-1]
    errors = np.abs(within[:, 3] / 0.005 + (1.0 - within[:, 0]) ** 2)
    assert (errors.max() > 0.01) == bool(found.warnings)
    for warning in found.warnings:
        # margin: whole percents
        assert float(warning.partition("about ")[2].partition(" %")[0]) == pytest.approx(100.0 * errors.max(), rel=0.05)


@pytest.mark.parametrize(("elements", "is_coarse"), [(1, True), (3, False)])
def test_a_run_with_one_element_of_three_nodes_under_a_sudden_force_is_doubtful(elements: int, is_coarse: bool) -> None:
    # expected: damped modes of a clamped beam by Euler and Bernoulli, of frequencies b^2
    damping, force = 4e-3, 0.01
    m = cantilever(elements, nodes=3, force=force, damping=damping)
    run = mbdkit.run(m, integrator={"name": "radau-iia", "stages": 3}, time={"end": 5.0, "step": 0.02})
    expected = np.zeros(len(run.time))
    for b in (1.8751040687, 4.6940911330, 7.8547574382, 10.995540735):
        rate = complex(-(b**4) * damping / 2, b**2 * np.sqrt(1 - (b**2 * damping / 2) ** 2))
        step = 1.0 - (np.exp(rate * run.time) * (1.0 + 1j * rate.real / rate.imag)).real
        expected += 4.0 * force / b**4 * step
    error = np.abs(run["bar.last"].position[:, 1] + expected).max() / expected.max()
    assert (error > 0.01) == is_coarse == (run.verdict == "doubtful")


def test_straight_and_curved_beams_of_three_nodes_that_move_freely_are_not_coarse() -> None:
    m = mbdkit.Mechanism()
    common = {"elements": 4, "nodes": 3, "mass_per_length": 1.0, "angular_velocity": 1.0,
              "stiffness": {"axial": 1e6, "bending": 1e2, "shear": "none"}}  # fmt: skip
    m.beam("rod", a=(30, 2), b=(31, 3), **common)
    m.beam("hook", points=[(0, 0), (1, 0.5), (1, 1)], **{**common, "angular_velocity": 0.0})
    run = mbdkit.run(m, integrator={"name": "radau-iia", "stages": 3}, time={"end": 0.1, "step": 0.05})
    assert run.verdict_reasons == []


@pytest.mark.parametrize(
    "loads", [{"force": 30.0}, *slow({"force": 0.1}, {"load": 1.0})], ids=["large", "small", "spread"]
)
def test_the_recommended_number_of_elements_is_enough(loads: dict[str, float]) -> None:
    for elements, nodes in ((1, 2), (3, 2), (1, 3)):
        for warning in mbdkit.equilibrium(cantilever(elements, nodes, **loads)).warnings:
            count = int(warning.rpartition("use about ")[2].partition(" ")[0])
            assert mbdkit.equilibrium(cantilever(count, nodes, **loads)).warnings == ()


def test_no_absurd_number_of_elements_is_recommended() -> None:
    (warning,) = mbdkit.equilibrium(cantilever(8, force=1e4)).warnings
    assert warning.endswith("; more than 200 elements would be needed, so check its stiffness and its loads")


def test_inverse_dynamics_doubts_a_beam_of_one_element() -> None:
    # expected: the deflection F L^3 / (4 EI) of one element, 0.75 times that of beam theory
    t = np.linspace(0.0, 1.0, 21)
    data = {"t": t, "x": np.ones(21), "y": -0.01 * np.sin(t), "angle": -0.02 * np.sin(t)}
    spec = {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "gravity": [0, 0],
            "beams": {"bar": {"a": [0, 0], "b": [1, 0], "elements": 1, "mass_per_length": 0.2,
                              "stiffness": {"axial": 1e5, "shear": "none", "bending": 1.0}}},
            "joints": {"clamp": {"type": "weld", "bodies": ["ground", "bar.0"], "at": [0, 0]}},
        },
        "motion": {"data": {name: values.tolist() for name, values in data.items()}, "time": "t", "smooth": "none",
                   "columns": {"bar.1.x": "x", "bar.1.y": "y", "bar.1.angle": "angle"}},
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
    assert "The error of the mesh of beams is not included." in str(run.accuracy)
    capsys.readouterr()
    tell(run, Printing(as_json=True))
    assert json.loads(capsys.readouterr().out)["accuracy"]["not_included"] == "the error of the mesh of beams"
