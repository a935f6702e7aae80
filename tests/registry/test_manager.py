"""The loader survives what plugins do, and names are resolved without surprise."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import signal
import sys
from types import ModuleType, SimpleNamespace

import pytest
from pydantic import BaseModel, RootModel

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.base.interrupts import TOGETHER, _raise_interrupt
from mbdkit.registry.manager import checked, load_registry, registry
from tests.first_party import PARTS


def raising(error):
    def load():
        raise error

    return load


def test_the_built_ins_arrive_through_an_entry_point_like_any_others():
    ours = [ep for ep in importlib.metadata.entry_points(group="mbdkit") if ep.dist.name == "mbdkit"]
    with_items = {part for part in PARTS if importlib.util.find_spec(f"{part}.plugin")}
    assert set(PARTS) - with_items == {"mbdkit_builder", "mbdkit_gym"}  # they register nothing
    assert {ep.value for ep in ours} == {"mbdkit.builtin_plugin", *(f"{part}.plugin" for part in with_items)}
    points = {item.origin.entry_point.partition(" = ")[2] for item in registry().only("mbdkit").items}
    assert points == {ep.value for ep in ours}


def test_every_built_in_loads_and_states_summary_and_origin():
    builtin = registry().only("mbdkit")
    assert not builtin.failures
    models = "single-pendulum double-pendulum n-pendulum n-four-bar four-bar-knee leg leg-four-bar mechanism"
    devices = "hinge-orthosis four-bar-orthosis geared-orthosis self-aligning-orthosis hip-knee-exoskeleton"
    assert " ".join(item.name for item in builtin.of_kind("model")) == f"{models} {devices} passive-strut hinged-beam"
    methods = {item.name for item in builtin.of_kind("integrator")}
    assert {"rk-gill", "rk4", "dopri5", "dop853", "taylor", "gauss", "rattle", "lobatto-pair"} <= methods
    assert {"moreau-jean", "nonsmooth-generalized-alpha", "scipy-radau", "scipy-dop853", "scipy-lsoda"} <= methods
    for item in builtin.items:
        assert item.plugin.summary
        assert item.origin.version == mbdkit.__version__


def test_items_are_recorded_with_distribution_version_and_entry_point(entry_point, offering, swing, euler):
    loaded = load_registry([entry_point(lambda: offering([swing()], [euler()]), "acme", "2.0", "nice", "acme.nice")])
    assert [item.id for item in loaded.items] == ["acme:swing", "acme:euler"]
    origin = loaded.get("model", "swing").origin
    assert (origin.distribution, origin.version, origin.entry_point) == ("acme", "2.0", "nice = acme.nice")
    assert loaded.get("integrator", "acme:euler") is loaded.get("integrator", "euler")
    assert [report.status for report in loaded.reports] == ["ok", "ok"]


BROKEN = {
    "an exception": (raising(RuntimeError("no licence\nserver")), "RuntimeError: no licence server"),
    "a missing module": (raising(ModuleNotFoundError("No module named 'acme'")), "No module named 'acme'"),
    "sys.exit": (lambda: sys.exit("bye"), "SystemExit: bye"),
    "a bare BaseException": (raising(BaseException()), "BaseException"),
    "KeyboardInterrupt": (raising(KeyboardInterrupt("stop")), "KeyboardInterrupt: stop"),
    "no hooks at all": (lambda: SimpleNamespace(), "implements none of the hooks"),
    "nothing": (lambda: None, "none of the hooks"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_plugin_that_fails_to_load_costs_one_line_and_nothing_else(case, entry_point, offering, swing, caplog):
    loader, sentence = BROKEN[case]
    loaded = load_registry([entry_point(loader, "broken"), entry_point(lambda: offering([swing()]), "fine")])
    assert [item.id for item in loaded.items] == ["fine:swing"]
    (failure,) = loaded.failures
    assert failure.id == "broken:plugin"
    assert failure.status == "error"
    assert sentence in failure.error
    assert failure.seconds >= 0
    (record,) = caplog.records
    assert "\n" not in record.getMessage()
    assert "'broken:plugin'" in record.getMessage()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_interrupt_the_loading_of_plugins(number, entry_point, monkeypatch):
    before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    monkeypatch.setattr("mbdkit.base.interrupts._last", -TOGETHER)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, _raise_interrupt)
        with pytest.raises(KeyboardInterrupt):
            load_registry([entry_point(lambda: signal.raise_signal(number), "slow")])
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


@pytest.mark.parametrize(
    ("name", "hook", "words"),
    [
        ("mbdkit_models", lambda swing: lambda surprise: [swing()], "surprise"),
        ("mbdkit_modles", lambda swing: lambda: [swing()], "mbdkit_modles"),
        ("mbdkit_models", lambda swing: lambda: sys.exit(1), "SystemExit"),
    ],
)
def test_a_wrong_hook_is_reported(name, hook, words, entry_point, swing):
    loaded = load_registry([entry_point(lambda: SimpleNamespace(**{name: mbdkit.hookimpl(hook(swing))}))])
    assert not loaded.items
    assert words in loaded.failures[0].error


@pytest.mark.parametrize("answer", [{"swing": 1}, "swing", 5])
def test_a_hook_that_returns_no_list_is_reported(answer, entry_point, offering):
    loaded = load_registry([entry_point(lambda: offering(answer))])
    assert "not a list" in loaded.failures[0].error


def test_a_broken_item_does_not_take_its_neighbours_along(entry_point, offering, swing, euler):
    wrong = [{"name": "bad name!"}, {"options": dict}, {"options": "SwingOptions"}, {"build": None}]
    wrong += [{"summary": "two\nlines"}, {"references": ["@book{x}"]}]
    changed = [swing(**({"name": f"swing{number}"} | changes)) for number, changes in enumerate(wrong)]
    models = [swing(), *changed, "swing", euler(), None, swing(), swing(name="last")]
    loaded = load_registry([entry_point(lambda: offering(models, [euler(), swing(), euler(name="e", claims=3)]))])
    assert [item.id for item in loaded.items] == ["acme:swing", "acme:last", "acme:euler"]
    assert len(loaded.failures) == len(models) - 2 + 2
    assert all(report.error and "\n" not in report.error for report in loaded.failures)


def test_options_that_pydantic_cannot_build_are_reported(entry_point, offering, swing):
    class Later(BaseModel):
        value: DefinedNowhere  # noqa: F821

    loaded = checked(load_registry([entry_point(lambda: offering([swing(options=Later), swing(name="fine")]))]))
    assert [item.name for item in loaded.items] == ["fine"]
    assert "DefinedNowhere" in loaded.failures[0].error


def test_options_that_json_cannot_hold_are_reported(entry_point, offering, swing):
    class Odd(BaseModel):
        model_config = {"arbitrary_types_allowed": True}
        value: ModuleType

    models = [swing(options=Odd), swing(name="root", options=RootModel[int])]
    loaded = checked(load_registry([entry_point(lambda: offering(models))]))
    assert not loaded.items
    assert len(loaded.failures) == 2


def test_what_a_plugin_prints_on_import_does_not_reach_stdout(entry_point, offering, swing, capsys):
    def load():
        print("hello from acme")
        return offering([swing()])

    load_registry([entry_point(load)])
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "hello from acme" in captured.err


def test_a_clash_is_an_error_that_names_both_distributions_and_long_ids_still_work(entry_point, offering, euler):
    loaded = load_registry(
        [entry_point(lambda: offering([], [euler()]), *origin) for origin in (("acme",), ("bolt", "3"))]
    )
    with pytest.raises(SpecError, match=r"used by acme 2\.0 and bolt 3; write 'acme:euler' or 'bolt:euler'") as caught:
        loaded.get("integrator", "euler")
    assert caught.value.key == "integrator.name"
    assert loaded.get("integrator", "bolt:euler").origin.distribution == "bolt"
    assert loaded.names("integrator") == ["acme:euler", "bolt:euler"]
    assert [report.status for report in loaded.reports] == ["clash", "clash"]
    assert "bolt 3" in loaded.reports[0].error
    assert not loaded.failures


def test_an_unknown_name_gets_a_suggestion_and_a_word_on_what_is_broken(entry_point, offering, euler):
    broken = entry_point(raising(ImportError("x")), "broken")
    loaded = load_registry([entry_point(lambda: offering([], [euler()])), broken])
    with pytest.raises(SpecError) as caught:
        loaded.get("integrator", "eulr")
    assert "did you mean 'euler'?" in str(caught.value)
    assert "'broken:plugin' (see `mbdkit plugins doctor`)" in str(caught.value)


def test_canonical_names_are_short_for_ours_and_long_for_others(entry_point, offering, euler):
    loaded = load_registry([entry_point(lambda: offering([], [euler()]), name) for name in ("mbdkit", "acme")])
    assert [item.spec_name for item in loaded.items] == ["euler", "acme:euler"]
