"""`python -m tests.benchmarks.capabilities [--write] [--methods NAME ...]`: which method works with what, tried.

Every installed method, and those of the templates of `mbdkit plugins new`, runs a small mechanism for every capability.
"yes" means that the result agrees with DOP853: with fixed steps, the error falls with the order of the method as steps
are halved; with controlled steps, it belongs to the tolerance. Otherwise the page has the sentence with which the
program refuses. A wrong result is marked, and the command then ends with status 1.
"""

from __future__ import annotations

import argparse
import functools
import json
import logging
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import mbdkit
from mbdkit import MbdkitError, SpecError
from mbdkit.engine.consistent_start import Starts
from mbdkit.integrators import interface
from mbdkit.registry.manager import forget, registry
from mbdkit.runs.lane_runs import LaneRuns, why_alone
from mbdkit.runs.simulation import simulate
from mbdkit.spec import load_spec
from mbdkit_studies.compute.added_methods import with_methods
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.benchmarks.state_orders import MODEL as MOTOR
from tests.benchmarks.templates import install_templates
from tests.first_party import ROOT
from tests.runs.rotor import FIRES, rotor

PAGE = Path(mbdkit.__file__).parent / "guide" / "capabilities.md"
MARK = "<!-- The rest is written by `python -m tests.benchmarks.capabilities --write`; do not edit. -->"
TOLERANCE, CONTROLLED = 1e-8, 1e-5
"""Tolerance of controlled steps, and the largest error with it, relative to values above 1."""
FLOOR, LARGEST = 1e-8, 0.05
"""With fixed steps: errors below which no order is seen, because events are located, and the largest error."""
QUIET = logging.getLogger(__name__).debug

Data = dict[str, Any]
DOP853: Data = {"name": "dop853", "adaptive": True, "rtol": 1e-11, "atol": 1e-12}
SPRING: Data = {"type": "torsion-spring", "bodies": ["ground", "leg"], "stiffness": 4.0, "free_angle": 1.0}
LEG: Data = {key: MOTOR[key] for key in ("name", "bodies", "joints")} | {"forces": {"hip": SPRING}}
SAMPLED: Data = LEG | {
    "forces": {"motor": {"type": "torque", "body": "leg", "value": "controllers.pd.u"}},
    "controllers": {"pd": {"period": 0.1, "outputs": {"u": "3 - 8*leg.angle - leg.angular_velocity"}}},
}
CHAIN: Data = {"name": "double-pendulum", "angles": [0.3, -0.2]}
FLOOR_AND_BALL: Data = {
    "bodies": ["ground", "ball"],
    "shapes": [{"line": {"normal": [0.0, 1.0]}}, {"circle": {"radius": 0.1}}],
    "restitution": 0.8,
    "compliance": {"stiffness": 2e3, "dissipation": 0.2},
}
BALL: Data = {
    "name": "mechanism",
    "bodies": {"ball": {"mass": 1.0, "inertia": 0.004, "position": [0.0, 0.4]}},
    "contacts": {"floor": FLOOR_AND_BALL},
}
GEARED: Data = {
    "name": "mechanism",
    "bodies": {
        "small": {"mass": 1.0, "inertia": 0.01, "position": [0.05, 0.0]},
        "large": {"mass": 2.0, "inertia": 0.04, "position": [0.3, 0.1]},
    },
    "joints": {
        "A": {"type": "revolute", "bodies": ["ground", "small"], "at": [0.0, 0.0]},
        "B": {"type": "revolute", "bodies": ["ground", "large"], "at": [0.3, 0.0]},
        "teeth": {"type": "gear", "bodies": ["small", "large"], "points": [[-0.05, 0.0], [0.0, -0.1]],
                  "radii": [0.1, 0.2], "pressure_angle": 0.0},
    },
}  # fmt: skip
CAM: Data = {
    "name": "mechanism",
    "bodies": {
        "cam": {"mass": 1.0, "inertia": 0.01, "angular_velocity": 6.0},
        "follower": {"mass": 0.5, "inertia": 0.01, "position": [0.0, 0.06]},
    },
    "joints": {
        "shaft": {"type": "revolute", "bodies": ["ground", "cam"], "at": [0.0, 0.0]},
        "guide": {"type": "prismatic", "bodies": ["ground", "follower"], "at": [0.0, 0.06], "axis": [0, 1]},
        "lift": {"type": "cam", "bodies": ["cam", "follower"], "profile": "0.05 + 0.01*sin(angle)"},
    },
}
ANGLES: Data = {"low": {"when": "leg.angle - 0.2"}, "high": {"when": "leg.angle - 0.6", "action": "stop"}}


