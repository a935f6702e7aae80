"""The verdicts on drift and on runs without it: synthetic studies that agree or disagree with the literature."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import mbdkit
from mbdkit_paper.drift.combination import combinations
from mbdkit_paper.drift.verdict import WORDS, order_meets
from mbdkit_paper.drift.verdict import verdict as judge_drift
from mbdkit_paper.no_drift.verdict import verdict as judge_no_drift
from mbdkit_paper.wording import UNDECIDED
from mbdkit_report import Answer
from mbdkit_studies.results.judge import judge
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.first_party import PARTS

STEPS = (0.1, 0.05, 0.025, 0.0125)
YES, NO, PARTLY, OPEN = Answer.YES, Answer.NO, Answer.PARTLY, Answer.OPEN
LONG = {
    "misalignment_max": 2e-15, "velocity_misalignment_max": 4e-15, "energy_trend": 0.0, "energy_trend_error": 1e-12,
    "energy_oscillation": 1e-9, "energy_scale": 4.0, "reversibility_defect": 2e-14, "mechanism_size": 2.0,
    "duration": 100.0, "steps": 1e4, "rhs_evaluations": 4e4, "factorizations": 1e4, "wall_s": 0.1,
}  # fmt: skip

COLUMNS = WORDS.table("drift", ()).columns


def point(family: str, method: str, status: str = "complete", reversal: str = "complete", **values: float) -> Any:
    step = values.pop("step", None)
    axes = {"method": method} | ({} if step is None else {"time.step": step})
    texts = {"reason": "", "second_run": reversal, "label": ""}
    return SimpleNamespace(family=family, axes=axes, status=status, values=values, **texts)


def method(
    label: str, orders: tuple[float, float, float] = (4, 4, 4), *, scale: float = 1.0, own: bool = False, **long: float
) -> list[Any]:
    """Return the points of a method whose errors fall with these orders from `scale` at a step of 1 s."""
    names = ("trajectory_error", "velocity_error", "multiplier_error")
    short = [point("rod", label, step=h, own_multipliers=float(own), mechanism_size=2.0) for h in STEPS]
    for one, h in zip(short, STEPS, strict=True):
        one.values |= {name: scale * h**order for name, order in zip(names, orders, strict=True)}
    return [*short, point("rod-long", label, **(LONG | long))]


def study(*points: Any) -> Any:
    every, families = list(points), {"rod": "", "rod-long": ""}
    spec = SimpleNamespace(added=())
    one = SimpleNamespace(points=every, families=families, run=lambda point: None, spec=spec)
    one.family = lambda name: [point for point in every if point.family == name]
    return one


RADAU, NAN = "Radau IIA 3, index-3", math.nan


@pytest.mark.parametrize(
    ("orders", "answer"),
    [
        ((5, 3, 2), YES),
        ((5.1, 2.9, 2.15), YES),
        ((4, 3, 2), NO),
        ((5, 3, 1), NO),
        ((5, 4, 2), PARTLY),
        ((5, 3, 2.25), OPEN),
    ],
)
def test_orders_are_held_to_the_literature(orders: tuple[float, float, float], answer: Answer) -> None:
    verdict = judge_drift(study(*method(RADAU, orders, own=True)))
    assert verdict.claim("radau-index-3").answer is answer
    assert verdict.claim("radau-index-2").answer is OPEN
    assert verdict.claim("radau-index-2").sentence == UNDECIDED


def test_orders_are_read_off_the_errors_and_the_multipliers_say_whose_they_are() -> None:
    (one,) = combinations(study(*method(RADAU, (5, 3, 2), own=True)))
    assert (one.position_order, one.velocity_order, one.multiplier_order) == pytest.approx((5, 3, 2))
    assert one.own
    assert one.cells()[:4] == ("5.00", "3.00", "2.00", "own")
    assert (one.position_drift, one.velocity_drift) == (1e-15, 2e-15)
    assert (one.evaluations, one.factorizations, one.microseconds) == (4, 1, pytest.approx(10))
    assert one.reversal == 1e-14


def test_round_off_failures_and_what_is_not_installed_are_words_and_never_numbers() -> None:
    broken = [point("rod", "broken", "failed", step=h) for h in STEPS] + [point("rod-long", "broken", "failed")]
    absent = [point("rod", "absent", "left-out", step=h) for h in STEPS] + [point("rod-long", "absent", "left-out")]
    few = method("few")
    for one in few[:2]:
        one.status = "failed"
    noisy = method("noisy")
    for one, error in zip(noisy, (1e-3, 1e-2, 1e-3, 1e-2), strict=False):
        one.values["trajectory_error"] = error
    damped = method("damped", reversibility_defect=math.nan)
    damped[-1].second_run = "not-reversible: dampers."
    found = {one.method: one for one in combinations(study(*broken, *absent, *few, *noisy, *damped))}
    assert found["broken"].cells() == ("failed",) * 3 + (None,) + ("failed",) * 3 + (None,) + ("failed",) * 5
    assert set(found["absent"].cells()) == {"not installed", None}
    assert found["few"].position_order == "failed"
    assert found["noisy"].position_order == "no order"
    assert found["damped"].reversal == "not reversible"
    verdict = judge_drift(study(*broken, *absent, *few, *noisy, *damped))
    assert verdict.notes == ("Left out because they are not installed: absent.",)
    assert all(len(row) == len(COLUMNS) for row in verdict.table("drift").rows)


@pytest.mark.parametrize(
    "errors", [(3e-15, 1e-15, 2e-15, 2e-15), (8e-15, 4e-15, 2e-15, 1e-15), (1e-5, 1e-10, 1e-14, 2e-14)]
)
def test_errors_that_meet_round_off_have_no_order_though_they_may_happen_to_fall(errors: tuple[float, ...]) -> None:
    exact = method("exact")
    for one, error in zip(exact, errors, strict=False):
        one.values |= dict.fromkeys(("trajectory_error", "velocity_error", "multiplier_error"), error)
    (one,) = combinations(study(*exact))
    assert (one.position_order, one.velocity_order, one.multiplier_order) == ("round-off",) * 3


def test_the_order_is_that_of_the_finest_steps_above_the_floor() -> None:
    # expected: h^3 + 300 h^5 is of order 3, though its coarse steps agree on nearly 5; rounding of 1e-15 is left out
    few = method("few")
    long = few.pop()
    steps = [0.4 / 2**k for k in range(12)]
    short = [point("rod", "few", step=h, own_multipliers=0.0, mechanism_size=2.0) for h in steps]
    for one, h in zip(short, steps, strict=True):
        one.values |= dict.fromkeys(("velocity_error", "multiplier_error"), 1e-9 * (h**3 + 300 * h**5) + 1e-17)
        one.values["trajectory_error"] = 1e-3 * (h**3 + 300 * h**5)
    (one,) = combinations(study(*short, long))
    assert one.position_order == pytest.approx(3.0, abs=0.01)
    assert one.velocity_order == "round-off" or one.velocity_order > 3.5  # its fine steps are at round-off


@pytest.mark.parametrize(
    ("slope", "error", "shown"),
    [(4e-6, 1e-6, 1e-6), (-4e-6, 1e-6, -1e-6), (2e-6, 1e-6, "none"), (1e-14, 1e-16, "none"), (NAN, NAN, "no value")],
)
def test_a_trend_is_told_apart_from_oscillation_and_from_round_off(slope: float, error: float, shown: object) -> None:
    # expected: three standard errors; 1e-12 of the kinetic energy over the run
    (one,) = combinations(study(*method("any", energy_trend=slope, energy_trend_error=error)))
    assert one.trend == shown


def projected(trend: float = 1e-6, there: float = 1e-7, symmetric_trend: float = 0.0, back: float = 1e-14) -> Any:
    """Return Gauss 2 without, with ordinary and with symmetric projection."""
    return study(
        *method("Gauss 2"),
        *method("Gauss 2, projected", scale=0.1, energy_trend=trend, reversibility_defect=there),
        *method("Gauss 2, projected symmetrically", scale=0.1, energy_trend=symmetric_trend, reversibility_defect=back),
    )


def test_what_projection_does_to_gauss_is_as_expected_where_it_is() -> None:
    verdict = judge_drift(projected())
    for name in ("projection-order", "projection-error", "projection-reversibility", "projection-energy"):
        assert verdict.claim(name).answer is YES, name


@pytest.mark.parametrize(
    ("claim", "change", "value"),
    [
        ("reversibility", "there", 1e-14),
        ("reversibility", "back", 1e-7),
        ("energy", "trend", 0.0),
        ("energy", "symmetric_trend", 1e-6),
    ],
)
def test_what_projection_does_not_do_is_told(claim: str, change: str, value: float) -> None:
    assert judge_drift(projected(**{change: value})).claim(f"projection-{claim}").answer is NO


def test_projection_that_costs_the_order_or_gains_nothing_is_told() -> None:
    verdict = judge_drift(study(*method("RK4"), *method("RK4, projected", (3, 4, 4))))
    assert verdict.claim("projection-order").answer is PARTLY
    assert "q from 4.00 to 3.00 (RK4, rod)" in verdict.claim("projection-order").computed
    verdict = judge_drift(study(*method("RK4"), *method("RK4, projected")))
    assert verdict.claim("projection-error").answer is NO


@pytest.mark.parametrize(
    ("found", "answer"),
    [(5.15, YES), (4.85, YES), (4.75, OPEN), (5.25, OPEN), (4.5, NO), (5.5, PARTLY), ("failed", OPEN)],
)
def test_an_order_meets_another_within_a_fifth(found: float | str, answer: Answer) -> None:
    assert order_meets(found, 5.0) is answer


def test_a_study_of_other_families_is_no_study_of_drift() -> None:
    other = study(*method("any"))
    other.families = {"rod": ""}
    with pytest.raises(ValueError, match="-long"):
        judge_drift(other)


def reduced(methods: set[str]) -> dict[str, Any]:
    """Return the packaged study on one pendulum alone, with these methods, fewer steps and shorter long runs."""
    spec: dict[str, Any] = json.loads(load_study_spec("drift").canonical_json())
    spec["families"] = {name: spec["families"][name] for name in ("pendulum", "pendulum-long")}
    for family in spec["families"].values():
        family["axes"][0]["method"] = [one for one in family["axes"][0]["method"] if one["label"] in methods]
    steps = spec["families"]["pendulum"]["axes"][1]
    spec["families"]["pendulum"]["axes"][1] = {key: values[1:6] for key, values in steps.items()}
    spec["families"]["pendulum-long"]["overrides"]["time"]["steps"] = 4000
    return spec


def test_the_table_that_is_checked_in_is_of_the_packaged_study() -> None:
    spec = json.loads(load_study_spec("drift").canonical_json())
    expected = [
        f"| {name} | {one['label']} |"
        for name, family in spec["families"].items()
        if f"{name}-long" in spec["families"]
        for one in family["axes"][0]["method"]
    ]
    text = (PARTS["mbdkit_paper"] / "drift" / "DRIFT.md").read_text(encoding="utf-8")
    heading, _, *rows = [line for line in text.splitlines() if line.count(" | ") == len(COLUMNS) - 1]
    assert [re.match(r"\| [^|]+ \| [^|]+ \|", row)[0] for row in rows] == expected, (
        "stale: `mbdkit study drift -o drift` and "
        "`mbdkit report drift -o plugins/mbdkit-paper/src/mbdkit_paper/drift/DRIFT.md --overwrite`"
    )
    assert heading.startswith("| mechanism | method |")


@pytest.mark.slow
def test_the_packaged_study_shows_on_one_mechanism_what_is_known_of_methods(tmp_path: Path) -> None:
    # expected: orders 4, 4 and 2s - 1 of index 1 (Hairer, Norsett, Wanner I; Hairer, Wanner II), Gauss reversible
    # (Hairer, Lubich, Wanner, V.1), Radau losing energy
    known = {"RK4": 4, "Gauss 2": 4, "Radau IIA 2": 3}
    found = mbdkit.study(reduced(known.keys() | {"Generalized-alpha, index-3"}), out=tmp_path / "drift")
    rows = {row[1]: row for row in judge(found).table("drift").rows}
    for label, order in known.items():
        assert [float(rows[label][column]) for column in (2, 3, 4)] == pytest.approx([order] * 3, abs=0.2), label
        assert rows[label][5] == "index-1"
    assert rows["Gauss 2"][11] < 1e-12 < rows["RK4"][11]
    assert rows["Radau IIA 2"][8] < 0
    assert {rows["Generalized-alpha, index-3"][2]} <= {"not installed", "1.99", "2.00", "2.01"}


def study_without_drift(*runs: tuple[float, float, str]) -> Any:
    """Return a study of runs of a mechanism of 2 m, by position and velocity misalignment and status."""
    points = [
        SimpleNamespace(
            family="rod",
            axes={"method": f"method {number}"},
            status=status,
            values={
                "misalignment_max": position, "velocity_misalignment_every_step": velocity, "mechanism_size": 2.0,
                "steps": 1e5, "wall_s": 1.0, "projections": 1e5,
            },
        )
        for number, (position, velocity, status) in enumerate(runs, start=1)
    ]  # fmt: skip
    return SimpleNamespace(points=points, spec=SimpleNamespace(title="Long runs", added=()))


@pytest.mark.parametrize(
    ("position", "velocity", "answers"),
    [
        (1.5e-12, 1e-14, ("yes", "yes")),  # 0.75e-12 of 2 m
        (3e-12, 1e-14, ("no", "yes")),
        (1e-15, 1e-3, ("yes", "no")),
        (2e-12, 1e-14, ("open", "yes")),
    ],
)
def test_misalignments_are_held_to_the_mechanisms_size(
    position: float, velocity: float, answers: tuple[str, str]
) -> None:
    verdict = judge_no_drift(study_without_drift((1e-15, 1e-15, "complete"), (position, velocity, "complete")))
    assert tuple(str(claim.answer) for claim in verdict.claims) == answers
    assert verdict.table("no-drift").rows[1][3] == pytest.approx(position / 2, rel=0.05)


def test_a_run_that_failed_leaves_it_open_and_is_named() -> None:
    verdict = judge_no_drift(study_without_drift((1e-15, 1e-15, "complete"), (1e-15, 1e-15, "failed")))
    assert [claim.answer for claim in verdict.claims] == [Answer.OPEN] * 2
    assert verdict.claim("positions").sentence == UNDECIDED
    assert "unknown for rod, method 2" in verdict.claim("positions").computed
    assert verdict.table("no-drift").rows[1][2:] == ("failed",) * 5


def test_one_run_that_drifts_is_told_though_another_failed() -> None:
    verdict = judge_no_drift(study_without_drift((1e-9, 1e-15, "complete"), (math.nan, math.nan, "left-out")))
    assert verdict.claim("positions").answer is Answer.NO
    assert "Exceptions: rod, method 1." in verdict.claim("positions").sentence
