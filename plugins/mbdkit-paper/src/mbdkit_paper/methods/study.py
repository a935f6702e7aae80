"""The runs of the packaged study `methods`: all installed integrators on the problems with published results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from mbdkit.base.errors import MbdkitError
from mbdkit.registry.item_options import named_options
from mbdkit.registry.items import Claims
from mbdkit.registry.manager import registry
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec.formulation_choice import choice_of
from mbdkit_paper.methods.problems import Problem, problems
from mbdkit_studies import IN_TOLERANCES, claims_of

#: Options that stand for families of methods; the other integrators have their default options.
OPTIONS: Mapping[str, tuple[dict[str, int], ...]] = {
    "gauss": ({"stages": 2}, {"stages": 3}),
    "radau-iia": ({"stages": 3},),
    "lobatto-pair": ({"stages": 3},),
}

#: Families of integrators, with their members; another integrator is a family of its own.
FAMILIES: Mapping[str, Sequence[str]] = yaml.safe_load(Path(__file__).with_name("families.yaml").read_text("utf-8"))
OTHERS = ("scipy-", "sundials-")  #: Beginnings of the names of integrators that are codes of others.


def family_of(integrator: str) -> str:
    """Return the family of an integrator."""
    name = integrator.rpartition(":")[2]
    return next((found for found, members in FAMILIES.items() if name in members), name)


@dataclass(frozen=True)
class Extent:
    """How much a form of the study computes.

    Attributes
    ----------
    steps
        Fixed steps as shares of the largest step of each problem.
    tolerances
        Relative tolerances of adaptive methods.
    wall_time
        Limit of the wall time of each run [s]. Runs that reach it are results.
    """

    steps: tuple[float, ...]
    tolerances: tuple[float, ...]
    wall_time: float


WHOLE = Extent((1.0, 0.5, 0.25, 0.125), (1e-4, 1e-6, 1e-8, 1e-10), 10.0)
QUICK = Extent((1.0, 0.25), (1e-5, 1e-8), 1.0)


@dataclass(frozen=True)
class Method:
    """An integrator with options, and its claims."""

    label: str
    integrator: Mapping[str, Any]
    claims: Claims

    @property
    def has_tolerance(self) -> bool:
        """Whether the tolerance varies in place of the step."""
        options = named_options(registry().get("integrator", self.integrator["name"])).model_fields
        return self.claims.adaptive and "rtol" in options


def installed() -> Iterator[Method]:
    """Yield the installed integrators with the options of the comparison, also with adaptive steps if that is an
    option.
    """
    for item in registry().of_kind("integrator"):
        for options in OPTIONS.get(item.spec_name, ({},)):
            for steps in ({}, {"adaptive": True}):
                chosen = {"name": item.spec_name, **options, **steps}
                with suppress(MbdkitError, ValidationError):  # it has no such option, or needs others
                    claims = claims_of(chosen)
                    if claims.adaptive or not steps:
                        words = [item.spec_name, *(f"{key} {value}" for key, value in options.items()), *steps]
                        yield Method(", ".join(words), chosen, claims)


def _ways(method: Method, problem: Problem) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield words and keys of each formulation, or treatment of contacts, in which a method can solve a problem."""
    for name in method.claims.formulations:
        if name.partition(" ")[0] not in problem.formulations:
            continue
        keys = {"integrator": dict(method.integrator), "formulation": choice_of(name)}
        if not problem.treatments and (not method.claims.mechanisms or _supports(problem, keys)):
            yield name, keys
            if name == "index-1" and "projection" in method.claims.stabilizations:
                yield "index-1, projected", keys | {"stabilization": "projection"}
        for treatment in problem.treatments:
            if _supports(problem, keys | {"contact": {"treatment": treatment}}):
                yield f"{name}, {treatment}", keys | {"contact.treatment": treatment}


def _supports(problem: Problem, keys: dict[str, Any]) -> bool:
    """Return whether the method in the keys of a run does not refuse a problem."""
    try:
        RunSetup.of(problem.spec(problem.step, **keys)).require_support()
    except MbdkitError:
        return False
    return True


def column(problem: str, quantity: str) -> str:
    """Return the name of the measure of a result, which is unique in the study."""
    return f"{problem.replace('-', '_')}_{quantity}"


def study(quick: bool) -> dict[str, object]:
    """Return the spec of the study.

    Parameters
    ----------
    quick
        Whether each method has two steps or tolerances, and one second for each run.
    """
    extent = QUICK if quick else WHOLE
    methods = list(installed())
    families: dict[str, object] = {}
    for name, problem in problems().items():
        families |= _families(name, problem, methods, extent)
    return {
        "mbdkit_study": 1,
        "title": "Integrators on problems with published results" + (", short form" if quick else ""),
        "overrides": {
            "stabilization": "none",
            "output": {"every": 10**7},  # the rows at the start and at the end
            "limits": {"wall_time": extent.wall_time, "max_steps": 10**8},
        },
        "measures": ["misalignment_max", "multiplier_error"],
        "store": "files",
        "families": families,
    }


def _families(name: str, problem: Problem, methods: list[Method], extent: Extent) -> Iterator[tuple[str, object]]:
    """Yield the families of a problem: of methods whose step varies, and of those whose tolerance varies."""
    changes = dict(change.split("=", 1) for change in problem.changes)
    shared = {key: yaml.safe_load(value) for key, value in changes.items()}
    shared["measures"] = {column(name, key): quantity.value for key, quantity in problem.quantities.items()}
    shared["time"] = {"end": problem.end}
    reference: dict[str, object] = {"formulation": "index-1", "stabilization": "none", "time": {"end": problem.end}}
    reference |= {"limits.wall_time": None, **problem.precise}
    scale, tolerances = problem.step or 1.0, list(extent.tolerances)
    if problem.tightest and extent is WHOLE:
        tolerances.append(problem.tightest)
    for suffix, axis, varies in (
        ("", {"time.step": [share * scale for share in extent.steps]}, False),
        (IN_TOLERANCES, {"integrator.rtol": tolerances}, True),
    ):
        values = [
            {"label": f"{method.label}, {words}", "set": keys}
            for method in methods
            if method.has_tolerance == varies and (varies or problem.step)
            for words, keys in _ways(method, problem)
        ]
        if values:
            title = problem.title + (", tolerances" if varies else "")
            given = {"title": title, "base": problem.example, "overrides": shared, "reference": reference}
            yield name + suffix, given | {"axes": [{"method": values}, axis]}
