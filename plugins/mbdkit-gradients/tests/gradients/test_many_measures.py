"""Gradients of many measures: states that they share are evaluated once, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_gradients.evaluated_states import StateEvaluator

KINDS = {
    "at": "at(bodies.rod{rod}.angle, {share!r})", "integral": "integral((bodies.rod{rod}.angle + {share!r})**2)",
    "integral of abs": "integral(abs(bodies.rod{rod}.angle + 0.3 + 0.001*{share!r}))",
    "max": "max(bodies.rod{rod}.angle*(1 + {share!r}))", "final": "final(bodies.rod{rod}.angle + {share!r})",
}  # fmt: skip
PARAMETERS = ["model.lengths.0", "model.lengths.1", "model.masses.0", "model.masses.1"]


def spec(end: float = 1.2) -> dict[str, Any]:
    model = {"name": "n-pendulum", "n": 3, "angles": [0.3, 0.1, -0.2], "lengths": [1.0] * 3, "masses": [1.0] * 3}
    return {
        "mbdkit": 1, "model": model, "integrator": {"name": "gauss", "stages": 3}, "time": {"end": end, "step": 0.005},
    }  # fmt: skip


def measures(kind: str, count: int, end: float = 1.2) -> list[str]:
    shares = np.linspace(0.0, end, count + 2)[1:-1].tolist()
    return [KINDS[kind].format(rod=1 + k % 3, share=share) for k, share in enumerate(shares)]


@pytest.mark.parametrize(("kind", "cost"), [("at", len), ("integral of abs", sum)])
def test_many_measures_share_their_states(
    kind: str, cost: Callable[[list[int]], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fewer evaluations, or fewer states, than in single gradients, which have the same bits."""
    calls: list[int] = []
    evaluate = StateEvaluator.states

    def counted(self: StateEvaluator, time: np.ndarray, *arguments: Any, **more: Any) -> Any:
        calls.append(len(time))
        return evaluate(self, time, *arguments, **more)

    monkeypatch.setattr(StateEvaluator, "states", counted)
    wanted = measures(kind, 6, end=0.3)
    found = mbdkit.gradient(spec(end=0.3), wanted, PARAMETERS, check=False)
    together, calls[:] = list(calls), []
    separate = [mbdkit.gradient(spec(end=0.3), text, PARAMETERS, check=False) for text in wanted]
    assert cost(together) < 0.4 * cost(calls)
    np.testing.assert_array_equal(found.value, [one.value[0] for one in separate])
    np.testing.assert_array_equal(found.jacobian, [one.jacobian[0] for one in separate])
