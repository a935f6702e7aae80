"""Cost at a given error, for runs whose errors and costs are given."""

from __future__ import annotations

from pathlib import Path

import mbdkit
from mbdkit_studies.report.study_summary import summary
from mbdkit_studies.results.cost_at_error import cost_at_error, error_headlines


def test_the_cost_at_an_error_lies_between_the_runs_that_miss_and_reach_it(tmp_path: Path) -> None:
    # expected: runs that cost less have larger errors, the others smaller ones
    study = mbdkit.study(
        {
            "mbdkit_study": 1, "base": "double-pendulum", "overrides": {"time": {"end": 1.0, "step": 0.1}},
            "axes": [
                {"integrator": [{"name": "rk4"}, {"name": "gauss", "stages": 3}]}, {"time.step": [0.2, 0.1, 0.05]},
            ],
            "reference": {"integrator": {"name": "gauss", "stages": 6}, "time.step": 0.01},
        },
        out=tmp_path / "out",
    )  # fmt: skip
    table = cost_at_error(study)
    assert table is not None
    costs = {row[0]: row[1] for row in table.rows}
    frame = study.to_frame()
    columns = ["rhs_evaluations", "jacobian_evaluations", "factorizations"]
    for name, cost in costs.items():
        own = frame[frame["integrator"] == name]
        assert isinstance(cost, int)
        pairs = zip(own[columns].sum(axis=1), own["end_error"], strict=True)
        assert all((error > 1e-6) == (work < cost) for work, error in pairs)
    assert [row[0] for row in table.rows] == sorted(costs, key=lambda name: costs[name])
    (_, errors), (question, answer) = error_headlines(study)
    assert "6 of 6 runs stay within 1% of the mechanism's size" in errors
    assert question == "fewest operations for an error of 1e-06 m"
    assert answer.startswith(f"{table.rows[0][0]} ({table.rows[0][1]})")
    assert "without the reference" in summary(study)