class WrongError(Exception):
    """A result is wrong, or a run that was not refused fails."""


def require(holds: bool, message: str) -> None:
    """Raise WrongError unless a condition holds."""
    if not holds:
        raise WrongError(message)


@dataclass(frozen=True)
class Member:
    """A method: its name, and its name in the tables."""

    name: str
    label: str

    @functools.cached_property
    def claims(self) -> Any:
        """The claims with default options."""
        plugin: Any = registry().get("integrator", self.name).plugin
        return plugin.claims(plugin.options())

    def spec(self, model: Data | str, end: float, steps: int = 100, **sections: Any) -> Data:
        """Return a spec with the method in its first formulation."""
        base = load_spec(model).model_dump(exclude_unset=True) if isinstance(model, str) else {"model": model}
        base = {key: base[key] for key in ("model", "parameters") if key in base}
        adaptive = self.claims.adaptive
        integrator = {"name": self.name} | ({"rtol": TOLERANCE} if adaptive else {})
        time = {"end": end} | ({} if adaptive else {"step": end / steps})
        first = {"formulation": self.claims.formulations[0]}
        return {"mbdkit": 1, "integrator": integrator, "time": time} | base | first | sections


def completed(spec: Data) -> mbdkit.Run:
    """Return a complete run."""
    run = simulate(load_spec(spec))
    require(run.status == "complete", f"the run stops: {run.status_reason}")
    return run


def values(run: mbdkit.Run) -> list[np.ndarray]:
    """Return what is compared: states at the end, or in all rows at equal intervals, and the times of events."""
    rows = slice(None) if run.run_spec.output.interval else slice(-1, None)
    found = [run.time[rows], *(run.array(f"trajectory/{name}")[rows] for name in ("position", "velocity"))]
    found += [state.value[rows] for state in run.states.values()]
    return [*found, np.sort(run.events.time)] if run.run_spec.events else found


@functools.cache
def reference(asked: str) -> list[np.ndarray]:
    """Return the values of a run of DOP853 with a model, end [s] and sections, as JSON."""
    model, end, sections = json.loads(asked)
    sections = {key: one for key, one in sections.items() if key not in ("formulation", "stabilization")}
    rigid = "contact" in sections  # with fixed steps only
    spec = Member("dop853", "").spec(model, end, 1000, **sections)
    return values(completed(spec if rigid else spec | {"integrator": DOP853, "time": {"end": end}}))


@dataclass(frozen=True)
class Compared:
    """The attempt of runs with steps of two sizes, which are compared with DOP853.

    `limit` is the largest order that the mechanism admits, `floor` the error below which it is not seen.
    """

    model: Data | str
    end: float = 1.0
    steps: int = 100
    limit: float = 9.0
    floor: float = FLOOR

    def __call__(self, method: Member, **sections: Any) -> None:
        """Raise WrongError unless the run with the shorter steps is right."""
        exact, claims, errors = reference(json.dumps([self.model, self.end, sections])), method.claims, []
        orders = claims.orders_on(sections.get("formulation", claims.formulations[0]))
        order = 1.0 if orders is None else min(orders.positions, orders.velocities, self.limit)
        steps = self.steps if order > 1 else 10 * self.steps
        for count in (2 * steps,) if claims.adaptive else (steps, 2 * steps):
            run = completed(method.spec(self.model, self.end, count, **sections))
            pairs = list(zip(values(run), exact, strict=True))
            shapes = [(one.shape, right.shape) for one, right in pairs if one.shape != right.shape]
            require(not shapes, f"its results have the shape {shapes[:1]}")
            errors.append(max(np.max(np.abs(one - right) / np.maximum(1, np.abs(right))) for one, right in pairs))
        allowed = max(self.floor, min(LARGEST, errors[0] * 2 ** (-order / 2)))  # long steps show half of an order
        allowed = CONTROLLED if claims.adaptive else allowed
        require(errors[-1] <= allowed, f"errors are {[f'{one:.1e}' for one in errors]}, the last above {allowed:.1e}")


def check(method: Member) -> None:
    """Estimate errors."""
    run, right = completed(method.spec(LEG, 1.0, 200, check=True)), reference(json.dumps([LEG, 1.0, {}]))
    known, reasons = run.accuracy, "; ".join(run.verdict_reasons)
    if known is None or not known.known_until >= 1.0:
        raise WrongError(f"errors are not known until the end: {reasons}")
    error = np.abs(values(run)[1] - right[1])
    require(bool(np.all(error < 10 * known.position_error[-1] + 1e-11)), f"errors {error} are far above the estimate")


