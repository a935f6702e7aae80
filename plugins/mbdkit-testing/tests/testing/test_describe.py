"""What `mbdkit plugins` shows."""

from __future__ import annotations

import json

import pytest

from mbdkit import IntegratorPlugin, ModelPlugin
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.strict_model import description
from mbdkit.registry.item import Plugin
from mbdkit.registry.manager import load_registry, registry
from mbdkit.registry.policy import Policy
from mbdkit_testing import describe
from tests.registry.conftest import FakeEntryPoint, SwingOptions, claim_order_one, offering_items


class Broken(FakeEntryPoint):
    def load(self):
        raise ImportError("no acme here")


@pytest.fixture
def mixed():
    model = ModelPlugin("swing", "A swing", SwingOptions, print, references=("@book{swing}",))
    integrator = IntegratorPlugin("swing", "Euler", SwingOptions, print, claims=claim_order_one)
    fine = offering_items(model, integrator)
    return load_registry([FakeEntryPoint(lambda: fine, "fine"), Broken(print, "broken")])


def test_the_listing_has_the_keys_of_the_contract(mixed):
    listing = describe.listing(mixed)
    assert json.loads(json.dumps(listing)) == listing
    fine = {"distribution": "fine", "version": "2.0", "status": "ok", "error": None}
    fine |= {"evidence": "never: there is no evidence of it"}
    assert listing["plugins"][-1] == {"id": "fine:swing", "kind": "integrator", **fine}
    assert listing["plugins"][0]["status"] == "error"
    place = f"{__file__}, line {Broken.load.__code__.co_firstlineno + 1}"
    assert listing["plugins"][0]["error"] == f"ImportError: no acme here ({place})"


def test_the_doctor_says_what_failed_and_how_long_loading_took(mixed):
    text = describe.diagnosis_text(mixed)
    assert "broken:plugin: error: ImportError: no acme here" in text
    assert "2 of 2 loaded in" in text
    assert all(entry["load_s"] >= 0 for entry in describe.diagnosis(mixed)["plugins"])
    assert mixed.failures


def test_show_finds_a_model_and_an_integrator_of_one_name(mixed):
    assert [item.kind for item in describe.find("swing", mixed)] == ["model", "integrator"]


def test_show_of_an_item_without_options_says_what_it_is_and_where_to_read_on():
    [command] = describe.find("rerun")
    page = describe.page(command)
    assert page.startswith("mbdkit:rerun (command)\n")
    assert command.plugin.summary in page
    assert page.endswith("mbdkit plugins where mbdkit:rerun")
    assert "options" not in describe.details(command)


def test_show_of_a_broken_plugin_says_why_it_is_broken(mixed):
    with pytest.raises(PluginError, match="no acme here"):
        describe.find("broken:plugin", mixed)


def test_show_of_an_unknown_one_suggests(mixed):
    with pytest.raises(SpecError, match="did you mean 'swing'"):
        describe.find("swnig", mixed)


@pytest.mark.parametrize(
    "item", [item for item in registry().items if isinstance(item.plugin, Plugin)], ids=lambda item: item.id
)
def test_every_built_in_has_a_page_and_details(item):
    page = describe.page(item)
    assert item.id in page
    assert item.plugin.summary in page
    details = json.loads(json.dumps(describe.details(item)))
    assert details["kind"] == item.kind
    assert ("law" if item.kind == "force-law" else "name") in details["options"]["properties"]
    for name in item.plugin.options.model_fields:
        assert name in page
        assert description(item.plugin.options, name), f"option {name} of {item.id} is not described"


def test_what_is_left_out_is_described_as_sound() -> None:
    loaded = load_registry([FakeEntryPoint(offering_items, "bolt")], Policy.of({"MBDKIT_DISABLE_PLUGINS": "bolt"}))
    assert "disabled: left out by MBDKIT_DISABLE_PLUGINS" in describe.diagnosis_text(loaded)
    assert "left out by MBDKIT_DISABLE_PLUGINS" in describe.listing_text(loaded)
    assert not loaded.failures
