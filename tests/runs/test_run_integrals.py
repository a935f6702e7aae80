"""Integrals, means and root mean squares of measures are integrated with the run, by the weights of its method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.fingerprint import attributes_sha256
from mbdkit.base.errors import MbdkitError
from tests.integrators.step_methods import RungeKutta, run_with
from tests.margins import assert_within
from tests.slow_cases import slow

MEASURES = {
    "energy": "integral(energy.kinetic)",
    "force": "mean(abs(joints.J1.force))",
    "pull": "rms(joints.J2.force_x)",
    "turn": "integral(bodies.rod2.angular_velocity)",
    "shift": "abs(integral(bodies.rod2.velocity))",
}


MODEL = {"name": "double-pendulum", "angles": [0.4, -0.7]}


def run(
    integrator: dict[str, Any] | str, step: float | None, archive: Path | None = None, **sections: Any
) -> mbdkit.Run:
    """Run a double pendulum for 1 s; only its start and end are recorded."""
    if isinstance(integrator, str):
        integrator = {"name": integrator}
    time = {"end": 1.0} | ({} if step is None else {"step": step})
    given = {"output": {"every": 100_000}, "measures": MEASURES} | sections
    return mbdkit.run({"mbdkit": 1, "model": MODEL, "integrator": integrator, "time": time, **given}, archive=archive)


def values(made: mbdkit.Run) -> np.ndarray:
    """Return the values of the measures."""
    return np.array([made.measures[name] for name in MEASURES])


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    """The measures by another method with small steps; the last two are the motion itself, see the first test."""
    return values(run({"name": "gauss", "stages": 3}, 1e-3))


@pytest.mark.parametrize(
    ("integrator", "step", "formulation", "precision"),
    [
        ("rk4", 0.01, "index-1", 1e-13),
        ({"name": "radau-iia", "stages": 2}, 0.01, "index-1", 1e-13),
        ({"name": "dopri5", "adaptive": True}, None, "index-1", 1e-13),
        ("rattle", 0.001, "index-3", 1e-6),  # the velocities of its stages are those of IIIB, and move nothing
    ],
)
def test_the_integral_of_a_velocity_is_the_displacement(
    integrator: Any, step: float | None, formulation: str, precision: float
) -> None:
    made = run(integrator, step, formulation=formulation)
    rod = made.bodies["rod2"]
    assert made.measures["turn"] == pytest.approx(rod.angle[-1] - rod.angle[0], rel=precision)
    assert made.measures["shift"] == pytest.approx(np.hypot(*(rod.position[-1] - rod.position[0])), rel=precision)


@pytest.mark.parametrize(
    ("integrator", "formulation", "order"),
    [
        ("rk-gill", "index-1", 4),
        ({"name": "dop853", "adaptive": False}, "index-1", 8),
        ({"name": "gauss", "stages": 2}, "index-1", 4),
        ({"name": "gauss", "stages": 3}, "index-1", 6),
        ({"name": "radau-iia", "stages": 2}, "index-1", 3),
        ({"name": "radau-iia", "stages": 3}, "ggl", 5),
        ("rattle", "index-3", 2),
    ],
)
def test_integrals_have_the_order_of_the_method(
    integrator: Any, formulation: str, order: int, exact: np.ndarray
) -> None:
    coarse = 0.1 if order >= 6 else 0.02
    errors = [
        np.abs(values(run(integrator, step, formulation=formulation)) - exact).max() for step in (coarse, coarse / 2)
    ]
    assert np.log2(errors[0] / errors[1]) > order - 0.5
    assert errors[1] < 0.02


@pytest.mark.parametrize(
    "integrator",
    [
        {"name": "dopri5", "adaptive": True, "rtol": 1e-10, "atol": 1e-10},
        {"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-9, "atol": 1e-9},
        {"name": "scipy-dop853", "rtol": 1e-11, "atol": 1e-11},
        {"name": "scipy-radau", "rtol": 1e-9, "atol": 1e-9},
    ],
)
def test_adaptive_methods_reach_their_tolerance(integrator: dict[str, Any], exact: np.ndarray) -> None:
    assert values(run(integrator, None)) == pytest.approx(exact, rel=1e-6)


def test_methods_in_python_are_integrated_on_the_quintic_of_each_step(exact: np.ndarray) -> None:
    compiled = values(run("rk4", 0.01))
    found = values(
        run_with(
            RungeKutta(), MODEL, {"end": 1.0, "step": 0.01},
            measures=MEASURES, output={"every": 100_000},
        )
    )  # fmt: skip
    assert found == pytest.approx(exact, rel=1e-5)
    assert found == pytest.approx(compiled, rel=2e-5)


def test_the_recorded_rows_and_the_length_of_stretches_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    few = run("rk4", 0.001)
    monkeypatch.setattr("mbdkit.integrators.interface.STRETCH", 1e-4)
    many = run("rk4", 0.001, output={"every": 1})
    assert len(many.time) == 1001
    assert many.integrals == few.integrals


@pytest.mark.parametrize("method", ["rk4", "scipy-dop853"])
def test_the_last_step_counts_up_to_the_event_that_stops_the_run(method: str) -> None:
    stop = {"events": {"down": {"when": "rod1.angle + 1.0", "action": "stop"}, "half": {"when": "rod1.angle + 0.5"}}}
    made = run(method, 0.05 if method == "rk4" else None, **stop)
    assert "event" in made.status_reason
    rod = made.bodies["rod2"]
    assert made.measures["turn"] == pytest.approx(rod.angle[-1] - rod.angle[0], rel=1e-13 if method == "rk4" else 1e-6)
    assert made.measures["shift"] == pytest.approx(np.hypot(*(rod.position[-1] - rod.position[0])), rel=1e-6)


def test_steps_that_end_at_the_corner_of_a_load_are_integrated_exactly() -> None:
    slider = mbdkit.Mechanism(gravity=(0.0, 0.0))
    slider.body("block", mass=1.0)
    slider.force("push", "block", value=("4*max(0, t - 0.45)", 0.0))
    measures = {"travel": "integral(block.vx)", "impulse": "integral(block.ax)"}
    sections = {"time": {"end": 1.0, "step": 0.25}, "integrator": {"name": "rk4"}, "output": {"every": 4}}
    made = mbdkit.run(slider, **sections, measures=measures)
    assert made.measures["impulse"] == pytest.approx(2 * 0.55**2, rel=1e-14)
    assert made.measures["travel"] == pytest.approx(2 * 0.55**3 / 3, rel=1e-14)


def test_what_is_not_known_at_stages_is_integrated_over_the_rows() -> None:
    measures = {"spread": "rms(rod1.angle - final(rod1.angle))", "work": "integral(energy.balance)"}
    made = run("rk4", 0.01, measures=measures, output={"every": 1})
    assert made.integrals == {}
    angle = made.bodies["rod1"].angle
    assert made.measures["spread"] == pytest.approx(
        np.sqrt(np.trapezoid((angle - angle[-1]) ** 2, made.time)), rel=1e-12
    )


SPREAD = "rms(slider.x - mean(slider.x))"


def oscillator(integrator: dict[str, Any], step: float, measure: str, **sections: Any) -> dict[str, Any]:
    """Return the spec of x = cos(2 t) until t = 1; only its start and end are recorded."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("slider", mass=1.0, inertia=1.0, position=(1.0, 0.0))
    m.prismatic("rail", m.ground, "slider", at=(0, 0), axis=(1, 0))
    m.spring_damper("spring", m.ground, "slider", points=((-1.0, 0.0), (0.0, 0.0)), stiffness=4.0, free_length=1.0)
    run = {"integrator": integrator, "time": {"end": 1.0, "step": step}, "output": {"every": 100_000}}
    return {"mbdkit": 1, "model": m.to_spec(), **run, "measures": {"found": measure}, **sections}