def accuracy(method: Member) -> None:
    """Let the step or tolerance be chosen for an accuracy."""
    chosen = {"time": {"end": 1.0}, "accuracy": 1e-3, "integrator": {"name": method.name}}
    run, right = completed(method.spec(LEG, 1.0) | chosen), reference(json.dumps([LEG, 1.0, {}]))
    require(run.verdict != "bad", "; ".join(run.verdict_reasons))
    require(float(np.max(np.abs(values(run)[1] - right[1]))) < 1e-3, "the accuracy is missed")


def resume(method: Member) -> None:
    """Resume a run that is interrupted after ten steps."""
    spec, calls = method.spec(CHAIN, 2.0, 500), 0

    def stop(reached: float, end: float) -> None:
        nonlocal calls
        calls += 1
        if calls == 10:
            raise KeyboardInterrupt

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        with mock.patch.object(interface, "STRETCH", 0.0):
            simulate(load_spec(spec), path=path, progress=stop).close()
        with mbdkit.resume(path, overwrite=True) as run:
            require(run.data_sha256 == completed(spec).data_sha256, "the resumed run has other bits")


def gradients(method: Member) -> None:
    """Differentiate the last angle with respect to a stiffness; the reference is a difference of two runs."""
    spec, ends = method.spec(LEG, 1.0, 200), []
    found = mbdkit.gradient(spec, ["final(leg.angle)"], ["model.forces.hip.stiffness"]).jacobian[0, 0]
    for stiffness in (3.999, 4.001):
        model = LEG | {"forces": {"hip": SPRING | {"stiffness": stiffness}}}
        ends.append(reference(json.dumps([model, 1.0, {}]))[1][0, 0, 2])
    right = (ends[1] - ends[0]) / 0.002
    require(abs(found - right) < 1e-5, f"the derivative is {found}, not {right}")


def sample(method: Member) -> None:
    """Carry out a study with a sample, and repeat one of its runs alone, which must have equal bits."""
    drawn = {"n": 8, "method": "random", "seed": 1, "variables": {"model.angles.0": {"uniform": [-0.5, 0.5]}}}
    data = {"mbdkit_study": 1, "base": method.spec(CHAIN, 0.5, 50), "sample": drawn, "store": "hashes"}
    made = mbdkit.study(data, notify=QUIET, executor=ThreadPoolExecutor(1))
    require(made.status == "complete", f"the study is {made.status}")
    made.remake(3).close()


def lanes(method: Member) -> None:
    """Vectorize the runs of `sample`."""
    spec = load_spec(method.spec(CHAIN, 0.5, 50))
    if why := why_alone(spec):
        raise SpecError(f"runs are not vectorized: {why}")
    require(LaneRuns(Starts(), ()).members([spec])[0] is not None, "runs are not vectorized, without a reason")
    sample(method)


def study(method: Member) -> None:
    """Vary the step or the tolerance."""
    axis: Data = {"integrator.rtol": [1e-5, 1e-8]} if method.claims.adaptive else {"time.step": [0.01, 0.005]}
    right = {"integrator": DOP853, "formulation": "index-1", "time": {"end": 0.5}}
    base = method.spec(CHAIN, 0.5) | {"time": {"end": 0.5}}
    made = mbdkit.study(
        {"mbdkit_study": 1, "base": base, "axes": [axis], "reference": right},
        notify=QUIET,
        executor=ThreadPoolExecutor(1),
    )
    coarse, fine = made.columns()["end_error"]
    require(made.status == "complete", f"the study is {made.status}")
    require(fine < max(0.7 * coarse, FLOOR), f"the errors of the study are {coarse:.1e} and {fine:.1e}")


def packaged_study(name: str, method: Member) -> None:
    """Add the method to a packaged study, and carry out the two of its runs that have the fewest steps."""
    try:
        spec = with_methods(load_study_spec(name), method.name, QUIET)
    except SpecError as error:
        if "is already in this study" in error.message:
            return
        raise
    added = [one.spec for one in PlannedPoints(spec) if spec.added[-1] in one.axes.values()]
    for one in sorted(added, key=lambda one: (one.time.final - one.time.start) / (one.time.step or 1.0))[:2]:
        completed(one.model_dump(mode="json", exclude_unset=True))


