"""Living with plugins: which API they are written for, and what the environment lets in."""

from __future__ import annotations

import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.registry.catalogue import KINDS
from mbdkit.registry.manager import load_registry
from mbdkit.registry.policy import API, FAMILIES, Policy


def declaring(module, version):
    module.mbdkit_api = version
    return module


@pytest.fixture
def two(entry_point, offering, swing, euler):
    return [entry_point(lambda: offering([swing()]), "Acme.Kit"), entry_point(lambda: offering([], [euler()]), "bolt")]


@pytest.mark.parametrize("version", [None, API, {"elements": 99}])
def test_a_plugin_of_these_versions_loads_and_so_does_one_that_does_not_say(version, entry_point, offering, swing):
    module = offering([swing()])
    loaded = load_registry([entry_point(lambda: module if version is None else declaring(module, version))])
    assert [item.name for item in loaded.items] == ["swing"]


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (
            {"models": 99},
            f"written for version 99 of models, and mbdkit {mbdkit.__version__} supports 1: upgrade mbdkit",
        ),
        ({"models": 0}, f"written for version 0 of models, and mbdkit {mbdkit.__version__} supports 1: upgrade acme"),
        ({"kernels": 99}, "written for version 99 of kernels"),
        (1, "its `mbdkit_api` is 1, not versions of families"),
        ({"models": True}, "its `mbdkit_api` is {'models': True}, not versions of families"),
        ({"wheels": 1}, "its `mbdkit_api` names wheels; the families are methods, laws, "),
    ],
)
def test_a_plugin_of_another_version_is_left_out_and_says_which_side_to_upgrade(
    version, words, entry_point, offering, swing
):
    loaded = load_registry([entry_point(lambda: declaring(offering([swing()]), version), "acme")])
    assert not loaded.items
    assert words in loaded.failures[0].error


def test_items_of_other_families_are_loaded(entry_point, offering, swing, euler):
    module = declaring(offering([swing()], [euler()]), {"models": 99, "methods": 1})
    loaded = load_registry([entry_point(lambda: module)])
    assert [item.name for item in loaded.items] == ["euler"]
    assert [report.id for report in loaded.failures] == ["acme:swing"]


def test_every_kind_of_items_belongs_to_a_family():
    assert sorted(kind for family in FAMILIES.values() for kind in family.kinds) == sorted(KINDS)


@pytest.mark.parametrize(
    ("environment", "names"),
    [
        ({}, ["swing", "euler"]),
        ({"MBDKIT_PLUGINS": "acme-kit"}, ["swing"]),
        ({"MBDKIT_PLUGINS": "ACME_kit, bolt"}, ["swing", "euler"]),
        ({"MBDKIT_PLUGINS": ""}, []),
        ({"MBDKIT_DISABLE_PLUGINS": "bolt"}, ["swing"]),
        ({"MBDKIT_PLUGINS": "bolt", "MBDKIT_DISABLE_PLUGINS": "bolt"}, []),
        ({"MBDKIT_DISABLE_PLUGINS": ""}, ["swing", "euler"]),
    ],
)
def test_the_environment_says_which_distributions_are_loaded(environment, names, two):
    assert [item.name for item in load_registry(two, Policy.of(environment)).items] == names


def test_mbdkit_itself_is_never_left_out(entry_point, offering, swing):
    ours = entry_point(lambda: offering([swing()]), "mbdkit")
    policy = Policy.of({"MBDKIT_PLUGINS": "", "MBDKIT_DISABLE_PLUGINS": "mbdkit"})
    assert [item.id for item in load_registry([ours], policy).items] == ["mbdkit:swing"]


def test_what_is_left_out_is_not_imported_and_is_told_where_it_is_missed(entry_point):
    def explode():
        raise AssertionError("imported")

    loaded = load_registry([entry_point(explode, "bolt")], Policy.of({"MBDKIT_DISABLE_PLUGINS": "bolt"}))
    (report,) = loaded.reports
    assert (report.status, report.error) == ("disabled", "left out by MBDKIT_DISABLE_PLUGINS")
    with pytest.raises(SpecError, match="bolt is left out by MBDKIT_DISABLE_PLUGINS"):
        loaded.get("integrator", "bolt:euler")


def test_a_long_id_of_a_distribution_that_is_not_there_says_so(two):
    with pytest.raises(SpecError, match="is provided by the distribution crank, which is not installed"):
        load_registry(two).get("integrator", "crank:euler")


def test_a_distribution_that_is_not_there_is_warned_of_once(two, caplog):
    load_registry(two, Policy.of({"MBDKIT_PLUGINS": "acme-kit,crank", "MBDKIT_DISABLE_PLUGINS": "chain"}))
    (record,) = caplog.records
    assert "MBDKIT_PLUGINS names 'crank'" in record.getMessage()
    assert "MBDKIT_DISABLE_PLUGINS names 'chain'" in record.getMessage()


@pytest.mark.parametrize("value", ["maybe", "2"])
def test_strictness_is_yes_or_no(value):
    with pytest.raises(SpecError, match="MBDKIT_STRICT_PLUGINS"):
        Policy.of({"MBDKIT_STRICT_PLUGINS": value})
