"""Runs with ``accuracy: SHARE``: what is chosen, what is reached, what is stored, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.compare import compare
from mbdkit.base.errors import SpecError
from mbdkit.runs.accuracy.coarser_estimate import error_share
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.benchmarks.asked_accuracy import TEN, counted
from tests.margins import assert_within
from tests.slow_cases import slow
from tests.witness.known_motions import Known, forced_oscillator, known_motions, pendulum

DOUBLE = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
PROBLEMS = {known.name: known for known in known_motions()}


def run(accuracy: float = 1e-6, **sections: Any) -> mbdkit.Run:
    given: dict[str, Any] = {"mbdkit": 1, "model": DOUBLE, "time": {"end": 2.0}, "accuracy": accuracy}
    return mbdkit.run({**given, **sections})


def true_error(run: mbdkit.Run, known: Known) -> float:
    """Return the largest error of positions in the measure of `accuracy`."""
    spec = load_spec(run.spec)
    measure = PositionMeasure.of(spec, build(spec)[0])
    return float(np.max(measure.share(run.array("trajectory/position") - known.solve(run.time)[0])))


@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"integrator": {"name": "gauss", "stages": 3}},
        {"integrator": {"name": "scipy-dop853"}},
        {"stabilization": {"name": "projection", "symmetric": True}},
        *slow(
            {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 10.0, "step": 0.05}},
            {"integrator": {"name": "radau-iia", "adaptive": True}},
            {"formulation": "ggl"},
        ),
    ],
    ids=str,
)
def test_positions_are_as_accurate_as_asked_with_every_kind_of_method(sections):
    # expected: minimal coordinates by DOP853 at rtol 1e-13
    known = PROBLEMS["double pendulum, small"]
    made = run(1e-6, **{"model": known.model, "time": {"end": known.end}} | sections)
    assert made.verdict == "good", made.verdict_reasons
    assert made.accuracy is not None
    assert_within(true_error(made, known), 1e-6)
    assert made.accuracy.reached <= made.accuracy.asked == 1e-6
    wanted = sections.get("integrator", {}).get("name")
    assert wanted is None or made.spec["integrator"]["name"] == wanted


@pytest.mark.slow
@pytest.mark.parametrize("asked", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("name", TEN)
def test_the_accuracy_is_reached_on_ten_problems(name, asked):
    # expected: closed forms, or minimal coordinates by DOP853 at rtol 1e-13
    known = PROBLEMS[name]
    made = run(asked, model=known.model, time={"end": known.end})
    assert made.accuracy is not None
    assert made.accuracy.is_reached
    assert true_error(made, known) <= asked


@pytest.mark.parametrize("name", ["double pendulum, small", *slow("four-bar", "driven double pendulum")])
def test_the_last_pilot_is_the_run_and_the_others_check_it(name, monkeypatch):
    # expected: no companion, and as many evaluations as three runs of this tolerance take at most
    known = PROBLEMS[name]
    monkeypatch.setattr("mbdkit.runs.accuracy.run_estimates.check_run", None)
    with counted() as work:
        made = run(1e-6, model=known.model, time={"end": known.end})
    # the accuracy that is asked for is that of positions: rows at long steps may miss the largest force
    assert all("Between rows, the force" in reason for reason in made.verdict_reasons)
    assert (work["preparation"], work["companion"]) == (0, 0)
    assert work["pilot_run"] < 3 * made.stats["rhs_evaluations"]
    assert made.accuracy is not None
    assert "coarser run" in made.accuracy.method
    assert true_error(made, known) < 3 * made.accuracy.reached


def test_a_run_with_an_interval_of_rows_is_made_again_with_them():
    made = run(output={"interval": 0.05})
    assert len(made.time) == 41
    assert made.verdict == "good"
    assert made.accuracy is not None
    assert "coarser run" in made.accuracy.method


@pytest.mark.slow
def test_where_rounding_errors_limit_adaptive_steps_another_method_is_tried():
    # expected: the closed form; its phase multiplies an error of the energy of 1e-15 by 1e3, so that no method is sure
    known = pendulum("long", 0.0, 9.0, 20.0, 0.02)
    made = run(1e-12, model=known.model, time={"end": known.end})
    assert made.accuracy is not None
    assert "Rounding errors limit dop853" in made.accuracy.why
    assert made.spec["integrator"]["name"] == "gauss"
    assert true_error(made, known) <= made.accuracy.reached
    if not made.accuracy.is_reached:
        assert made.verdict == "doubtful"
        assert "their estimated error is" in made.verdict_reasons[0]
        assert "dop853 and gauss" in made.verdict_reasons[0]


def test_a_stiff_mechanism_is_given_an_implicit_method():
    # expected: the closed form of the damped oscillator, whose fast motion decays within microseconds
    known = forced_oscillator("very stiff", 4e8, 4e5, 0.2, 0.002)
    made = run(1e-5, model=known.model, time={"end": known.end})
    assert made.spec["integrator"]["name"] == "radau-iia"
    assert made.accuracy is not None
    assert "Stability limits" in made.accuracy.why
    assert_within(true_error(made, known), 1e-5)  # margin: the accuracy that was asked for


def test_chaos_ends_as_doubtful_with_the_reason():
    chaotic = {"name": "double-pendulum", "angles": [1.5, 1.6]}
    made = run(1e-6, model=chaotic, time={"end": 40.0})
    assert made.status == "complete"
    assert made.verdict in ("doubtful", "bad")
    told = " ".join(made.verdict_reasons)
    assert "requested accuracy of positions is 1e-06" in told
    assert "chaotic" in told or "rounding" in told


def test_the_archive_stores_the_choice_and_runs_again_to_the_bit(tmp_path):
    path = tmp_path / "asked.h5"
    asked = load_spec({"mbdkit": 1, "model": DOUBLE, "time": {"end": 2.0}}, ["accuracy=1e-6"])
    with mbdkit.run(asked, archive=path) as first, mbdkit.run(first.spec) as again:
        assert first.spec["accuracy"] == 1e-6
        assert first.spec["choose"] == "nothing"
        assert first.spec["integrator"]["rtol"] > 0
        assert load_spec(first.spec).sha256() == first.spec_sha256 == again.spec_sha256
        assert first.run_id == again.run_id
        assert compare(first, again).same_data
        assert again.accuracy is not None
        assert first.accuracy is not None
        # the second run has no pilots, and is checked by companions
        assert max(again.accuracy.reached, first.accuracy.reached) <= 1e-6
        assert again.accuracy.chosen == first.accuracy.chosen
        assert "pilot" in first.accuracy.why.lower()
        assert f"chosen: {first.accuracy.chosen}" in first.summary()
    assert not check(path)
    assert not list(tmp_path.glob("*.part"))


def test_equal_specs_lead_to_equal_choices():
    assert run().data_sha256 == run().data_sha256


def test_a_run_that_misses_the_accuracy_of_its_given_step_says_so():
    made = run(1e-9, integrator={"name": "rk4"}, time={"end": 2.0, "step": 0.02}, choose="nothing")
    assert made.spec["time"]["step"] == 0.02
    assert made.verdict == "doubtful"
    assert "requested accuracy of positions is 1e-09" in made.verdict_reasons[0]


def test_limits_of_steps_are_told_where_they_prevent_the_accuracy():
    made = run(1e-9, integrator={"name": "rk4"}, limits={"max_steps": 500})
    assert made.status == "complete"
    assert made.stats["steps"] <= 500
    assert "limits.max_steps allows 500 steps" in made.verdict_reasons[0]


def test_the_errors_of_a_run_before_time_zero_are_known_to_its_end():
    # expected: the same pendulum does not know when it swings
    model = {"name": "single-pendulum", "angle": 0.3}
    early, late = (run(1e-6, model=model, time={"start": t, "end": t + 1.0}) for t in (-2.0, 0.0))
    assert early.verdict == late.verdict == "good"
    assert early.accuracy is not None
    assert early.accuracy.is_complete


def test_runs_of_equal_tolerance_tell_nothing_about_their_error():
    assert error_share([0.0], [1e-13, 1e-13]) == np.inf
    assert error_share([1e-3, 0.0], [1e-11, 1e-13, 1e-13]) == np.inf
    assert error_share([0.0], [1e-11, 1e-13]) == 0.0


def test_without_accuracy_an_integrator_is_still_needed():
    with pytest.raises(SpecError) as refused:
        load_spec({"mbdkit": 1, "model": DOUBLE, "time": {"end": 1.0}})
    assert refused.value.key == "integrator"
