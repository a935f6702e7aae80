"""Sections, plots and table formats of plugins that fail are named."""

from __future__ import annotations

import pytest

import mbdkit
from mbdkit.base.errors import PluginError
from mbdkit.plugin import PlotKind, ReportSection, TableFormat
from mbdkit_report import export as exports
from mbdkit_report.pages.section_items import added_sections
from mbdkit_report.plot.plot_kinds import plot_kinds, plot_module
from tests.registry import failing_items
from tests.registry.failing_items import target


@pytest.fixture(scope="module")
def run():
    return mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01})


@pytest.mark.parametrize(("function", "words"), [("failing", "no such muscle"), ("wrong", "an object of type")])
def test_a_section_that_fails_is_named(function, words, run, installed):
    installed(acme=[ReportSection(name="jumps", summary="Jumps.", make=target(function))])
    with pytest.raises(PluginError, match=f"the report section 'acme:jumps' .*{words}"):
        added_sections(run, None)


def test_a_plot_that_fails_is_named_and_none_replaces_a_plot_of_mbdkit(run, installed):
    kinds = [PlotKind(name=name, summary="jumps", module=failing_items.__name__) for name in ("jumps", "energy")]
    installed(acme=kinds)
    assert plot_kinds()["energy"] == "energies and their balance"
    assert plot_kinds()["acme:energy"] == "jumps"
    with pytest.raises(PluginError, match="the plot kind 'acme:jumps' returned an object of type int, not"):
        plot_module("jumps").charts(run)
    with pytest.raises(PluginError, match=r"the plot kind 'acme:jumps' failed: .*no such muscle.*failing_items.py"):
        run.plot.jumps()


def test_a_table_format_that_fails_is_named_and_leaves_no_file(run, installed, tmp_path):
    installed(acme=[TableFormat(name="tsv", summary="Tabulators.", suffix=".txt", write=target("failing"))])
    with pytest.raises(PluginError, match=r"the table format 'acme:tsv' failed: .*no such muscle"):
        exports.export(run, tmp_path / "out", "tsv")
    assert not list(tmp_path.iterdir())
