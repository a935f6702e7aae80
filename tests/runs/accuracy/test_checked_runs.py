"""Runs with ``check: true``: what they store, what they leave unchanged, and how companions fail."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.compare import compare
from mbdkit.archive.fingerprint import seal
from mbdkit.runs.accuracy.check_run import units_of
from mbdkit.runs.preparation import build
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.simulation import simulate
from mbdkit.spec import RunSpec, load_spec
from tests.integrators.step_methods import RungeKutta, run_with
from tests.margins import assert_within
from tests.slow_cases import slow_but
from tests.witness.known_motions import known_motions

DOUBLE = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
FALLING = {"name": "double-pendulum", "angles": [1.5, 1.6]}


def run(integrator: Any = None, model: Any = None, **sections: Any) -> mbdkit.Run:
    given = {"mbdkit": 1, "model": model or DOUBLE, "integrator": integrator or {"name": "rk4"}}
    return mbdkit.run({**given, "time": {"end": 1.0, "step": 0.01}, "check": True, **sections})


METHODS: list[tuple[dict[str, Any], dict[str, Any]]] = [
    ({"name": "rk4"}, {}),
    ({"name": "gauss", "stages": 2}, {"stabilization": {"name": "baumgarte", "alpha": 5, "beta": 5}}),
    ({"name": "gauss", "stages": 2}, {"stabilization": "projection"}),
    ({"name": "gauss", "stages": 3}, {"output": {"interval": 0.03}}),
    ({"name": "rk-gill"}, {"output": {"every": 7}, "time": {"end": 1.003, "step": 0.01}}),
    ({"name": "radau-iia", "stages": 3}, {"formulation": "index-3"}),
    ({"name": "rattle"}, {"formulation": "index-3"}),
    ({"name": "dopri5", "adaptive": True}, {"time": {"end": 1.0}}),
    ({"name": "dop853", "adaptive": True, "rtol": 1e-8}, {"time": {"end": 1.0}, "output": {"interval": 0.04}}),
    ({"name": "radau-iia", "adaptive": True}, {"time": {"end": 1.0}}),
    ({"name": "scipy-dop853", "rtol": 1e-6, "atol": 1e-6}, {"time": {"end": 1.0}}),
    ({"name": "scipy-radau", "rtol": 1e-6, "atol": 1e-6}, {"time": {"end": 1.0}}),
]


@pytest.mark.parametrize(
    ("integrator", "sections"), slow_but(METHODS, *METHODS[::2]), ids=lambda x: x.get("name", "") if x else ""
)
def test_errors_of_every_kind_of_method_are_known_and_right(integrator, sections):
    # expected: the difference from a run of order 12 with a fine step at the same times
    result = run(integrator, **sections)
    accuracy = result.accuracy
    assert accuracy.is_complete, accuracy.method
    end = result.time[-1]
    fine = mbdkit.run({"mbdkit": 1, "model": DOUBLE, "integrator": {"name": "gauss", "stages": 6},
                       "time": {"end": float(end), "step": 0.005}, "output": {"every": 10**6}})  # fmt: skip
    last = {
        path: result.array(path)[-1] - fine.array(path)[-1] for path in ("trajectory/position", "joints/reaction_force")
    }
    assert_within(last["trajectory/position"], 3 * accuracy.position_error[-1] + 1e-12)
    assert_within(np.linalg.norm(last["joints/reaction_force"], axis=-1), 3 * accuracy.reaction_error[-1] + 1e-10)
    assert np.max(accuracy.position_error[-1]) < 1e-3
    assert np.all(accuracy.reaction_error[0] == 0.0)
    assert np.array_equal(accuracy.time, result.time)


def test_the_double_pendulum_that_seemed_right_is_not():
    # expected: a joint force that is wrong by half of the largest one, against a step that is 16 times shorter
    sections = {"time": {"end": 10.0, "step": 0.01}, "model": {"name": "double-pendulum", "angles": [1.2, 0.3]}}
    result = run({"name": "gauss", "stages": 2}, **sections)
    fine = run(
        {"name": "gauss", "stages": 6},
        **{**sections, "time": {"end": 10.0, "step": 0.000625}, "output": {"every": 16}, "check": False},
    )
    error = np.linalg.norm(result.array("joints/reaction_force") - fine.array("joints/reaction_force"), axis=-1)
    accuracy = result.accuracy
    peak = np.max(np.linalg.norm(result.array("joints/reaction_force"), axis=-1))
    assert np.max(error) > 0.3 * peak
    assert accuracy.known_until < 10.0
    known = result.time <= accuracy.known_until
    assert np.max(error[known]) < 3 * np.max(accuracy.reaction_error[known])
    assert np.max(error[known]) < 0.3 * peak
    assert "errors unknown afterwards: " in result.summary()
    assert any("of the comparison runs do not converge" in reason for reason in result.verdict_reasons)


def test_a_check_changes_neither_the_data_nor_their_hash(tmp_path):
    plain, checked = run(check=False), run()
    assert plain.accuracy is None
    assert plain.data_sha256 == checked.data_sha256
    assert compare(plain, checked).same_data
    with pytest.raises(mbdkit.MbdkitError, match="check: true"):
        plain.array("accuracy/reaction_error")


def test_an_archive_with_errors_is_sound_and_reads_back(tmp_path):
    given = {"mbdkit": 1, "model": FALLING, "integrator": {"name": "gauss"}, "time": {"end": 12.0, "step": 0.02}}
    path = tmp_path / "a.h5"
    made = mbdkit.run(given, check=True, archive=path)
    assert check(path) == []
    with mbdkit.load(path) as loaded:
        found = loaded.accuracy
    assert found is not None
    assert found.known_until == made.accuracy.known_until < 12.0
    np.testing.assert_array_equal(found.reaction_error, made.accuracy.reaction_error)
    tree = made.to_xarray()
    assert tree["accuracy/position_error"].dims == ("time", "body", "coordinate")
    made.close()
    with h5py.File(path, "r+") as file:
        file["accuracy/reaction_error"][3] = -1.0
        seal(file)
    assert check(path) == ["accuracy/reaction_error is negative or decreases"]


def test_methods_written_in_python_are_checked_too():
    result = run_with(RungeKutta(), DOUBLE, {"end": 0.5, "step": 0.01}, check=True)
    assert result.accuracy.is_complete
    assert result.accuracy.order_observed == pytest.approx(4.0, abs=0.3)


def test_a_failed_run_is_checked_up_to_its_last_row():
    result = run(time={"end": 1.0, "step": 0.01}, limits={"max_steps": 33})
    assert result.status == "failed"
    assert result.accuracy.known_until == result.time[-1] == pytest.approx(0.33)


def test_a_run_that_an_event_stops_is_checked_up_to_the_event():
    stop = {"when": "rod1.angle + 1.2", "direction": "falling", "action": "stop"}
    result = run({"name": "gauss", "stages": 2}, events={"low": stop})
    assert result.status_reason.startswith("event")
    assert result.accuracy.is_complete
    assert 0.0 < result.accuracy.position_error_max < 1e-6


@pytest.mark.parametrize("every", [1, 2])
def test_rows_of_joints_need_not_be_recorded(every):
    result = run(output={"quantities": [], "every": every})
    assert result.accuracy.is_complete
    assert result.accuracy.reaction_error.shape == (len(result.time), 2)
    assert result.verdict == "good"
    assert "positions known to" in result.summary()


def test_a_mechanism_without_joints_is_checked():
    model = {"name": "mechanism", "bodies": {"ball": {"mass": 1.0, "velocity": [1.0, 2.0]}}}
    result = run(model=model)
    assert result.accuracy.is_complete
    assert result.accuracy.figures((), np.zeros((101, 0, 2))).worst_joint is None


def test_wrong_angles_of_discs_whose_centres_rest_are_not_good():
    # expected: the closed form of two discs on one axle, whose angles this step misses by 4.6 % of the size
    known = next(one for one in known_motions() if one.name == "spinning discs")
    result = run({"name": "gauss", "stages": 2}, known.model, time={"end": known.end, "step": 4 * known.step})
    assert result.verdict == "doubtful"
    assert result.verdict_reasons[0].startswith("The step of 0.04 s is 0.13 of the period of 0.314 s")
    assert result.verdict_reasons[1].startswith("The estimated error of positions is 0.046 of the mechanism's size")
    assert result.accuracy.position_error_max < 1e-20
    true = np.max(np.abs(result.array("trajectory/position") - known.solve(result.time)[0]))
    assert result.accuracy.angle_error_max == pytest.approx(true, rel=0.5)
    assert f"{result.accuracy.angle_error_max:.2g} rad" in result.summary()


def test_the_progress_of_the_companions_is_told_like_that_of_the_run():
    # expected: the run, two companions and a guard, each from the start to the end
    spec = {"mbdkit": 1, "model": DOUBLE, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.001}}
    told: list[tuple[float, float]] = []
    simulate(load_spec(spec, check=True), progress=lambda now, end: told.append((now, end)))
    assert {end for _, end in told} == {1.0}
    assert sum(now == 1.0 for now, _ in told) == 4


def test_companions_stop_at_the_limit_of_wall_time():
    model = {"name": "n-pendulum", "n": 12, "angles": [0.1 * k for k in range(12)]}
    result = run(model=model, limits={"wall_time": 0.1}, time={"end": 1000.0, "step": 0.0005})
    assert result.status_reason.startswith("wall-time")
    assert result.accuracy.check_s < 5.0
    assert "limits.wall_time" in result.accuracy.method
    assert result.accuracy.known_until < result.time[-1]


def test_a_signal_during_the_comparison_runs_interrupts_the_run():
    """Its rows are complete, but its errors are not known: the command ends as after a signal during the steps."""

    ends = 0

    def stop(time: float, end: float) -> None:
        nonlocal ends
        ends += time == end
        if ends == 2:  # at the end of the first comparison run
            raise KeyboardInterrupt

    spec = {"mbdkit": 1, "model": DOUBLE, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.001}}
    result = simulate(load_spec(spec, check=True), progress=stop)
    assert (result.status, result.time[-1]) == ("interrupted", 1.0)
    assert result.status_reason.endswith("after the last step, before errors were estimated.")
    assert result.accuracy.known_until == 0.0
    assert result.verdict == "doubtful"


def test_a_pulse_that_all_tolerances_pass_over_is_seen_by_the_guard():
    # expected: a body at rest that a smooth force of 5 N s pushes around 5 s, and that coarse steps leave at rest
    push = {"type": "force", "body": "a", "value": ["5/(0.02*sqrt(pi))*exp(-((t-5)/0.02)**2)", 0.0]}
    bodies = {"a": {"mass": 1.0, "inertia": 1.0}}
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": bodies, "forces": {"f": push}}
    result = run({"name": "dop853", "adaptive": True, "rtol": 1e-10}, model, time={"end": 10.0})
    if abs(result["a"].position[-1, 0] - 25.0) > 0.01:
        assert result.accuracy.known_until < 5.0
    coarse = run({"name": "rk4"}, model, time={"end": 10.0, "step": 0.8})
    assert not abs(coarse["a"].position[-1, 0] - 25.0) < 0.01
    assert coarse.accuracy.known_until < 5.6


def test_a_study_lists_until_when_its_runs_are_known(tmp_path: Path):
    base = {"mbdkit": 1, "model": DOUBLE, "integrator": {"name": "gauss"}, "time": {"end": 0.5, "step": 0.01}}
    spec = {"mbdkit_study": 1, "base": {**base, "check": True}, "axes": [{"time.step": [0.01, 0.02]}]}
    frame = mbdkit.study(spec, out=tmp_path / "s").to_frame()
    assert list(frame["known_until"]) == [0.5, 0.5]
    assert np.all(frame["reaction_error_share"] < 1e-4)
    assert np.all(frame["angle_error_estimate"] > 0)
    assert list(frame["verdict"]) == ["good", "good"]


@pytest.mark.slow
def test_a_thin_leaf_is_checked_by_a_guard_on_the_index_2_equations() -> None:
    # adaptive steps on the index-1 equations become small without end; twice as fast as the packaged example
    spec = load_spec("leaf-spring").model_dump(mode="json")
    spec["model"]["joints"]["motor"]["motion"] = "-pi/6*(1 - cos(2*pi*t/5))"
    with mbdkit.run(spec, time={"end": 2.5, "step": 0.005}, output={"every": 20}, check=True) as run:
        assert run.accuracy.known_until == run.time[-1]
        assert all("record more rows" in reason for reason in run.verdict_reasons)
        assert "confirmed by a run with adaptive radau-iia of order 9 and index 2" in run.accuracy.method


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 1e-3], ids=["undamped", "damped"])
def test_unknown_errors_of_a_beam_under_a_sudden_load_name_its_missing_damping(damping: float) -> None:
    m = mbdkit.Mechanism()
    steel = {"E": 2.1e11, "nu": 0.3, "A": 1e-4, "I": 2.1e-10, "density": 7850.0}
    blade = m.beam("blade", a=(0.0, 0.0), b=(1.0, 0.0), elements=5, damping=damping, **steel)
    m.weld("clamp", m.ground, blade[0], at=(0.0, 0.0))
    m.force("load", blade[-1], value=(0.0, -30.0))
    method, time = {"name": "radau-iia", "stages": 3}, {"end": 0.04, "step": 5e-3}
    result = mbdkit.run(m, integrator=method, time=time, check=True)
    advice = "of beam 'blade' never decay, because it has no `damping`"
    assert any(advice in reason for reason in result.verdict_reasons) == (not damping)


def boom(mass: float) -> mbdkit.Mechanism:
    """A boom of 6 m that a locked ram of two bodies of 1 kg holds."""
    length, a = 6.0, math.radians(30)
    out = np.array([math.cos(a), math.sin(a)])
    foot, head = np.array([1.0, -0.5]), 2.0 * out
    distance = float(np.linalg.norm(head - foot))
    u = (head - foot) / distance
    m = mbdkit.Mechanism()
    m.body("boom", mass=mass, inertia=mass * length**2 / 12, position=length / 2 * out, angle=a)
    for name, place in {"barrel": foot + 0.3 * u, "rod": head - 0.3 * u}.items():
        m.body(name, mass=1.0, inertia=0.1, position=place, angle=math.atan2(u[1], u[0]))
    m.revolute("pin", m.ground, "boom", at=(0, 0))
    m.revolute("foot", m.ground, "barrel", at=foot)
    m.revolute("head", "boom", "rod", at=head)
    m.prismatic("ram", "barrel", "rod", points=((0, 0), (0, 0)), axis=(1, 0))
    m.driver("oil", "barrel", "rod", coordinate="x", points=((0, 0), (0, 0)), motion=distance - 0.6)
    return m


@pytest.mark.parametrize(
    ("mass", "method"),
    [
        (3000.0, {"name": "gauss", "stages": 2}),
        (7800.0, {"name": "gauss", "stages": 2}),
        (7800.0, {"name": "rk4"}),
        (7800.0, {"name": "dop853", "adaptive": True}),
    ],
)
def test_a_heavy_body_that_locked_light_bodies_hold_has_known_errors(mass: float, method: dict[str, Any]) -> None:
    # expected: nothing moves; the moment of the weight about the pin (with that of the ram's bodies, below 2e-4)
    times = {"end": 1.0} if "adaptive" in method else {"end": 1.0, "step": 0.01}
    found = mbdkit.run(boom(mass), integrator=method, time=times, check=True)
    assert (found.verdict, found.verdict_reasons) == ("good", [])
    a, foot = math.radians(30), np.array([1.0, -0.5])
    head = 2.0 * np.array([math.cos(a), math.sin(a)])
    u = (head - foot) / np.linalg.norm(head - foot)
    expected = mass * 9.81 * 3.0 * math.cos(a) / abs(head[0] * u[1] - head[1] * u[0])
    assert np.hypot(*found.joints["oil"].reaction_force_first[-1]) == pytest.approx(expected, rel=1e-3)


def test_rounding_errors_beside_heavy_bodies_follow_from_the_joints_of_the_own_part() -> None:
    # expected: 10 N hold 1 kg, which a ball of its own feels; the boom's 1e6 N would give 1 kg an acceleration of 1e6
    m = boom(1e5)
    ball = m.body("ball", mass=1.0, position=(9.0, -1.0))
    m.distance("string", m.ground, ball, points=((9, 0), (0, 0)), length=1.0)
    workspace, _ = build(RunSpec.model_validate({"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"},
                                                 "time": {"end": 1.0, "step": 0.1}}))  # fmt: skip
    names = workspace.mechanism.joints
    force = np.zeros((2, len(names), 2))
    force[:, names.index("oil")], force[:, names.index("string")] = (1e6, 0.0), (0.0, 10.0)
    states = np.zeros((2, 2, 4, 3))
    rows = ObservedRows(np.array([0.0, 100.0]), *states, force, np.zeros((2, len(names))))
    units = units_of(workspace, rows)
    boom_parts, own = units.rounding[:3], units.rounding[3]
    assert np.all(boom_parts == boom_parts[0])
    assert boom_parts[0] == pytest.approx(1e5 * own)
