"""Errors of the code of items are sentences that name the item, and no item replaces one of mbdkit itself."""

from __future__ import annotations

import math

import pytest
from pydantic import BaseModel

import mbdkit
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.plugin import (
    Accessor,
    CriterionItem,
    IntegratorPlugin,
    PlotKind,
    SpecKind,
    SummaryLine,
    TableFormat,
)
from mbdkit.registry import accessors
from mbdkit.registry.item_options import named_options
from mbdkit.registry.manager import checked
from mbdkit.spec.spec_kinds import kind_of
from tests.registry.failing_items import target, wrong


class NoOptions(BaseModel):
    pass


@pytest.fixture(scope="module")
def run():
    return mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01})


def accessor(name, function):
    return Accessor(name=name, summary="An attribute.", of="Run", target=target(function))


@pytest.mark.parametrize("function", ["missing", "failing", "nowhere"])
def test_an_attribute_that_fails_is_named(function, run, installed):
    installed(acme=[accessor("jumps", function)])
    with pytest.raises(PluginError, match="the accessor 'acme:jumps' failed: "):
        accessors.computed(run, "jumps")


def test_two_distributions_with_one_attribute_are_both_named(run, installed):
    installed(acme=[accessor("jumps", "wrong")], zenith=[accessor("jumps", "wrong")])
    with pytest.raises(PluginError, match=r"acme 2.0 and zenith 2.0 both add the attribute `jumps`"):
        accessors.computed(run, "jumps")


def test_an_attribute_of_mbdkit_itself_stays(run, installed):
    installed(acme=[accessor("plot", "failing")])
    assert callable(accessors.computed(run, "plot"))


def test_an_accessor_never_replaces_an_attribute_of_mbdkit_and_is_named(installed, caplog):
    installed(acme=[Accessor(name="time", summary="Times.", of="Run", target=target("failing"))])
    recording = type("Run", (accessors.Extensible,), {"time": 3.0})
    assert [recording().time, recording().time] == [3.0, 3.0]
    (record,) = caplog.records
    assert "Run.time is an attribute of mbdkit itself, so 'acme:time' is not used" in record.getMessage()


@pytest.mark.parametrize(("function", "words"), [("failing", "ValueError: no such muscle"), ("wrong", "not pairs")])
def test_a_summary_line_that_fails_leaves_the_summary(function, words, run, installed):
    run.summary()  # imports what is replaced
    installed(acme=[SummaryLine(name="jumps", summary="Jumps.", text=target(function))])
    line = next(line for line in run.summary().splitlines() if line.startswith("jumps"))
    assert "the summary line 'acme:jumps'" in line
    assert words in line
    assert "status        complete" in run.summary()


def test_kinds_of_specs_never_replace_those_of_mbdkit(installed):
    code = {"load": target("failing"), "validate": target("failing")}

    def kind(name, marker):
        return SpecKind(name=name, summary="A kind.", marker=marker, order=1, **code)

    installed(acme=[kind("a", "motion"), kind("b", "jump"), kind("c", "")], zenith=[kind("d", "jump")])
    assert kind_of({"motion": {}}).name == "inverse"
    assert kind_of({"model": {}}).name == "run"
    with pytest.raises(SpecError, match="the kinds 'acme:b' and 'zenith:d'"):
        kind_of({"jump": 1})


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (lambda: accessor("jumps", "nowhere"), "does not provide"),
        (lambda: accessor("jumps", "__name__"), "cannot be called"),
        (lambda: PlotKind(name="jumps", summary="Jumps.", module="nowhere"), "does not provide"),
        (lambda: accessor("high-jumps", "wrong"), "as names in Python are"),
        (lambda: Accessor(name="x", summary="X.", of="Rum", target=target("wrong")), "'Rum'"),
        (lambda: Accessor(name="x", summary="X.", of="Run", target=wrong), "not a Target"),
        (lambda: TableFormat(name="x", summary="X.", suffix="txt", write=target("wrong")), "its suffix 'txt'"),
    ],
)
def test_the_doctor_reports_what_is_wrong_with_an_item(item, words, installed):
    failures = checked(installed(acme=[item()])).failures
    assert [words in (failure.error or "") for failure in failures] == [True]


def test_the_doctor_creates_methods_with_their_defaults(installed):
    def failing(options):
        raise ValueError("no such tableau")

    class Required(BaseModel):
        order: int

    def method(name, options):
        return IntegratorPlugin(
            name, "A method.", options, create=failing, claims=lambda options: mbdkit.Claims(order=4)
        )

    failures = checked(installed(acme=[method("fails", NoOptions), method("asks", Required)])).failures
    ((words, item),) = [(failure.error, failure.id) for failure in failures]
    assert item == "acme:fails"
    assert words.startswith("it cannot be created with its default options: ValueError: no such tableau")


def criterion(stage, function):
    of = frozenset({"run"})
    return CriterionItem(
        name="acme", summary="A criterion.", stage=stage, find=target(function), of=of, criteria=("acme",)
    )


@pytest.mark.parametrize("stage", ["spec", "start", "end"])
def test_a_criterion_of_a_plugin_examines_spec_start_and_end(stage, installed):
    installed(acme=[criterion(stage, "suspicious")])
    time = {"end": 0.1, "step": 0.01}
    found = mbdkit.run("pendulum", time=time)
    assert found.warnings == ["1 bodies", "acme-time: a note"]
    assert (found.verdict, found.verdict_reasons) == ("doubtful", ["1 bodies"])
    accepting = mbdkit.run("pendulum", time=time, accept=["acme"])
    assert (accepting.verdict, accepting.verdict_reasons) == ("unknown", ["Accepted by the spec: 1 bodies"])


@pytest.mark.parametrize(("function", "words"), [("failing", "no such muscle"), ("wrong", "neither a sentence nor")])
@pytest.mark.parametrize("stage", ["spec", "start", "end"])
def test_a_criterion_that_fails_is_named(stage, function, words, installed):
    installed(acme=[criterion(stage, function)])
    with pytest.raises(PluginError, match=f"the criterion 'acme:acme' failed: .*{words}"):
        mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01})


@pytest.mark.parametrize(
    ("claims", "words"),
    [
        ({"states": 1}, "`states` is 1, not True or False"),
        ({"restartable": None}, "`restartable` is None, not True or False"),
        ({"dense_order": math.nan}, "`dense_order` is nan, not a positive number or None"),
        ({"conserves": "energy"}, "`conserves` is 'energy', not a tuple of some of energy, linear-momentum"),
        ({"conserves": ("mass",)}, "not a tuple of some of energy"),
        ({"order": 3, "variable_order": True}, "it claims `variable_order`, but not `adaptive`"),
        ({"l_stable": True}, "it claims `l_stable`, but not `a_stable`"),
    ],
)
def test_impossible_claims_are_refused_in_one_sentence(claims, words, beside_ours):
    method = IntegratorPlugin("mine", "Mine", NoOptions, print, lambda options: mbdkit.Claims(**{"order": 1} | claims))
    loaded = checked(beside_ours(acme=[method]))
    assert [report.id for report in loaded.failures] == ["acme:mine"]
    assert words in loaded.failures[0].error
    with pytest.raises(PluginError, match="plugin 'acme:mine' cannot be used: "):
        named_options(next(item for item in beside_ours(acme=[method]).items if item.id == "acme:mine"))
