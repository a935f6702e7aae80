"""Counts, in a process of its own without compilation, what a run does, and prints it beside what the run says.

Run as ``python counting.py STAGES SOLVER``, with ``MBDKIT_KERNELS=python``. STAGES 0 stands for RK4.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from typing import Any

import mbdkit
from mbdkit.engine.kernels import accelerations
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.stages import collocation_index1, collocation_step, explicit, simplified_newton


def main(stages: int, solver: str) -> None:
    counts: Counter[str] = Counter()

    def counted(name: str, function: Any) -> Any:
        def wrapper(*arguments: Any, **options: Any) -> Any:
            counts[name] += 1
            return function(*arguments, **options)

        return wrapper

    solve = counted("solve", accelerations.solve_accelerations)
    for module in (explicit, collocation_index1, collocation_step):
        module.solve_accelerations = solve  # type: ignore[attr-defined]
    collocation_index1.evaluate_tangents = counted("tangents", collocation_index1.evaluate_tangents)
    simplified_newton.factorize = counted("stage matrices", simplified_newton.factorize)
    Workspace.choose_pivots = counted("choices of pivots", Workspace.choose_pivots)  # type: ignore[method-assign]
    sizes = counted("iterations", collocation_index1.relative_to_accelerations)
    collocation_index1.relative_to_accelerations = sizes
    integrator = {"name": "rk4"} if stages == 0 else {"name": "gauss", "stages": stages, "stage_solver": solver}
    model = {
        "name": "mechanism",
        "bodies": {"rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {"A": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]}},
        "forces": {"t": {"type": "torque", "body": "rod", "value": "cos(t)"}},
    }
    run = mbdkit.run(
        {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"steps": 5, "step": 0.02}}
    ).check()
    print(json.dumps({"counts": counts, "stats": dict(run.stats), "rows": run.array("steps/iterations").tolist()}))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