MEAN, SQUARE = np.sin(2.0) / 2, 0.5 + np.sin(4.0) / 8
"""Means of cos(2 t) and of its square from 0 to 1."""


@pytest.mark.parametrize(
    ("integrator", "order"),
    [({"name": "rk4"}, 4), ({"name": "gauss", "stages": 2}, 4), ({"name": "gauss", "stages": 3}, 6)],
)
def test_integrals_of_integrals_have_the_order_of_the_method(integrator: dict[str, Any], order: int) -> None:
    exact = np.sqrt(SQUARE - MEAN**2)
    errors = [abs(mbdkit.run(oscillator(integrator, h, SPREAD)).measures["found"] - exact) for h in (0.1, 0.05)]
    assert np.log2(errors[0] / errors[1]) > order - 0.5
    assert_within(errors[1], 1e-5)


def test_integrals_may_be_nested_twice_and_be_those_of_vectors() -> None:
    # with d = x - mean(x), the mean of (d^2 - mean(d^2))^2 is that of d^4 without the square of that of d^2
    nodes, weights = np.polynomial.legendre.leggauss(40)
    d = np.cos(1.0 + nodes) - MEAN
    inner = "(slider.x - mean(slider.x))**2"
    made = mbdkit.run(oscillator({"name": "gauss", "stages": 3}, 0.01, f"mean(({inner} - mean({inner}))**2)"))
    assert made.measures["found"] == pytest.approx(weights @ d**4 / 2 - (weights @ d**2 / 2) ** 2, rel=1e-9)
    made = mbdkit.run(
        oscillator({"name": "gauss", "stages": 3}, 0.01, "mean(abs(slider.position - mean(slider.position)))")
    )
    assert made.measures["found"] == pytest.approx(weights @ np.abs(d) / 2, rel=2e-4)  # a corner inside steps


