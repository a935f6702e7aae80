"""Seams can grow and shrink: a function gets the arguments for which it asks, by name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from pydantic import BaseModel

from mbdkit.base.errors import PluginError
from mbdkit.plugin import seams
from mbdkit.registry.catalogue import KINDS
from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.seam import OwnSeam, Removed, Seam, removed
from mbdkit.registry.target import Target


@Seam
def wear_criterion(run: str, size: float, /, *, limit: int = 0) -> object:
    """Return what a function was passed."""
    raise NotImplementedError


@Seam
@removed(load=Removed("0.3", "`run.load`", 7.0), unit=Removed("0.4", "SI units"))
def load_criterion(run: str, /) -> object:
    """Return what a function was passed."""
    raise NotImplementedError


@OwnSeam
def wear_of(options: Any, run: str, size: float, /) -> object:
    """Return what a function was passed."""
    raise NotImplementedError


@pytest.fixture
def target(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Target[Any]]:
    """Return a function that makes the target of a function."""

    def make(function: Callable[..., object]) -> Target[Any]:
        module = ModuleType("wear_kit")
        module.function = function  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "wear_kit", module)
        return Target("wear_kit:function")

    return make


@pytest.mark.parametrize(
    ("function", "passed"),
    [
        (lambda run: run, "r"),
        (lambda anything: anything, "r"),
        (lambda size: size, 2.0),
        (lambda run, *, limit: (run, limit), ("r", 5)),
        (lambda size, /, run: (size, run), (2.0, "r")),
        (lambda run, tolerance=0.1: (run, tolerance), ("r", 0.1)),
        (lambda run, _: run, "r"),
        (lambda: "nothing", "nothing"),
        (lambda *everything, **named: (everything, named), (("r", 2.0), {"limit": 5})),
    ],
)
def test_a_function_gets_the_arguments_that_it_asks_for(function, passed, target):
    assert wear_criterion.of(target(function))("r", 2.0, limit=5) == passed


@pytest.mark.parametrize("function", [lambda run, size, limit=0: None, lambda _run, _size, *, limit, more=1: None])
def test_a_function_that_takes_all_arguments_is_called_itself(function, target):
    assert wear_criterion.of(target(function)) is function


def test_what_is_the_plugins_own_comes_first_under_any_name(target):
    assert wear_of.of(target(lambda mine, size: (mine, size)))({"k": 1}, "r", 2.0) == ({"k": 1}, 2.0)


def test_an_argument_that_is_not_passed_is_refused_with_those_that_are(target):
    words = r"'wear_kit:function' of wear_kit asks for `sise` \(did you mean 'size'\?\); `@wear_criterion` passes `run`"
    with pytest.raises(PluginError, match=words):
        wear_criterion.of(target(lambda run, sise: None))


def test_an_argument_that_is_removed_keeps_its_value_and_is_warned_of_once(target, caplog):
    function = target(lambda run, load: (run, load))
    assert [load_criterion.of(function)(run) for run in "ab"] == [("a", 7.0), ("b", 7.0)]
    (record,) = caplog.records
    sentence = "'wear_kit:function' of wear_kit asks for `load`, which `@load_criterion` does not pass since mbdkit 0.3"
    assert record.getMessage() == f"mbdkit: warning: {sentence}: use `run.load`"


def test_an_argument_that_is_removed_without_a_value_needs_a_default(target, caplog):
    with pytest.raises(PluginError, match=r"does not pass since mbdkit 0\.4: use SI units"):
        load_criterion.of(target(lambda run, unit: unit))
    assert load_criterion.of(target(lambda run, unit="m": unit))("r") == "m"
    assert len(caplog.records) == 1


def test_functions_of_items_without_a_decorator_are_served_alike():
    item = ModelPlugin("swing", "A swing", BaseModel, lambda: "a mechanism")
    assert item.build({"length": 1.0}) == "a mechanism"
    with pytest.raises(PluginError, match=r"`build` of the model 'swing' asks for `h`"):
        ModelPlugin("swing", "A swing", BaseModel, lambda options, h: None).check()


def test_items_pass_what_their_seams_declare():
    fields = [(kind, field) for kind in KINDS.values() for field in kind.arguments]
    pairs = [(kind.arguments[field], getattr(seams, kind.arguments[field].seam, None)) for kind, field in fields]
    assert {item.seam for item, seam in pairs if seam is None} == {"study_spec", "study_verdict", "step_filter"}
    assert all(item.positional == seam.arguments.positional for item, seam in pairs if seam is not None)
