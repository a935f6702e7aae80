"""The kit verifies a plugin whose tableau is diagonally implicit."""

from __future__ import annotations

from tests.testing import corpus

from mbdkit import ImplicitRungeKutta
from mbdkit_testing import checks_of
from mbdkit_testing.kit import plugin_under_test
from tests.integrators.diagonal_tableaus import TABLEAUS


def test_a_plugin_with_such_a_tableau_is_verified() -> None:
    tableau = TABLEAUS["alexander-2"]
    offered = corpus.offer(lambda options: ImplicitRungeKutta(tableau), order=2, stages=2, needs=("tangents",))
    integrator = plugin_under_test("integrator", "mine", {}, offered)
    wanted = ("contract.", "tableau.", "counters.", "newton.tolerance")
    found = [check.run(integrator) for check in checks_of("integrator", quick=True) if check.name.startswith(wanted)]
    assert len(found) > 12
    assert [result for result in found if result.outcome == "fail"] == []