@pytest.mark.parametrize(
    "measure",
    [
        "integral((slider.x - max(slider.x))**2)",
        "rms(energy.kinetic - mean(energy.balance + energy.kinetic))",
        *slow(
            SPREAD,
            "mean(slider.vx**2) - mean(slider.vx)**2",
            "rms(slider.x - final(slider.x))",
            "mean((slider.x - at(slider.x, 0.5))**2)",
        ),
    ],
)
def test_a_run_and_its_gradient_have_the_same_numbers(measure: str) -> None:
    spec = oscillator({"name": "rk4"}, 0.05, measure, output={"every": 2})
    found = mbdkit.gradient(spec, "found", "model.bodies.slider.position.0")
    assert found.value[0] == pytest.approx(mbdkit.run(spec).measures["found"], rel=1e-12)
    assert found.check is not None
    assert found.check.is_passed


@pytest.mark.parametrize("store", ["files", "summary"])
def test_measures_of_studies_are_integrated_with_their_runs(store: str, tmp_path: Path, exact: np.ndarray) -> None:
    base = {
        "mbdkit": 1,
        "model": MODEL,
        "integrator": {"name": "gauss", "stages": 3},
        "time": {"end": 1.0, "step": 0.01},
        "output": {"every": 100},
    }
    study = {"mbdkit_study": 1, "store": store, "base": base, "axes": [{"time.step": [0.01, 0.02]}], "measures": {}}
    plain = mbdkit.study(study, out=tmp_path / "study").to_frame()
    study["measures"] = MEASURES
    found = mbdkit.study(study, out=tmp_path / "study", overwrite=True).to_frame()
    assert found[list(MEASURES)].to_numpy()[0] == pytest.approx(exact, rel=2e-9)
    assert list(found["data_sha256"]) == list(plain["data_sha256"])


def test_the_archive_keeps_the_integrals(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with run("rk4", 0.01, archive=path) as made:
        assert made.integrals["energy.kinetic"] == made.measures["energy"]
        assert attributes_sha256(made.file) == made.file.attrs["attributes_sha256"]
    with mbdkit.load(path) as read:
        assert read.integrals["bodies.rod2.velocity"] == made.integrals["bodies.rod2.velocity"]


def test_a_run_without_integrals_keeps_none() -> None:
    made = run("rk4", 0.01, measures={"pull": "final(abs(joints.J1.force))"})
    assert made.integrals == {}
    with pytest.raises(MbdkitError):
        run("rk4", 0.01, measures={"pull": "integral(joints.J9.force_x)"})