_with = functools.partial
GROUPS: dict[str, dict[str, Callable[[Member], None]]] = {
    "Elements": {
        "states": Compared(MOTOR),
        "muscles": Compared("elbow-curl", 0.2, 200, limit=2),
        "controllers": Compared(SAMPLED),
        "drivers": Compared("slider-crank", 0.3),
        "gears": Compared(GEARED, 0.6),
        "cams": Compared(CAM, 0.3, 200),
        "compliant contact": Compared(BALL, 0.5, 400, floor=1e-6),
        "event-driven contact": _with(Compared(BALL, 0.8), contact={"treatment": "event-driven"}),
    },
    "Runs": {
        "events": _with(Compared(LEG, 2.0), events=ANGLES),
        "events that set states": _with(Compared(rotor(charge={"rate": "2 - states.charge"}), 2.0), events=FIRES),
        "`interval`": _with(Compared(LEG, limit=2), output={"interval": 0.0373}),
        "`check`": check,
        "`accuracy`": accuracy,
        "resumption": resume,
        "gradients": gradients,
    },
    "Studies": {
        "studies": study,
        "samples": sample,
        "vectorized": lanes,
        "`paper --with`": _with(packaged_study, "paper"),
        "`drift --with`": _with(packaged_study, "drift"),
    },
}

ATTEMPTS = {name: attempt for group in GROUPS.values() for name, attempt in group.items()}


def sentence(said: str, name: str) -> str:
    """Return a message without advice, details in parentheses, and the name of the method, so that methods share it."""
    said = re.split(r"; |, so use ", re.sub(r" \([^)]*\)", "", said))[0]
    said = re.sub(rf"(the )?(integrator )?'?([\w-]+:)?{re.escape(name)}'?(?![\w-])", "the method", said)
    said = re.sub(r"the formulation '[\w-]+'", "this formulation", said)
    return f"{said[0].upper()}{said[1:]}."


def tried(method: Member, capability: str) -> str:
    """Return "yes", the sentence with which the program refuses, or "wrong: " and what is wrong."""
    try:
        ATTEMPTS[capability](method)
    except MbdkitError as error:
        return sentence(str(getattr(error, "message", error)), method.name)
    except WrongError as error:
        return f"wrong: {error}"
    return "yes"


@contextmanager
def installed() -> Iterator[list[Member]]:
    """Give all installed methods, and those of the templates, which are generated and put on the path."""
    with tempfile.TemporaryDirectory() as name, mock.patch.object(sys, "path", [*sys.path]):
        made = {name: f"--like {like}" for like, name in install_templates(Path(name)).items()}
        names = [item.name for item in registry().of_kind("integrator")]
        yield [Member(one, made.get(one, one)) for one in sorted(names, key=lambda one: one in made)]
    forget()


def tables(found: dict[str, dict[str, str]]) -> str:
    """Return the tables of what `tried` returns for each method and capability, and the numbered reasons."""
    reasons: dict[str, int] = {}
    lines = []
    for group, columns in GROUPS.items():
        lines += [f"## {group}", "", f"| methods | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
        rows: dict[str, list[str]] = {}  # methods by their cells
        for label, results in found.items():
            cells = []
            for answer in (results[name] for name in columns):
                word = "wrong" if answer.startswith("wrong: ") else "no"
                cells += [answer if answer == "yes" else f"{word} {reasons.setdefault(answer, len(reasons) + 1)}"]
            rows.setdefault(" | ".join(cells), []).append(label)
        lines += [f"| {', '.join(labels)} | {cells} |" for cells, labels in rows.items()]
        lines += [""]
    return "\n".join([*lines, "## Reasons", "", *(f"{number}. {reason}" for reason, number in reasons.items()), ""])


def _plugin_text(project: Path) -> str:
    return (project / "src" / project.name.replace("-", "_") / "__init__.py").read_text(encoding="utf-8")


def main() -> int:
    """Try all cells, and print the tables or write them below the mark in the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.capabilities")
    parser.add_argument("--methods", nargs="+", help="names in the tables; all by default")
    parser.add_argument("--write", action="store_true", help=f"write the tables of all methods into {PAGE.name}")
    asked = parser.parse_args()
    known = {item.origin.distribution for item in registry().of_kind("integrator")}
    projects = [path.parent for path in ROOT.glob("plugins/*/pyproject.toml")]
    absent = [one.name for one in projects if one.name not in known and "mbdkit_integrators" in _plugin_text(one)]
    if asked.write and absent:
        parser.error(f"the page would lose the rows of {', '.join(absent)}; install them first")
    with installed() as methods:
        chosen = [one for one in methods if asked.methods is None or asked.write or one.label in asked.methods]
        found = {method.label: {name: tried(method, name) for name in ATTEMPTS} for method in chosen}
    made = tables(found)
    if asked.write:
        above = PAGE.read_text(encoding="utf-8").partition(MARK)[0]
        PAGE.write_text(f"{above}{MARK}\n\n{made}", encoding="utf-8")
    else:
        print(made)
    return int("| wrong" in made)


if __name__ == "__main__":
    sys.exit(main())
