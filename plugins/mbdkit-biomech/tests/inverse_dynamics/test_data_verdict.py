"""Absurd data are refused or make the verdict doubtful, by criteria with names; plausible data are not."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.hanging_leg import ANGLES, NOISE, SMOOTH, T, leg, not_of_ends, stance, told

import mbdkit
import mbdkit_biomech
from mbdkit import SpecError
from mbdkit.spec.item_names import CriterionName
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.column_criteria import suspicious_columns
from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import doubts_before_computation
from mbdkit_biomech.inverse_dynamics.criteria.marker_distances import exchanged_markers
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.benchmarks.drawn_faults import FAULTS, outcomes

PARTS = {"x": "real", "y": "imag"}


def test_plausible_data_are_not_doubted() -> None:
    run = leg(loads=stance())
    assert (run.verdict, run.verdict_reasons, run.warnings) == ("unknown", [], [])


def test_degrees_without_a_unit_are_doubted_until_the_unit_is_given() -> None:
    degrees = {name: np.degrees(x) for name, x in ANGLES.items()}
    run = leg(degrees)
    assert run.verdict == "doubtful"
    assert "units" in told(run)
    assert "they look like degrees; write `unit: deg`" in run.verdict_reasons[0]
    columns = {name: {"column": name, "unit": "deg"} for name in degrees}
    assert told(leg(degrees, motion={"columns": columns})) <= {"ends"}


def test_milliseconds_without_a_unit_are_doubted_until_the_unit_is_given() -> None:
    data = {"t": 1e3 * T, **ANGLES}
    with pytest.raises(SpecError, match=r"1 samples per second, .*in milliseconds, write `time: .*; if they are"):
        leg(motion={"data": {**data, "t": 1e2 * T}, "time": "t"})
    columns = {"columns": {name: name for name in ANGLES}, "smooth": "quintic", "time": "t", "data": data}
    run = leg(motion=columns, accept=["times", "units"])
    assert told(run) == {"time-unit"}
    assert "they look like milliseconds; write `time: {column: t, unit: ms}`" in run.verdict_reasons[0]
    in_ms = {**columns, "time": {"column": "t", "unit": "ms"}}
    # the torques of the same motion with its times in seconds, which do not depend on how the times are written
    expected = leg(motion={**columns, "data": {**data, "t": T}})
    found = leg(motion=in_ms)
    assert not found.verdict_reasons
    knee = expected.actuators["knee_flexion"].value
    assert found.actuators["knee_flexion"].value == pytest.approx(knee, rel=1e-6, abs=1e-6 * np.ptp(knee))
    reverse = leg(motion={**in_ms, "data": {**data, "t": T}})
    assert "time-unit" in told(reverse)


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        (lambda x: 1e3 * x, "column of toe.x: .* no `unit`: they look like millimetres"),
        (lambda x: np.where(np.arange(len(x)) == 9, -999.0, x), "column of toe.x: the value at t = 0.72 s is"),
        pytest.param(
            lambda x: 3.5 * x,
            r"toe.x: its range of \S+ m \(\S+ times the longest link\) is \S+ times the median range",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_refusal_of_a_fit_names_the_suspicious_column(
    fault: Callable[[np.ndarray], np.ndarray], cause: str
) -> None:
    # markers of a double pendulum whose hip moves, from its geometry
    m = mbdkit.Mechanism()
    m.body("thigh", mass=1.0, inertia=0.1, position=(0.0, -0.2), angle=-np.pi / 2)
    m.body("shank", mass=1.0, inertia=0.1, position=(0.0, -0.6), angle=-np.pi / 2)
    m.revolute("knee", "thigh", "shank", at=(0.0, -0.4))
    for name, body, at in (("hip", "thigh", -0.2), ("knee_marker", "thigh", 0.2), ("toe", "shank", 0.2)):
        m.marker(name, body, point=(at, 0.0))
    t = T[:160:8]
    hip = 0.5 * t + 0j
    knee = hip + 0.4 * np.exp(1j * (-np.pi / 2 + 0.5 * np.sin(4 * t)))
    toe = knee + 0.4 * np.exp(1j * (-np.pi / 2 + 0.7 * np.sin(4 * t)))
    data = {"hip.x": hip.real, "hip.y": hip.imag, "knee_marker.x": knee.real, "knee_marker.y": knee.imag}
    data |= {"toe.x": fault(toe.real), "toe.y": toe.imag}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": {"time": t, **data}, "smooth": "quintic"}}
    with pytest.raises(mbdkit.RunError, match=cause):
        mbdkit.inverse(spec)


@pytest.mark.parametrize(
    ("exchanged", "bodies"),
    [pytest.param(("heel", "toe"), "foot", id="one-body"), pytest.param(("knee", "toe"), "shank and foot", id="two")],
)
def test_exchanged_markers_are_named(exchanged: tuple[str, str], bodies: str) -> None:
    m, places = shank_and_foot("shank", swing=0.3)
    one, other = exchanged
    places[one], places[other] = places[other], places[one]
    sentence = f"markers {one} and {other} of {bodies} are probably exchanged: with the columns of the other one, the"
    said = said_of_markers(m, places)
    assert any(sentence in one for one in said), said


def test_markers_that_fit_are_not_exchanged() -> None:
    m = mbdkit.Mechanism()
    m.body("thigh", mass=1.0, inertia=0.1, position=(0.0, -0.2), angle=-np.pi / 2)
    m.body("shank", mass=1.0, inertia=0.1, position=(0.0, -0.6), angle=-np.pi / 2)
    m.revolute("knee", "thigh", "shank", at=(0.0, -0.4))
    for name, body, at in (("hip", "thigh", -0.2), ("bend", "thigh", 0.2), ("ankle", "shank", 0.2)):
        m.marker(name, body, point=(at, 0.0))
    t = np.linspace(0.0, 1.0, 21)
    knee = 0.4 * np.exp(1j * (-1.5 + 0.2 * np.sin(t)))
    places = {"hip": 0j * t, "bend": knee, "ankle": knee + 0.403 * np.exp(1j * (-1.5 - 0.3 * np.sin(t)))}
    data = {f"{name}.{axis}": part for name, z in places.items() for axis, part in (("x", z.real), ("y", z.imag))}
    spec = load_inverse_spec({"mbdkit": 1, "model": m.to_spec(), "motion": {"data": {"time": t, **data}}})
    problem = InverseProblem.of(spec)
    pose = problem.prepared.equations.q0
    assert exchanged_markers(problem.fitter, problem.measured, 5, pose) is None


@pytest.mark.parametrize("swing", [pytest.param(0.06, id="small-residuals"), pytest.param(0.3, id="large-residuals")])
def test_a_marker_on_the_wrong_body_is_named_with_the_right_one(swing: float) -> None:
    assert not said_of_markers(*shank_and_foot("shank", swing))
    (reason,) = said_of_markers(*shank_and_foot("foot", swing))
    assert ("does not fit the data" in reason) == (swing == 0.3)
    assert "marker tibia of foot contradicts the others" in reason
    assert "it seems to be on shank, where it moves by 0.00" in reason


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        pytest.param(lambda z: z.imag + 1j * z.real, "x and y exchanged", id="exchanged"),
        pytest.param(np.conj, "the sign of y reversed", id="y-down", marks=pytest.mark.slow),
        pytest.param(lambda z: -z.conj(), "the sign of x reversed", id="x-backwards", marks=pytest.mark.slow),
        pytest.param(lambda z: z.real + 0.1j * np.abs(z), "z in place of y", id="z-up"),
    ],
)
def test_wrong_axes_of_all_markers_are_named(change: Callable[[np.ndarray], np.ndarray], cause: str) -> None:
    m, places = shank_and_foot("shank", swing=0.3)
    upward = {f"{name}.z": at.imag for name, at in places.items()} if cause.startswith("z") else {}
    (said,) = said_of_markers(m, {name: change(at) for name, at in places.items()}, upward)
    assert said.rstrip(".").endswith(f"the axes of the markers are probably wrong: the mechanism fits with {cause}")


def shank_and_foot(body_of_tibia: str, swing: float) -> tuple[mbdkit.Mechanism, dict[str, np.ndarray]]:
    """Return a shank that hangs from its knee, its foot, and the places of markers, from their geometry."""
    m = mbdkit.Mechanism()
    m.body("shank", mass=3.0, inertia=0.05, position=(0.3, 0.0), angle=-np.pi / 2)
    m.body("foot", mass=1.0, inertia=0.004, position=(0.36, -0.24))
    m.revolute("knee_joint", m.ground, "shank", at=(0.3, 0.2))
    m.revolute("ankle", "shank", "foot", at=(0.3, -0.2))
    m.marker("knee", "shank", point=(-0.2, 0.0))
    m.marker("tibia", body_of_tibia, point={"shank": (0.0, 0.05), "foot": (-0.01, 0.24)}[body_of_tibia])
    for name, point in (("heel", (-0.1, 0.0)), ("toe", (0.15, 0.0))):
        m.marker(name, "foot", point=point)
    knee = 0.3 + 0.2j
    shank, foot = np.exp(1j * (swing * np.sin(3 * T) - np.pi / 2)), np.exp(0.2j * np.cos(3 * T))
    middle = 0.4 * shank + (0.06 - 0.04j) * foot
    places = {"knee": 0 * T, "tibia": (0.2 + 0.05j) * shank, "heel": middle - 0.1 * foot, "toe": middle + 0.15 * foot}
    noise = 1e-3 * np.random.default_rng(4).standard_normal((2, len(places), len(T)))
    return m, {
        name: knee + at + real + 1j * imag for (name, at), real, imag in zip(places.items(), *noise, strict=True)
    }


def said_of_markers(m: mbdkit.Mechanism, places: dict[str, np.ndarray], more: Mapping[str, Any] = {}) -> list[str]:
    """Return the reasons for the verdict on the places of markers, with more columns, or the error."""
    data = {f"{name}.{axis}": getattr(at, part) for name, at in places.items() for axis, part in PARTS.items()}
    motion = {"data": {"time": T, **data, **more}, "smooth": "quintic", "errors": "none"}
    try:
        spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "unbalanced": "report"}
        return mbdkit.inverse(spec).verdict_reasons
    except mbdkit.RunError as error:
        return [str(error)]


@pytest.mark.parametrize("second_body", [pytest.param("rod", id="one-body"), pytest.param("other", id="two-bodies")])
def test_a_table_of_markers_in_another_unit_than_it_states_is_refused_with_a_hint(
    second_body: str, tmp_path: Path
) -> None:
    # a rod with a second rod pinned to its end, in millimetres although the file states metres
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1)
    m.body("other", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin", "rod", "other", at=(0.25, 0.0))
    m.marker("A", "rod", point=(-0.2, 0.0))
    m.marker("B", second_body, point=(0.2, 0.0))
    b = 200.0 if second_body == "rod" else 700.0
    rows = "\n".join(f"{i + 1}\t{0.01 * i:.2f}\t-200\t{i}\t0\t{b:g}\t{i}\t0" for i in range(20))
    counts = "100\t100\t20\t2\tm\t100\t1\t20"
    head = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
    names = "Frame#\tTime\tA\t\t\tB\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2"
    file = tmp_path / "m.trc"
    file.write_text(f"PathFileType\t4\t(X/Y/Z)\tm.trc\n{head}\n{counts}\n{names}\n\n{rows}\n")
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": {"file": str(file), "smooth": "none"}}
    problem = InverseProblem.of(load_inverse_spec(spec, ()))
    (hint,) = suspicious_columns(problem.measured, problem.fitter.manifold.length, no_pose=True)
    assert hint.endswith("check the unit of the markers")
    (tmp_path / "right.trc").write_text(file.read_text().replace("\tm\t", "\tmm\t"))
    spec["motion"]["file"] = str(tmp_path / "right.trc")
    problem = InverseProblem.of(load_inverse_spec(spec, ()))
    assert not suspicious_columns(problem.measured, problem.fitter.manifold.length, no_pose=True)


def test_a_load_takes_the_times_of_the_motion_from_its_table() -> None:
    data = {"t": 1e3 * T, **ANGLES, "f": 50 * np.sin(T)}
    motion = {"data": data, "time": {"column": "t", "unit": "ms"}, "columns": {name: name for name in ANGLES}}
    run = leg(motion=motion, loads={"pull": {"body": "foot", "force": ["f", 0.0]}})
    assert run.loads["pull"].force[:, 0] == pytest.approx(data["f"])
    with pytest.raises(SpecError, match="'mm' is not a unit of time"):
        leg(motion={**motion, "time": {"column": "t", "unit": "mm"}})


def test_radians_declared_as_degrees_are_doubted_but_one_small_angle_is_not() -> None:
    columns = {name: {"column": name, "unit": "deg"} for name in ANGLES}
    (reason,) = leg(motion={"columns": columns}).verdict_reasons
    assert reason.startswith("units: the angles with `unit: deg` (hip_flexion, knee_flexion and ankle_dorsiflexion)")
    assert "they look like radians" in reason
    only_knee = {**{name: name for name in ANGLES}, "knee_flexion": columns["knee_flexion"]}
    assert "(knee_flexion)" in leg(motion={"columns": only_knee}).verdict_reasons[0]
    degrees = {name: np.degrees(x) for name, x in ANGLES.items()} | {"ankle_dorsiflexion": 5 * ANGLES["hip_flexion"]}
    assert "units" not in told(leg(degrees, motion={"columns": columns}))


def test_a_crank_that_turns_in_radians_is_not_taken_for_degrees() -> None:
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("hip", m.ground, "rod", at=(0, 0))
    motion = {"data": {"time": T, "hip.angle": 30 * T + 0.3 * np.sin(4 * T) + NOISE[0]}, "smooth": SMOOTH}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion}
    assert mbdkit.inverse(spec).verdict == "unknown"
    motion["data"] = motion["data"] | {"hip.angle": 150 * T}
    assert told(mbdkit.inverse(spec)) == {"turns"}


def test_a_unit_that_contradicts_the_file_is_named(tmp_path: Path) -> None:
    table = np.column_stack([T, *(np.degrees(x) for x in ANGLES.values())])
    (tmp_path / "t.csv").write_text(f"time,{','.join(ANGLES)}\ns,deg,deg,deg\n")
    with (tmp_path / "t.csv").open("a") as file:
        np.savetxt(file, table, delimiter=",")
    spec = {"mbdkit": 1, "model": {"name": "leg"}, "motion": {"file": str(tmp_path / "t.csv"), "smooth": SMOOTH}}
    right = InverseProblem.of(load_inverse_spec(spec))
    assert not right.measured.contradictions
    columns = {name: {"column": name, "unit": "rad"} for name in ANGLES}
    wrong = InverseProblem.of(load_inverse_spec(spec | {"motion": spec["motion"] | {"columns": columns}}))
    (first, *_) = doubts_before_computation(wrong)
    assert first.startswith("units: the unit rad at motion.columns.hip_flexion.unit contradicts the unit of column")
    assert "'hip_flexion' in the file, deg" in first


def test_knee_flexion_with_the_wrong_sign_is_doubted() -> None:
    run = leg({"knee_flexion": -ANGLES["knee_flexion"]}, motion={"errors": "none"})
    assert told(run) == {"knee"}
    assert "write `scale: -1`" in run.verdict_reasons[0]


def test_a_column_that_is_used_twice_is_doubted_unless_the_mechanism_ties_its_quantities() -> None:
    wrong = {"hip_flexion": "knee_flexion", "knee_flexion": "knee_flexion", "ankle_dorsiflexion": "ankle_dorsiflexion"}
    run = leg(motion={"columns": wrong, "errors": "none"})
    assert run.verdict_reasons[0].startswith("shared-column: column 'knee_flexion' is used for hip_flexion and knee_f")
    copied = leg({"hip_flexion": ANGLES["knee_flexion"]}, motion={"errors": "none"})
    assert "shared-column" not in told(copied)
    assert any("the same values: hip_flexion and knee_flexion." in warning for warning in copied.warnings)
    tied = {name: name for name in ANGLES} | {"knee.angle": {"column": "knee_flexion", "scale": -1.0}}
    assert "shared-column" not in told(leg(motion={"columns": tied, "errors": "none"}))
    plate = stance()
    assert "shared-column" not in told(leg(loads=plate, motion={"errors": "none"}))
    plate["ground"]["force"] = ["fy", "fy"]
    reasons = leg(loads=plate, motion={"errors": "none"}).verdict_reasons
    assert any("'fy' is used for loads.ground.force[0] and loads.ground.force[1]" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("smooth", "other", "doubted"),
    [
        pytest.param("none", 0.01, True, id="noisy"),
        pytest.param("none", 100.0, False, id="noisy-beside-a-large-one"),
        pytest.param(SMOOTH, 0.01, False, id="smoothed"),
    ],
)
def test_values_that_are_mostly_noise_are_doubted(smooth: Any, other: float, doubted: bool) -> None:
    m = mbdkit.Mechanism()
    for name, mass in (("light", 0.01), ("other", other)):
        m.body(name, mass=mass, inertia=0.1 * mass, position=(0.5, 0.0))
        m.revolute(f"{name}_hip", m.ground, name, at=(0, 0))
    swing = 0.4 * np.sin(2 * T) - np.pi / 2
    data = {"time": T, "light": swing + NOISE[0], "other": swing}
    columns = {"light_hip.angle": ("light", 1e-3), "other_hip.angle": ("other", 1e-9)}
    stated = {name: {"column": column, "deviation": noise} for name, (column, noise) in columns.items()}
    run = mbdkit.inverse(
        {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data, "columns": stated, "smooth": smooth}}
    )
    reasons = [one for one in run.verdict_reasons if one.startswith("large-errors: ")]
    assert len(reasons) == doubted
    assert all("light_hip (" in one and "other_hip" not in one and "`motion.smooth`" in one for one in reasons)


def test_outliers_exchanged_and_constant_columns_are_doubted() -> None:
    knee = ANGLES["knee_flexion"]
    outlier = np.where(np.arange(len(T)) == 70, knee + 0.05, knee)
    (reason,) = leg({"knee_flexion": outlier}).verdict_reasons
    assert reason.startswith("outliers: column of knee_flexion: the value at t = 0.7 s is ")
    held = np.where((T > 0.5) & (T < 0.9), knee[50], knee)
    assert "constant" in told(leg({"knee_flexion": held}))
    assert "constant" in told(leg({"knee_flexion": 0 * T + 0.3}))


def test_what_joints_hold_may_be_constant() -> None:
    # the angle of a slider among all coordinates of all bodies of a linkage
    run = mbdkit.run("slider-crank", time={"end": 0.5, "step": 0.005})
    bodies = {name: run[name] for name in ("crank", "rod", "slider")}
    data = {f"{name}.angle": one.angle + (NOISE[0, :101] if name != "slider" else 0.0) for name, one in bodies.items()}
    motor = {"motor": {"joint": "A"}}
    model = mbdkit.Mechanism.from_spec(run.spec["model"]).to_spec()
    del model["joints"]["motor"]
    motion = {"data": {"time": run.time, **data}, "smooth": {"name": "butterworth", "cutoff": 20.0}}
    found = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": motion, "actuators": motor})
    assert "constant" not in told(found)


def test_rounded_times_are_doubted_by_the_grid_on_which_they_are() -> None:
    time = np.arange(400) / 300
    data = {name: 0.4 * np.sin(5 * time + number) for number, name in enumerate(ANGLES)}
    for times, doubts in ((time, set()), (np.round(time, 3), {"times"})):
        run = leg(motion={"data": {"time": times, **data}, "smooth": "quintic"})
        assert told(run) == doubts
    assert "they are probably rounded to 0.001 s" in run.verdict_reasons[0]


def test_samples_at_uneven_times_are_not_doubted() -> None:
    time = np.arange(400) / 300 + 1e-3 * np.random.default_rng(3).uniform(-1, 1, 400)
    data = {name: 0.4 * np.sin(5 * time + number) for number, name in enumerate(ANGLES)}
    for noise in (0.0, 1e-4):
        noisy = {name: x + noise * np.random.default_rng(4).standard_normal(400) for name, x in data.items()}
        assert not leg(motion={"data": {"time": time, **noisy}, "smooth": "quintic"}).verdict_reasons


def test_a_stated_noise_that_the_smoothing_contradicts_is_doubted() -> None:
    columns = {name: {"column": name, "deviation": 2e-5 if name == "hip_flexion" else 1e-3} for name in ANGLES}
    (reason,) = not_of_ends(leg(motion={"columns": columns}))
    assert reason.startswith("noise: data and smoothed motion differ by more than 10 times the stated noise: hip_flex")


def test_a_stated_noise_far_above_that_of_the_data_is_told_with_the_noise_seen() -> None:
    # the noise of all columns has a deviation of 1e-3 rad, and the load has a peak of 600 N
    columns = {name: {"column": name, "deviation": 0.02 if name == "hip_flexion" else 2e-3} for name in ANGLES}
    loads = stance()
    loads["ground"]["force"] = ["fx", {"column": "fy", "deviation": 5e3}]
    run = leg(motion={"columns": columns, "errors": {"samples": 20}}, loads=loads)
    assert told(run) == {"large-errors"}
    noise, load, _ = run.warnings
    assert noise.count("seen") == 2
    named, seen = noise.partition("hip_flexion 0.02 rad (seen ")[::2]
    assert named.endswith("too wide: ")
    assert float(seen.split()[0]) == pytest.approx(1e-3, rel=0.3)
    assert "ground.force.y 5e+03 N (root mean square 4" in load  # 600 N / sqrt(2)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("0.03,1e308", "t.csv:5: column 'hip_flexion': 1e+308 rad is not possible: its magnitude exceeds 1e+30"),
        ("1e-302,0.3", "t.csv:3: column 'time': the interval of 1e-302 s from the row before is not possible"),
    ],
)
def test_impossible_numbers_are_refused_with_line_and_column(cell: str, message: str, tmp_path: Path) -> None:
    rows = ["time,hip_flexion,knee_flexion,ankle_dorsiflexion", *(f"{0.01 * i:.2f},0.1,0.2,0.3" for i in range(20))]
    rows[4 if "0.03" in cell else 2] = f"{cell},0.2,0.3"
    (tmp_path / "t.csv").write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        mbdkit.inverse({"mbdkit": 1, "model": {"name": "leg"}, "motion": {"file": str(tmp_path / "t.csv")}})
    assert message in str(caught.value).replace(f"{tmp_path}/", "")


def test_a_spec_may_accept_every_criterion_and_no_other() -> None:
    files = Path(mbdkit_biomech.__file__).parent.rglob("*.py")
    used = {
        name for file in files for name in re.findall(r'(?:doubts?|Finding)\(\s*"([a-z-]+)"', file.read_text("utf-8"))
    }
    known = set(CriterionName("inverse").names())
    # `excitations` is a criterion of runs; what is improbable in a mechanism has a criterion with its name
    assert used - {"excitations"} | {"inertia"} == known
    with pytest.raises(SpecError, match="accept"):
        leg(accept=["residual"])


REDUCED = {
    3: ("degrees", "outliers"), 5: ("frame_of_load", "wrong_foot", "filled_gap"), 6: ("scale_of_plate", "sign_of_load"),
    32: ("rounded_times",),
}  # fmt: skip
"""Some of the faults of `python -m tests.benchmarks.data_faults`, by number of the data set."""


@pytest.mark.parametrize("number", [pytest.param(n, marks=[pytest.mark.slow] * (n > 5)) for n in REDUCED])
def test_faults_of_random_data_sets_are_refused_or_flagged(number: int) -> None:
    assert set(REDUCED[number]) <= set(FAULTS)
    found = outcomes(number, REDUCED[number])
    assert found[""].word == "same", found[""].told
    assert all(one.word in ("refused", "flagged") for name, one in found.items() if name), found
