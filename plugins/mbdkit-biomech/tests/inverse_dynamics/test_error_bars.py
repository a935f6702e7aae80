"""Error bars of inverse dynamics cover the truth, and agree with noise that passes through the whole computation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, filtfilt
from scipy.stats import chi2
from tests.inverse_dynamics.moved_linkages import TORQUES, moved
from tests.inverse_dynamics.noisy import CUTOFF, DEVIATION, Truth, covered
from tests.inverse_dynamics.noisy_pendulum import T, pendulum

import mbdkit
from mbdkit import SpecError
from mbdkit.spec import load_spec
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.errors.error_bars import _norm_bound
from mbdkit_biomech.inverse_dynamics.results import measure_samples
from mbdkit_biomech.inverse_dynamics.results.measure_samples import SAMPLES, SampledMeasures
from mbdkit_biomech.inverse_dynamics.results.workload import workload
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_report import run_report
from tests.benchmarks.drawn_coverage import coverage
from tests.margins import assert_within


@pytest.fixture(scope="module")
def loops(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Truth, dict[str, Any]]]:
    """The truth of a forward run of each closed loop, and the spec that gives its motion back."""
    found = {}
    for example in TORQUES:
        run, spec = moved(example, tmp_path_factory.mktemp("loops") / f"{example}.h5")
        found[example] = Truth.of(example, run, spec["actuators"]), spec
    return found


@pytest.mark.parametrize("seed", [2])
def test_bars_cover_true_torques_and_joint_forces_of_closed_loops(
    loops: dict[str, tuple[Truth, dict[str, Any]]], seed: int
) -> None:
    # few samples of correlated noise, so that only means over the examples are compared; below, each actuator and joint
    shares = [
        [np.mean(one) for one in covered(*loops[name], CUTOFF[name], 3, seed=seed, errors={"samples": 60})]
        for name in loops
    ]
    assert np.all((np.mean(shares, axis=0) >= 0.9) & (np.mean(shares, axis=0) <= 0.99))


@pytest.mark.slow
@pytest.mark.parametrize("example", list(TORQUES))
def test_bars_of_each_actuator_and_joint_cover_the_truth(
    loops: dict[str, tuple[Truth, dict[str, Any]]], example: str
) -> None:
    both = [covered(*loops[example], CUTOFF[example], 40, seed=seed) for seed in (101, 102)]
    for shares in zip(*both, strict=True):
        share = np.mean(shares, axis=0)
        assert np.all((share >= 0.9) & (share <= 0.99)), share


def test_bars_are_those_of_noise_that_passes_through_the_whole_computation() -> None:
    # three markers on the leg of a four-bar knee, no smoothing: the bars are those of noise alone
    run = mbdkit.run("knee", time={"end": 0.6, "step": 0.02})
    shank = run["shank"]
    points = np.array([[0.0, 0.2], [0.03, -0.2], [-0.02, 0.1]])
    turn = np.exp(1j * shank.angle)[:, None] * (points[:, 0] + 1j * points[:, 1])
    data = {"time": run.time}
    for place in range(3):
        data[f"m{place}.x"], data[f"m{place}.y"] = (
            shank.position[:, 0] + turn[:, place].real,
            shank.position[:, 1] + turn[:, place].imag,
        )
    model = load_spec("knee").mechanism().to_spec()
    model["markers"] = {f"m{place}": {"body": "shank", "point": point} for place, point in enumerate(points.tolist())}
    columns = {name: {"column": name, "deviation": 1e-5} for name in data if name != "time"}
    spec = {"mbdkit": 1, "model": model, "actuators": {"knee": {"joint": "A"}}}
    spec["motion"] = {"data": data, "columns": columns, "smooth": "quintic", "errors": {"samples": 400}}
    bars = mbdkit.inverse(spec)
    random, values = np.random.default_rng(5), []
    for _ in range(40):
        noisy = {k: x if k == "time" else x + 1e-5 * random.standard_normal(len(x)) for k, x in data.items()}
        one = compute(InverseProblem.of(load_inverse_spec({**spec, "motion": {**spec["motion"], "data": noisy}}, ())))
        values.append(one.dynamics.value[:, 0])
    error = np.array(values) - bars.actuators["knee"].value
    expected = bars.actuators["knee"].value_error / 1.959964
    ratio = (np.mean(error**2, axis=0) / expected**2)[8:-8]  # near the ends, bars also contain the effect of the ends
    assert_within(np.mean(ratio) - 1, 0.15)  # margin: seeded noise
    assert np.all((ratio > 0.4) & (ratio < 1.8))


def test_markers_with_noise_close_all_joints_and_have_the_residuals_and_misalignment_of_the_noise() -> None:
    run = mbdkit.run("knee", time={"end": 0.6, "step": 0.004})
    model = load_spec("knee").mechanism().to_spec()
    model["markers"], data, random = {}, {"time": run.time}, np.random.default_rng(11)
    for name, joint in model["joints"].items():  # a marker at every joint, on each body that moves
        for body, (x, y) in zip(joint["bodies"], joint["points"], strict=True):
            if body == "ground":
                continue
            marker, own = f"{name} {body}", run[body]
            model["markers"][marker] = {"body": body, "point": [x, y]}
            point = own.position[:, 0] + 1j * own.position[:, 1] + np.exp(1j * own.angle) * (x + 1j * y)
            for axis, values in (("x", point.real), ("y", point.imag)):
                data[f"{marker}.{axis}"] = values + DEVIATION * random.standard_normal(len(values))
    motion = {"data": data, "smooth": {"name": "butterworth", "cutoff": 12.0}}
    fitted = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": motion, "actuators": {"knee": {"joint": "A"}}})
    assert_within(fitted.misalignment_max, 1e-15)
    rows, residual = len(run.time), fitted.array("motion/residual")
    assert residual.shape == (rows, 12)
    # 12 coordinates of markers and one degree of freedom leave 11 in each row
    squares, freedoms = np.sum(residual**2) / DEVIATION**2, 11 * rows
    assert chi2.ppf(0.001, freedoms) < squares < chi2.ppf(0.999, freedoms)
    # a body between two markers: half the variance along it, all of it across, thus 1.5 variances at each end
    for place, name in enumerate(fitted.joint_names):
        ends = sum(body != "ground" for body in model["joints"][name]["bodies"])
        mean = np.mean(fitted.array("motion/raw_misalignment")[:, place] ** 2) / DEVIATION**2
        assert_within(mean - 1.5 * ends, 4 * ends * np.sqrt(2.5 / rows))
    # the deviations that the residuals tell
    told = fitted.accuracy.method if fitted.accuracy else ""
    assert told.count(" m") >= 6


def test_the_deviation_of_the_noise_is_seen_in_the_residuals_of_the_smoothing() -> None:
    run = mbdkit.inverse(pendulum(smooth={"name": "butterworth", "cutoff": 6.0}))
    assert run.accuracy is not None
    told = float(run.accuracy.method.partition("hip.angle ")[2].split()[0])
    assert_within(told / DEVIATION - 1, 0.2)  # margin: seeded noise
    assert run.accuracy.known_until == run.time[-1]


@pytest.mark.parametrize(
    "smooth", [{"name": "spline"}, {"name": "spline", "parameter": 1e-4}, {"name": "opensim", "cutoff": 6}]
)
def test_every_smoothing_has_bars(smooth: dict[str, Any]) -> None:
    run = mbdkit.inverse(pendulum(smooth=smooth, errors={"samples": 40}))
    exact = -0.35 * 4.5 * np.sin(3 * T) + 0.5 * 9.81 * np.sin(0.5 * np.sin(3 * T))
    one = run.actuators["hip"]
    assert np.mean((np.abs(one.value - exact) <= one.value_error)[15:-15]) > 0.9
    assert np.median(one.value_error) < 1.0
    assert "0.8 and 1.25 times the cutoff" in (run.accuracy.method if run.accuracy else "")


@pytest.mark.parametrize("motion", [{"errors": "none", "smooth": {"name": "butterworth", "cutoff": 6.0}}, {}])
def test_without_noise_that_is_known_bars_are_nan(motion: dict[str, Any]) -> None:
    run = mbdkit.inverse(pendulum(**motion))
    assert run.accuracy is None
    assert np.all(np.isnan(run.actuators["hip"].value_error))
    assert ("errors unknown" in run.summary()) == (not motion)
    assert workload(run)["hip"].load.peak_error is None
    run.check()


def test_a_deviation_has_the_unit_of_its_column() -> None:
    spec = pendulum(smooth="quintic")
    spec["motion"]["columns"]["hip.angle"]["deviation"] = 1.0
    run = mbdkit.inverse(spec)
    assert "hip.angle 0.0175 rad (stated)" in (run.accuracy.method if run.accuracy else "")


def test_a_deviation_that_is_not_positive_is_refused() -> None:
    spec = pendulum(smooth="quintic")
    spec["motion"]["columns"]["hip.angle"]["deviation"] = -1.0
    with pytest.raises(SpecError, match="deviation"):
        mbdkit.inverse(spec)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0])
def test_the_norm_of_a_gaussian_vector_stays_below_its_bound(ratio: float) -> None:
    random = np.random.default_rng(1).standard_normal((200_000, 2)) * [1.0, ratio]
    bound = _norm_bound(np.array(1.0), np.array(ratio**2), np.array(0.0))
    assert_within(np.mean(np.linalg.norm(random, axis=1) <= bound) - 0.95, 0.004)


def test_noise_of_loads_has_the_bars_of_its_lever() -> None:
    # expected: the torque of the hip is -(x F_y - y F_x + M), with noise of F, of the point (x, y) in space, and of M
    spec = pendulum(smooth="quintic")
    push = np.where(T < 1.0, 5.0 + T, 0.0)
    spec["motion"]["columns"]["hip.angle"]["deviation"] = 1e-9
    spec["motion"]["data"] |= {"fx": push, "fy": -2 * push, "x": 0.3 + 0 * T, "y": -400.0 + 0 * T, "m": 0.1 * push}
    spec["loads"] = {
        "push": {
            "body": "rod",
            "force": [{"column": "fx", "deviation": 0.2}, {"column": "fy", "unit": "N", "deviation": 0.3}],
            "point": [{"column": "x", "deviation": 0.01}, {"column": "y", "unit": "mm", "deviation": 20.0}],
            "torque": {"column": "m", "deviation": 0.05},
        }
    }
    run = mbdkit.inverse(spec)
    variance = (0.4 * 0.2) ** 2 + (0.3 * 0.3) ** 2 + (2 * push * 0.01) ** 2 + (push * 0.02) ** 2 + 0.05**2
    expected = 1.959964 * np.sqrt(np.where(push > 0, variance, 0.0))
    inner = slice(16, -16)  # without the effect of the ends
    np.testing.assert_allclose(run.actuators["hip"].value_error[inner], expected[inner], rtol=1e-3, atol=1e-4)
    assert run.accuracy is not None
    assert "push.force.x 0.2 N, push.force.y 0.3 N, push.torque 0.05 N m, push.point.x 0.01 m" in run.accuracy.method
    # margin: the noise of F_x adds to it
    assert run.accuracy.reaction_error[16, 0] == pytest.approx(1.96 * 0.3, rel=0.12)  # F_y has the larger noise
    assert "deviation" in run.spec["loads"]["push"]["torque"]
    assert "count as exact" not in run.summary() + mbdkit.workload(run).text()
    spec["loads"]["push"]["torque"] = "m"
    run = mbdkit.inverse(spec)
    for text in (run.summary(), mbdkit.workload(run).text()):
        assert "loads count as exact where columns have no `deviation`: push" in text


def test_without_noise_the_bar_is_the_change_with_the_cutoff(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure_samples, "SAMPLES", 5)

    # expected: the root of the mean square of the changes at 0.8 and 1.25 times the cutoff, each computed for itself
    def at(cutoff: float) -> mbdkit.Run:
        spec = pendulum(smooth={"name": "butterworth", "cutoff": cutoff}, errors={"samples": 20})
        spec["motion"]["columns"]["hip.angle"]["deviation"] = 1e-9
        time = np.linspace(0.0, 3.0, 301)
        wave = 0.5 * np.sin(9 * time) * np.exp(-2 * (time - 1.5) ** 2)
        spec["motion"]["data"] = {"time": time, "hip": np.degrees(wave)}
        return mbdkit.inverse(spec | {"measures": {"peak": "max(abs(actuators.hip.value))"}})

    run, low, high = at(6.0), at(4.8), at(7.5)
    torque = [one.actuators["hip"].value for one in (run, low, high)]
    force = [one.joints["hip"].reaction_force for one in (run, low, high)]
    assert run.accuracy is not None
    changes = np.sqrt(((torque[1] - torque[0]) ** 2 + (torque[2] - torque[0]) ** 2) / 2)
    inside = slice(50, -50)  # three periods of the cutoff, where the ends have no effect
    np.testing.assert_allclose(run.actuators["hip"].value_error[inside], changes[inside], rtol=1e-4, atol=1e-4)
    squares = np.mean([np.sum((one - force[0]) ** 2, axis=1) for one in force[1:]], axis=0)
    np.testing.assert_allclose(run.accuracy.reaction_error[inside, 0], np.sqrt(squares)[inside], rtol=1e-4, atol=1e-4)
    assert np.max(changes[inside]) > 0.01
    peak, *others = (one.measures["peak"] for one in (run, low, high))
    assert run.measure_errors["peak"] == pytest.approx(np.sqrt(np.mean((np.array(others) - peak) ** 2)), rel=1e-4)
    assert "0.8 and 1.25 times the cutoff" in run.accuracy.method
    assert f"+- {run.measure_errors['peak']:.2g} N m" in run.summary()  # the measure of this peak
    (chart,) = [one for one in run_report(run).verdict.figures if one.name == "torques"]
    band = chart.lines[0].band
    assert band is not None
    assert band[-1, 1] - band[0, 1] == pytest.approx(2 * run.actuators["hip"].value_error[0])


@pytest.mark.parametrize("random_coordinates", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_bars_cover_the_truth_of_random_mechanisms_whatever_is_smoothed(random_coordinates: bool) -> None:
    # a reduced size of `python -m tests.benchmarks.inverse_coverage`, with 48 mechanisms and 20 noises
    numbers = (3, 6, 13, 22) if not random_coordinates else (13, 22)
    noises = 2 if random_coordinates else 1
    found = [coverage(number, noises, random_coordinates=random_coordinates) for number in numbers]
    for shares in ([one.torques for one in found], [one.forces for one in found]):
        assert 0.9 <= np.mean(np.concatenate(shares)) <= 0.99


def test_what_is_smoothed_instead_of_the_measured_columns_is_part_of_the_bar() -> None:
    # two markers with four columns for two degrees of freedom, without noise: angles are smoothed. Expected: the mean
    # square change with the cutoff, and the square of the change if SciPy filters the columns of the markers instead
    m = mbdkit.Mechanism()
    m.body("upper", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("lower", mass=1.0, inertia=0.1, position=(1.0, 0.5), angle=np.pi / 2)
    m.revolute("hip", m.ground, "upper", at=(0, 0))
    m.revolute("knee", "upper", "lower", at=(1, 0))
    m.marker("knee", "upper", at=(1.0, 0.0))
    m.marker("toe", "lower", at=(1.0, 1.0))
    hip, knee = 0.6 * np.sin(9 * T), np.pi / 2 + 0.8 * np.cos(10 * T)
    first = np.exp(1j * hip)
    second = first + np.exp(1j * (hip + knee))
    data = {"knee.x": first.real, "knee.y": first.imag, "toe.x": second.real, "toe.y": second.imag}

    def at(cutoff: float | None, columns: dict[str, np.ndarray]) -> mbdkit.Run:
        smooth = "quintic" if cutoff is None else {"name": "butterworth", "cutoff": cutoff}
        named = {f"markers.{name}": {"column": name, "deviation": 1e-9} for name in columns}
        motion = {"data": {"time": T, **columns}, "columns": named, "smooth": smooth}
        actuators = {"hip": {"joint": "hip"}, "knee": {"joint": "knee"}}
        return mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion, "actuators": actuators})

    b, a = butter(2, 6.0 / (2**0.5 - 1) ** 0.25, fs=100.0)
    filtered = {name: filtfilt(b, a, values, padtype="odd", padlen=34) for name, values in data.items()}
    run = at(6.0, data)
    for name in ("hip", "knee"):
        own, low, high, other = (
            one.actuators[name].value for one in (run, at(4.8, data), at(7.5, data), at(None, filtered))
        )
        expected = np.sqrt(((low - own) ** 2 + (high - own) ** 2) / 2 + (other - own) ** 2)
        inside = slice(34, -34)  # two periods of the cutoff from the ends, which have an error of their own
        assert_within((run.actuators[name].value_error - expected)[inside], 1e-3 * np.max(expected[inside]))
        assert np.max(np.abs(other - own)) > 0.1 * np.max(expected)
    assert run.accuracy is not None
    assert "smoothing of markers.knee.x, markers.knee.y, markers.toe.x and markers.toe.y" in run.accuracy.method


def test_errors_of_largest_values_cover_the_bias_that_noise_causes() -> None:
    # the truth is the largest value of a parabola; without smoothing, noise of up to five times its height remains
    random, top = np.random.default_rng(6), 1.0 - np.linspace(-1.0, 1.0, 200) ** 2
    for deviation in (0.02, 0.2, 5.0):
        covered = []
        for _ in range(200):
            data = top + deviation * random.standard_normal(200)
            noisy = np.max(data + deviation * random.standard_normal((SAMPLES, 200)), axis=1)[:, None]
            found = SampledMeasures(np.array([np.max(data)]), noisy, *[np.zeros((0, 1))] * 3)
            covered.append(abs(found.value[0] - 1.0) <= found.bounds()[0])
        assert np.mean(covered) > 0.85


def test_the_summary_says_why_errors_are_unknown() -> None:
    spec = pendulum(smooth="quintic")
    assert "state the `deviation` of each column, or smooth the motion" in mbdkit.inverse(spec).summary()
    spec = pendulum()
    spec["motion"]["data"] |= {"rate": 1.5 * np.cos(3 * T), "acceleration": -4.5 * np.sin(3 * T)}
    spec["motion"]["columns"] = {"hip.angle": {"column": "hip", "rate": "rate", "acceleration": "acceleration"}}
    summary = mbdkit.inverse(spec).summary()
    assert "errors unknown: velocities and accelerations are those of columns, whose errors are not known" in summary
    assert "state the `deviation`" not in summary
