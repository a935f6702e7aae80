"""Estimates, intervals and predictions against closed forms of an oscillator, and of a body that turns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbdkit.plugin import SpecError
from mbdkit_identify.identify import identify
from tests.margins import assert_within

TRUE = {"m": 1.0, "k": 30.0, "c": 0.6}
NOISE = 0.002


def position(t: np.ndarray, x0: float, v0: float, m: float, k: float, c: float) -> np.ndarray:
    """The position of a mass on a spring and a damper."""
    decay = c / (2 * m)
    rate = np.sqrt(k / m - decay**2)
    return np.exp(-decay * t) * (x0 * np.cos(rate * t) + (v0 + decay * x0) / rate * np.sin(rate * t))


def base(**sections: Any) -> dict[str, Any]:
    return {
        "mbdkit": 1,
        "parameters": {"m": 1.0, "k": 25.0, "c": 0.5},
        "model": {
            "name": "mechanism",
            "gravity": [0, 0],
            "bodies": {"cart": {"mass": "m", "inertia": 1.0, "position": [0.2, 0]}},
            "joints": {"rail": {"type": "prismatic", "bodies": ["ground", "cart"], "at": [0, 0], "axis": [1, 0]}},
            "forces": {
                "spring": {
                    "type": "spring-damper", "bodies": ["ground", "cart"], "points": [[-2, 0], [0, 0]],
                    "stiffness": "k", "damping": "c", "free_length": 2.0,
                }
            },
        },
        "integrator": {"name": "gauss", "stages": 3},
        "time": {"end": 3.0, "step": 0.02},
    } | sections  # fmt: skip


def table(path: Path, time: np.ndarray, **columns: np.ndarray) -> str:
    rows = np.column_stack([time, *columns.values()])
    lines = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join(["# synthetic", ",".join(["time", *columns]), *lines]) + "\n", encoding="utf-8")
    return str(path)


def noisy(values: np.ndarray, seed: int, deviation: float = NOISE, correlation: float = 0.0) -> np.ndarray:
    dice = np.random.default_rng(seed)
    noise = dice.normal(size=len(values))
    for k in range(1, len(values)):
        noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
    return values + deviation * noise


def spec(tmp_path: Path, **changes: Any) -> dict[str, Any]:
    t = np.arange(0.0, 3.001, 0.02)
    file = table(tmp_path / "swing.csv", t, x=noisy(position(t, 0.2, 0.0, **TRUE), 1))
    return {
        "mbdkit_identify": 1,
        "base": base(),
        "experiments": {"swing": {"file": file, "observed": {"cart.x": "x"}}},
        "parameters": {"k": {"bounds": [1, 100]}, "c": {"bounds": [0, 10]}},
        "intervals": {"method": "linear"},
    } | changes  # fmt: skip


def test_estimates_and_deviations_are_those_of_the_closed_form(tmp_path: Path) -> None:
    found = identify(spec(tmp_path))
    t = np.arange(0.0, 3.001, 0.02)
    h = 1e-6
    jacobian = np.stack(
        [
            (
                position(t, 0.2, 0.0, **{**TRUE, name: TRUE[name] * (1 + h)})
                - position(t, 0.2, 0.0, **{**TRUE, name: TRUE[name] * (1 - h)})
            )
            / (2 * h * TRUE[name])
            for name in ("k", "c")
        ],
        axis=1,
    )
    bound = np.sqrt(np.diagonal(np.linalg.inv(jacobian.T @ jacobian))) * NOISE
    for one, least, true in zip(found.estimates.values(), bound, (30.0, 0.6), strict=True):
        assert_within(one.value - true, 4 * least)
        # margin: seeded noise
        assert one.deviation == pytest.approx(
            least, rel=0.25
        )  # the deviation of the noise is estimated from 151 samples
        assert one.upper - one.value == pytest.approx(1.976 * one.deviation, rel=0.02)  # margin: seeded noise
    (residuals,) = found.residuals
    assert residuals.deviation == pytest.approx(NOISE, rel=0.2)  # margin: seeded noise
    assert_within(residuals.correlation, 0.3)
    assert 0.9 <= residuals.covered <= 0.99
    assert found.verdict == "good", found
    assert found.way == "exact"


def test_profiles_of_a_nearly_linear_problem_are_the_linear_intervals(tmp_path: Path) -> None:
    linear = identify(spec(tmp_path))
    found = identify(spec(tmp_path, intervals={"method": "profile", "of": {"rate": "sqrt(k/m)", "double": "2*k"}}))
    for name in ("k", "c"):
        width = linear[name].upper - linear[name].lower
        assert_within(found[name].lower - linear[name].lower, 0.01 * width)
        assert_within(found[name].upper - linear[name].upper, 0.01 * width)
    assert found["double"].lower == pytest.approx(2 * found["k"].lower, rel=1e-5)
    assert found["rate"].upper == pytest.approx(np.sqrt(found["k"].upper), rel=1e-4)
    profile = found.profiles["k"]
    assert np.all(np.diff(profile.values) > 0)
    assert profile.costs[0] == pytest.approx(profile.threshold, rel=0.02)


def test_the_correlation_of_the_noise_widens_the_intervals(tmp_path: Path) -> None:
    t = np.arange(0.0, 3.001, 0.02)
    values = noisy(position(t, 0.2, 0.0, **TRUE), 3, correlation=0.9)
    given = spec(tmp_path)
    given["experiments"]["swing"]["file"] = table(tmp_path / "other.csv", t, x=values)
    found = identify(given)
    given["experiments"]["swing"]["observed"] = {"cart.x": {"column": "x", "correlation": "none"}}
    pooled = identify(given)
    assert found.residuals[0].correlation == pytest.approx(0.9, abs=0.08)  # margin: seeded noise
    assert found["k"].deviation > 1.5 * pooled["k"].deviation
    assert_within(found["k"].value - 30.0, 4 * found["k"].deviation)


def test_mass_stiffness_and_damping_without_force_are_known_as_ratios_only(tmp_path: Path) -> None:
    given = spec(tmp_path, parameters={name: {"bounds": [0.01, 100]} for name in TRUE})
    found = identify(given | {"intervals": {"of": {"ratio": "k/m", "product": "k*m"}}})
    assert not any(found[name].identifiable for name in TRUE)
    assert all(np.isinf(found[name].upper) and np.isnan(found[name].deviation) for name in TRUE)
    assert np.all(np.isnan(found.covariance))
    assert any("k/m" in text or "m/k" in text for text in found.combinations), found.combinations
    assert found["ratio"].lower < 30.0 < found["ratio"].upper
    assert np.isinf(found["product"].upper)


def test_a_mass_that_one_experiment_adds_follows_from_both(tmp_path: Path) -> None:
    t, true = np.arange(0.0, 3.001, 0.02), TRUE | {"m": 1.3}
    heavy = table(tmp_path / "heavy.csv", t, x=noisy(position(t, 0.2, 0.0, **true), 2))
    given = spec(tmp_path, parameters={name: {"bounds": [0.01, 100]} for name in TRUE})
    swing = given["experiments"]["swing"]
    given["experiments"] = {"light": swing | {"overrides": {"parameters.m": 1.0}}, "heavy": swing | {"file": heavy}}
    found = identify(given)
    for name, value in true.items():  # each experiment alone determines ratios only
        assert_within(found[name].value - value, 4 * found[name].deviation)
    assert found["m"].deviation < 0.01
    given["experiments"]["light"]["overrides"] = {"model.bodies.cart.mas": 1.0}
    with pytest.raises(SpecError, match=r"experiments.light.overrides.*mass"):
        identify(given)


def test_bands_of_a_held_out_record_have_the_noise_of_all_fitted_records(tmp_path: Path) -> None:
    t, given = np.arange(0.0, 3.001, 0.02), spec(tmp_path)
    rough = table(tmp_path / "rough.csv", t, x=noisy(position(t, 0.2, 0.0, **TRUE), 2, 4 * NOISE))
    swing = given["experiments"]["swing"]
    given["experiments"] = {"quiet": swing, "rough": swing | {"file": rough}, "later": swing | {"role": "hold-out"}}
    found = identify(given)
    assert found.hold_out[0].deviation == pytest.approx(
        NOISE * np.sqrt((1 + 4**2) / 2), rel=0.2
    )  # margin: seeded noise


def test_an_expression_without_a_finite_value_is_not_determined_and_others_are_kept(tmp_path: Path) -> None:
    found = identify(spec(tmp_path, intervals={"method": "linear", "of": {"root": "sqrt(2 - k)", "double": "2*k"}}))
    assert not found["root"].identifiable
    assert np.isinf([found["root"].lower, found["root"].upper]).all()
    assert found["double"].deviation == pytest.approx(2 * found["k"].deviation)
    assert "root" in found.summary()


def test_a_prior_makes_a_parameter_known(tmp_path: Path) -> None:
    parameters = {"m": {"prior": {"mean": 1.0, "deviation": 0.05}}, "k": {}, "c": {}}
    found = identify(spec(tmp_path, parameters=parameters))
    assert found["m"].identifiable
    assert found["m"].deviation == pytest.approx(0.05, rel=0.01)
    assert found["k"].deviation == pytest.approx(0.05 * 30.0, rel=0.05)  # k/m is known well
    assert found["k"].identifiable


def test_gaps_units_windows_and_initial_states(tmp_path: Path) -> None:
    t = np.arange(1.0, 5.0, 0.013)
    x = noisy(1000 * position(t - 1.0, 0.2, 0.4, **TRUE), 5, deviation=2.0)
    x[40:60] = np.nan
    given = spec(tmp_path)
    given["experiments"]["swing"] = {
        "file": table(tmp_path / "gaps.csv", t, x=x),
        "observed": {"cart.x": {"column": "x", "unit": "mm", "deviation": 2.0}},
        "window": [1.5, 4.5],
        "initial": "estimated",
    }
    found = identify(given)
    assert_within(found["k"].value - 30.0, 4 * found["k"].deviation)
    assert 4 * found["k"].deviation < 0.5
    assert found.residuals[0].time[0] >= 1.5
    assert len(found.residuals[0].time) == np.sum((t >= 1.5) & (t <= 4.5) & np.isfinite(x))
    assert found.residuals[0].deviation == 0.002
    box = {"cart.x": [-1.0, 1.0], "cart.vx": [-5.0, 5.0]}
    given["experiments"]["swing"]["initial"] = box
    assert identify(given)["k"].value == pytest.approx(found["k"].value, rel=1e-6)


def test_sensors_have_gain_offset_and_delay(tmp_path: Path) -> None:
    t = np.arange(0.0, 3.0, 0.01)
    delay, offset, gain = 0.035, 17.0, 400.0
    x = noisy(gain * position(t - delay, 0.2, 0.0, **TRUE) + offset, 7, deviation=0.5)
    given = spec(
        tmp_path,
        sensors={"cart.x": {"gain": "counts", "offset": "zero", "delay": "late"}},
        parameters={
            "k": {}, "c": {"bounds": [0, 10]}, "counts": {"start": 300.0}, "zero": {"start": 0.0},
            "late": {"start": 0.01, "bounds": [0.0, 0.1]},
        },
    )  # fmt: skip
    given["experiments"]["swing"]["file"] = table(tmp_path / "counts.csv", t, x=x)
    found = identify(given)
    for name, true in (("k", 30.0), ("c", 0.6), ("counts", gain), ("zero", offset), ("late", delay)):
        assert_within(found[name].value - true, 4 * found[name].deviation, name)  # margin: seeded noise
    assert found["late"].deviation < 0.002


def test_an_estimate_at_its_bound_has_a_one_sided_interval(tmp_path: Path) -> None:
    t = np.arange(0.0, 3.001, 0.02)
    given = spec(tmp_path, parameters={"k": {}, "c": {"start": 0.5, "bounds": [0.0, 5.0]}})
    values = noisy(position(t, 0.2, 0.0, 1.0, 30.0, 0.0), 12)  # without friction
    seeds = iter(range(12, 30))
    given["experiments"]["swing"]["file"] = table(tmp_path / "free.csv", t, x=values)
    found = identify(given)
    while not found["c"].at_bound:
        values = noisy(position(t, 0.2, 0.0, 1.0, 30.0, 0.0), next(seeds))
        given["experiments"]["swing"]["file"] = table(tmp_path / "free.csv", t, x=values)
        found = identify(given)
    assert found["c"].at_bound == "lower"
    assert found["c"].lower == found["c"].value == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < found["c"].upper < 0.2


def test_hold_out_is_predicted_with_its_band(tmp_path: Path) -> None:
    given = spec(tmp_path)
    t = np.arange(0.0, 2.0, 0.02)
    given["experiments"]["other"] = {
        "file": table(tmp_path / "other.csv", t, x=noisy(position(t, -0.1, 1.0, **TRUE), 8)),
        "observed": {"cart.x": "x"}, "initial": "estimated", "role": "hold-out",
    }  # fmt: skip
    found = identify(given)
    (other,) = found.hold_out
    assert other.rms == pytest.approx(NOISE, rel=0.3)
    assert other.covered > 0.88
    alone = identify(spec(tmp_path))
    assert found["k"].value == alone["k"].value


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy", "arctan"])
def test_a_robust_loss_resists_outliers(tmp_path: Path, loss: str) -> None:
    dice = np.random.default_rng(9)
    t = np.arange(0.0, 3.001, 0.02)
    x = noisy(position(t, 0.2, 0.0, **TRUE), 6)
    clean = identify(
        spec(tmp_path, experiments={"swing": {"file": table(tmp_path / "a.csv", t, x=x), "observed": {"cart.x": "x"}}})
    )
    x[dice.choice(len(t), 12, replace=False)] += dice.uniform(0.05, 0.2, 12)
    one = {"file": table(tmp_path / "b.csv", t, x=x), "observed": {"cart.x": {"column": "x", "correlation": "none"}}}
    least, robust = (identify(spec(tmp_path, experiments={"swing": one}, loss=which)) for which in ("linear", loss))
    assert_within(robust["k"].value - clean["k"].value, 0.3 * abs(least["k"].value - clean["k"].value))
    assert_within(robust["k"].value - 30.0, 4 * robust["k"].deviation)
    assert 4 * robust["k"].deviation < least["k"].deviation
    assert robust["k"].deviation == pytest.approx(clean["k"].deviation, rel=0.5)  # margin: seeded noise


def test_the_model_with_the_right_law_is_the_better_one(tmp_path: Path) -> None:
    right = identify(spec(tmp_path))
    wrong = identify(spec(tmp_path, parameters={"k": {}}, overrides={"parameters.c": 0.0}))
    assert right.compare(wrong).startswith("the first model explains the data better")
    assert wrong.compare(right).startswith("the second model explains the data better")
    assert right.compare(right).startswith("both models explain the data equally well")
    other = identify(
        spec(tmp_path, experiments={"swing": {**spec(tmp_path)["experiments"]["swing"], "window": [0, 1]}})
    )
    with pytest.raises(SpecError, match="these differ"):
        right.compare(other)


def test_the_best_next_experiment_is_the_one_that_moves_what_is_asked(tmp_path: Path) -> None:
    candidates = {
        "same": {},
        "farther": {"overrides": {"model.bodies.cart.position": [1.0, 0]}},
        "short": {"duration": 0.3},
    }
    intervals = {"method": "linear", "of": {"rate": "k/m"}}
    found = identify(spec(tmp_path, candidates=candidates, intervals=intervals))
    asked = identify(spec(tmp_path, candidates=candidates, intervals=intervals, narrow={"quantity": "cart.x^2"}))
    for one, name in ((found, "rate"), (asked, "cart.x^2")):
        assert one.next_experiment is not None
        assert (one.next_experiment.best, one.next_experiment.narrows) == ("farther", name)
    widths = asked.next_experiment.half_widths
    assert widths["farther"]["cart.x^2"] == pytest.approx(widths[""]["cart.x^2"] / np.sqrt(26), rel=2e-2)
    # information adds up: the same experiment once more halves the variance; five times the amplitude, by 26
    assert widths["same"]["k"] == pytest.approx(widths[""]["k"] / np.sqrt(2), rel=1e-2)
    assert widths["farther"]["k"] == pytest.approx(widths[""]["k"] / np.sqrt(26), rel=2e-2)


def test_windows_have_states_of_their_own(tmp_path: Path) -> None:
    found = identify(spec(tmp_path, shooting={"window": 1.0}, intervals={"method": "linear"}))
    whole = identify(spec(tmp_path))
    assert_within(found["k"].value - 30.0, 4 * found["k"].deviation)
    assert found["k"].deviation > whole["k"].deviation


@pytest.mark.slow
def test_noise_of_measured_inputs_is_told(tmp_path: Path) -> None:
    dice = np.random.default_rng(4)
    t = np.arange(0.0, 4.0, 0.02)
    force = np.repeat(dice.normal(size=len(t) // 4), 4)
    driven = base(time={"end": 4.0, "step": 0.02})
    driven["model"]["inputs"] = {"u": {"unit": "N"}}
    driven["model"]["forces"]["push"] = {"type": "force", "body": "cart", "value": ["10*inputs.u", 0]}
    import mbdkit

    table_of = {"u": {"table": [t.tolist(), force.tolist()]}}
    true = {**driven, "parameters": TRUE, "inputs": table_of}
    x = mbdkit.sensitivities(true, "cart.x", t, "k").values[0]
    measured = force + dice.normal(0.0, 0.05, len(t))
    file = table(tmp_path / "driven.csv", t, x=noisy(x, 2, 0.001), u=measured)
    experiment = {
        "file": file, "observed": {"cart.x": "x"}, "inputs": {"u": {"column": "u", "deviation": 0.05}},
    }  # fmt: skip
    given = spec(tmp_path, base=driven, experiments={"driven": experiment}, parameters={"k": {}, "c": {}, "m": {}})
    found = identify(given)
    assert any(note.startswith("noise of the measured inputs biases") for note in found.notes)
    for name, value in TRUE.items():
        assert_within(found[name].value - value, 4 * found[name].deviation, name)
    experiment["inputs"] = {"u": "u"}
    assert identify(given)["m"].deviation < found["m"].deviation


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("experiments", "swing", "file"), "no.csv", r"experiments\.swing\.file: there is no such file: .*no\.csv"),
        (("experiments", "swing", "time"), "t", r"experiments\.swing\.time: .*has no column 't'"),
        (("experiments", "swing", "observed"), {"cart.x": "y"},
         r"experiments\.swing\.observed\.\W*cart\.x\W*\.column: .*has no column 'y'"),
        (("experiments", "swing", "observed"), {"car.x": "x"}, r"experiments\.swing\.observed\.\W*car\.x.*'car'"),
        (("experiments", "swing", "observed"), {"cart.x": {"column": "x", "unit": "deg"}}, r"unit: the unit deg of"),
        (("experiments", "swing", "observed"), {}, r"observed: needs at least one quantity"),
        (("experiments", "swing", "initial"), "guessed", r"initial: should be `estimated`, `rest`"),
        (("experiments", "swing", "initial"), {"cart.z": 1.0}, r"^experiments\.swing\.initial.*cart\.z"),
        (("experiments", "swing", "initial"), {"cart.x": "3 mm"}, r"\W*cart\.x\W*: .*in SI units, 0\.003 \[m\]"),
        (("experiments", "swing", "window"), [5.0, 6.0], r"fewer than 3 values"),
        (("experiments", "swing", "inputs"), {"u": "x"}, r"the mechanism has no input 'u'"),
        (("experiments", "swing", "role"), "hold-out", r"needs at least one experiment with `role: fit`"),
        (("parameters", "kk"), {}, r"parameters\.kk: neither the base nor a sensor has the parameter 'kk'"),
        (("parameters", "k"), {"bounds": [3, 1]}, r"bounds: the lower bound 3 should be below"),
        (("parameters", "k"), {"start": 500.0, "bounds": [1, 100]}, r"start: is outside of the bounds"),
        (("parameters", "k"), {"start": "5 N/mm"}, r"parameters\.k\.start: should be .* in SI units, 5000 \[N/m\]"),
        (("parameters", "k"), {"bounds": [1, "5 N/mm"]}, r"parameters\.k\.bounds\[1\]: .*5000 \[N/m\], not '5 N/mm'"),
        (("sensors",), {"cart.x": {"offset": "3 mm"}}, r"sensors\.\W*cart\.x\W*\.offset: .*0\.003 \[m\]"),
        (("parameters",), {}, r"parameters: needs at least one parameter"),
        (("parameters", "model.bodies.cart.mas"), {}, r"the base has no 'model.bodies.cart.mas' \(did you mean 'mass'"),
        (("parameters", "model.bodies.cart"), {}, r"'model.bodies.cart' is not a number"),
        (("candidates",), {"next": {"observed": ["cart.y"]}}, r"candidates\.next\.observed: .*'cart.y'"),
        (("sensors",), {"cart.x": {"offset": "zero"}}, r"sensors: .*'zero'"),
        (("sensors",), {"cart.y": {"offset": 1.0}}, r"no experiment observes this quantity"),
        (("intervals",), {"of": {"r": "k/q"}}, r"intervals\.of\.r: .*'q'"),
        (("base",), {"mbdkit": 1}, r"base"),
        (("starts",), 3, r"several starts need bounds"),
        (("candidates",), {"next": {"like": "other"}}, r"no experiment 'other'"),
    ],
)  # fmt: skip
def test_wrong_input_is_one_sentence(tmp_path: Path, path: tuple[str, ...], value: Any, message: str) -> None:
    given = spec(tmp_path)
    if path == ("starts",):
        given["parameters"] = {"k": {}}
    holder = given
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    with pytest.raises(SpecError, match=message) as caught:
        identify(given)
    assert "\n" not in str(caught.value).split("also:")[0].strip()
