"""Functions of plugins with another signature than declared: a type checker and `mbdkit plugins verify` find them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mbdkit.base.errors import PluginError
from mbdkit.registry.catalogue import Origin, Registered, Registry
from mbdkit.registry.item_options import check_item
from mbdkit_testing import verify

CODE = """
from collections.abc import Iterable
from pydantic import BaseModel
import mbdkit
from mbdkit.plugin import ActingForce, Element, ElementForces, ElementKind, Item, Lowering, Mechanism, RunSpec
from mbdkit.plugin import IntegratorPlugin, SpecKind, Target, loaded
from mbdkit.plugin.seams import (
    Source, element_lines, integrator_claims, integrator_method, lowering, run_check, spec_check, spec_loader,
    spec_schema,
)

class Jet(Element):
    body: str

class Spec(RunSpec):
    jump: float

class Options(BaseModel):
    gain: float = 1.0

class Euler(mbdkit.StepMethod):
    def __init__(self, options: Options):
        self.gain = options.gain

    def step(
        self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float
    ) -> mbdkit.StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        return state.moved(h * (state.v + h * a), h * a)

@lowering
def lower(jets: dict[str, Jet], lowering: Lowering, acting: tuple[ActingForce, ...]) -> tuple[str, ...]:
    return tuple(jets)

@run_check
def check(mechanism: Mechanism) -> None: ...

@element_lines
def lines(jet: Jet, mechanism: Mechanism) -> list[list[tuple[str, tuple[float, float]]]]:
    return [[(jet.body, (0.0, 0.0))]]

@integrator_method
def create(options: Options) -> Euler:
    return Euler(options)

@integrator_claims
def claims(options: Options) -> mbdkit.Claims:
    return mbdkit.Claims(order=1)

@spec_loader
def load(source: Source, assignments: Iterable[str]) -> Spec:
    return loaded("jump", Spec, source, assignments, {})

@spec_check
def validate(source: Source, name: str, assignments: list[str]) -> None: ...

@spec_schema
def schema(installed: object) -> dict[str, object]:
    return {}

items: list[Item] = [
    ElementKind(
        name="jet", summary="Jets.", key_in_model="jets", model=Target("MODULE:Jet"), draw=Target("MODULE:lines"),
        acts=ElementForces(lower=Target("MODULE:lower"), check_run=Target("MODULE:check")),
    ),
    IntegratorPlugin(
        "euler", "Euler.", Target("MODULE:Options"), Target("MODULE:create"), Target("MODULE:claims")
    ),
    SpecKind(
        name="jump", summary="Jumps.", marker="jump", command="jump", load=Target("MODULE:load"),
        validate=Target("MODULE:validate"), schema=Target("MODULE:schema"), model=Target("MODULE:Spec"),
    ),
]
"""

WRONG = {
    "element: an argument that is not passed": (
        "element-kind:jet", "acting: tuple[ActingForce, ...])", "acting: tuple[ActingForce, ...], gain: float)",
        "`@lowering` passes `elements`, `lowering` and `acting`",
    ),
    "element: an argument of another class": (
        "element-kind:jet", "def check(mechanism: Mechanism)", "def check(mechanism: RunSpec)",
        "takes RunSpec as `mechanism`, not Mechanism",
    ),
    "element: another result": (
        "element-kind:jet", "-> list[list[tuple[str, tuple[float, float]]]]:", "-> None:",
        "returns NoneType, not Sequence",
    ),
    "integrator: one argument too many": (
        "integrator:euler", "create(options: Options)", "create(options: Options, h: float)",
        "asks for `h`; `@integrator_method` passes `options`",
    ),
    "integrator: claims that are no claims": (
        "integrator:euler", "-> mbdkit.Claims:", "-> dict[str, int]:", "returns dict",
    ),
    "integrator: a method that is none": (
        "integrator:euler", "(options: Options) -> Euler:", "(options: Options) -> Options:",
        "returns Options, not Method",
    ),
    "spec: assignments by another name": (
        "spec-kind:jump", "(source: Source, assignments: Iterable[str]) ->", "(source: Source, *, assigned: str) ->",
        "asks for `assigned`",
    ),
    "spec: assignments by number": (
        "spec-kind:jump", "name: str, assignments: list[str]", "name: str, assignments: int",
        "takes int as `assignments`, not list",
    ),
    "spec: a schema that is text": ("spec-kind:jump", "-> dict[str, object]:", "-> str:", "returns str, not dict"),
}  # fmt: skip
"""The item that is wrong, what is changed in its code, and the sentence about it."""


def module(number: int) -> str:
    return f"wrong_signatures_{number}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the code as it should be (number 0) and with one change each."""
    folder = tmp_path_factory.mktemp("signatures")
    for number, (_, old, new, _) in enumerate([("", "", "", ""), *WRONG.values()]):
        assert old in CODE
        text = CODE.replace(old, new, 1) if old else CODE
        (folder / f"{module(number)}.py").write_text(text.replace("MODULE", module(number)), encoding="utf-8")
    return folder


def registered(folder: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, Registered]:
    monkeypatch.syspath_prepend(folder)
    items = __import__(module(number)).items
    return {f"{item.kind}:{item.name}": Registered(item.kind, item, Origin("acme", "1.0", "")) for item in items}


def test_functions_as_declared_are_accepted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for item in registered(folder, 0, monkeypatch).values():
        check_item(item)


@pytest.mark.parametrize(("number", "case"), list(enumerate(WRONG, 1)))
def test_a_wrong_signature_is_refused_in_one_sentence(
    number: int, case: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, _, _, sentence = WRONG[case]
    items = registered(folder, number, monkeypatch)
    with pytest.raises(PluginError, match=re.escape(sentence)) as refused:
        check_item(items.pop(name))
    assert "\n" not in str(refused.value)
    for other in items.values():
        check_item(other)


def test_verify_reports_the_kind_of_specs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, verified in ((0, True), (9, False)):
        items = Registry(registered(folder, number, monkeypatch).values())
        report = verify("spec-kind", "jump", installed=items)
        assert report.verified is verified, report.text()
        assert ("returns str, not dict" in report.text()) is not verified


def test_a_function_without_a_decorator_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "undecorated.py").write_text(CODE.replace("@spec_schema\n", "").replace("MODULE", "undecorated"), "utf-8")
    monkeypatch.syspath_prepend(folder)
    items = {item.name: item for item in __import__("undecorated").items}
    with pytest.raises(PluginError, match=r"its `schema`, 'undecorated:schema', is not decorated with `@spec_schema`"):
        check_item(Registered("spec-kind", items["jump"], Origin("acme", "1.0", "")))


@pytest.mark.slow  # mypy reads all of mbdkit
def test_mypy_finds_every_wrong_signature_where_it_is_written(folder: Path) -> None:
    pytest.importorskip("mypy")
    files = [f"{module(number)}.py" for number in range(len(WRONG) + 1)]
    flags = ("--strict", "--no-error-summary", "--output", "json", "--cache-dir", str(folder / "cache"))
    done = subprocess.run([sys.executable, "-m", "mypy", *flags, *files], cwd=folder, capture_output=True, text=True)
    errors = [json.loads(line) for line in done.stdout.splitlines()]
    found = {error["file"] for error in errors if error["severity"] == "error"}
    assert found == set(files[1:]), done.stdout + done.stderr
