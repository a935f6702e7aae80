"""What a method or a force law costs that comes from a plugin, beside the same one built in."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.registry.manager import forget
from tests.installing import install_module

from .timing import duration, take_turns

REPEATS = 11
BODIES, SPRINGS, STEPS = 10, 20, 2000
PLUGIN = """
import mbdkit
import sympy
from pydantic import BaseModel, create_model

length, rate, k, c, free, k3 = sympy.symbols("length rate stiffness damping free_length cubic")
x = length - free
Linear = create_model("Linear", stiffness=(float, 0.0), damping=(float, 0.0), free_length=(float, 0.0))
Cubic = create_model("Cubic", __base__=Linear, cubic=(float, 0.0))


def linear(length, rate, time, p):
    x = length - p[2]
    return p[0] * x + p[1] * rate, p[0], p[1], p[0] * x * x / 2


def method(name, make, **tableau):
    made = mbdkit.ButcherTableau(name, reference="as built in", **tableau)
    return mbdkit.IntegratorPlugin(name, "As built in.", BaseModel, lambda options: make(made),
                                   lambda options: mbdkit.Claims(order=4))


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        method("my-rk4", mbdkit.ExplicitRungeKutta, a=[[], ["1/2"], [0, "1/2"], [0, 0, 1]],
               b=["1/6", "1/3", "1/3", "1/6"], c=[0, "1/2", "1/2", 1], order=4),
        method("my-gauss", mbdkit.ImplicitRungeKutta, a=[["1/4", "1/4 - sqrt(3)/6"], ["1/4 + sqrt(3)/6", "1/4"]],
               b=["1/2", "1/2"], c=["1/2 - sqrt(3)/6", "1/2 + sqrt(3)/6"], order=4),
    ]


@mbdkit.hookimpl
def mbdkit_force_laws():
    force, potential = k * x + c * rate, k * x**2 / 2
    return [
        mbdkit.ForceLawPlugin("my-linear", "SymPy", Linear, mbdkit.ExpressionLaw(force, potential)),
        mbdkit.ForceLawPlugin("my-linear-numba", "Numba", Linear, mbdkit.FunctionLaw(linear, potential=True)),
        mbdkit.ForceLawPlugin("my-cubic", "SymPy", Cubic,
                              mbdkit.ExpressionLaw(force + k3 * x**3, potential + k3 * x**4 / 4)),
    ]
"""


@contextmanager
def _installed() -> Iterator[None]:
    """Install the plugin in this process."""
    with tempfile.TemporaryDirectory() as folder:
        install_module(Path(folder), "bench-kit", PLUGIN)
        sys.path.insert(0, folder)
        importlib.invalidate_caches()
        forget()
        try:
            yield
        finally:
            sys.path.remove(folder)
            forget()


def _spec(model: Any, integrator: dict[str, Any], steps: int, step: float) -> dict[str, Any]:
    output = {"every": steps, "quantities": []}
    time = {"steps": steps, "step": step}
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "output": output}


def _timed(spec: dict[str, Any], per: int) -> Callable[[], float]:
    """Return a contender: seconds of a run from its first to its last step, over `per`."""

    def run() -> float:
        return float(mbdkit.run(spec).check().stats["wall_s"]) / per

    return run


def _sprung(element: dict[str, Any] | None) -> dict[str, Any]:
    """Return point masses, each on many of the same springs to ground."""
    bodies = {f"b{i}": {"mass": 1.0, "position": [1.0 + i, 0.5]} for i in range(BODIES)}
    forces = {}
    for i in range(BODIES):
        for j in range(SPRINGS if element else 0):
            ends = {"bodies": ["ground", f"b{i}"], "points": [[float(j), -1.0], [0.0, 0.0]]}
            assert element is not None
            held = {"pathway": {"type": "two-points"} | ends} if element["type"] == "law" else ends
            forces[f"s{i}-{j}"] = element | held | {"stiffness": 2.0, "damping": 0.1, "free_length": 0.5}
    return {"name": "mechanism", "bodies": bodies, "forces": forces}


def plugins(console: Console) -> None:
    """Print what plugins cost beside what is built in."""
    with _installed():
        steps = 20_000
        pendulum = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
        pairs = {
            "rk4": ({"name": "rk4"}, {"name": "my-rk4"}),
            "gauss, 2 stages": ({"name": "gauss", "stages": 2}, {"name": "my-gauss"}),
        }
        contenders = {
            (title, i): _timed(_spec(pendulum, integrator, steps, 1e-3), steps)
            for title, pair in pairs.items()
            for i, integrator in enumerate(pair)
        }
        table = Table(title=f"Tableaus: a step of the double pendulum, medians of {REPEATS}, taking turns")
        for heading in ("tableau", "built in", "from a plugin", "ratio"):
            table.add_column(heading, justify="left" if heading == "tableau" else "right")
        found = take_turns(contenders, REPEATS)
        for title in pairs:
            ours, theirs = (found[title, i].median for i in range(2))
            table.add_row(title, duration(ours), duration(theirs), f"{theirs / ours:.3f}")
        console.print(table)

        elements: dict[str, dict[str, Any] | None] = {
            "": None,
            "built-in spring-damper": {"type": "spring-damper"},
            "built-in law linear": {"type": "law", "law": "linear"},
            "plugin, linear in SymPy": {"type": "law", "law": "my-linear"},
            "plugin, linear for Numba": {"type": "law", "law": "my-linear-numba"},
            "plugin, cubic in SymPy": {"type": "law", "law": "my-cubic"},
        }
        count = 4 * STEPS * BODIES * SPRINGS
        sprung = {
            name: _timed(_spec(_sprung(element), {"name": "rk4"}, STEPS, 1e-3), count)
            for name, element in elements.items()
        }
        times = {name: timing.median for name, timing in take_turns(sprung, REPEATS).items()}
        table = Table(title=f"Force laws: an evaluation of an element, medians of {REPEATS}, taking turns")
        for heading in ("element", "time", "ratio"):
            table.add_column(heading, justify="left" if heading == "element" else "right")
        bare = times.pop("")
        for name, seconds in times.items():
            cost, spring = seconds - bare, times["built-in spring-damper"] - bare
            table.add_row(name, duration(cost), f"{cost / spring:.2f}")
        console.print(table)
