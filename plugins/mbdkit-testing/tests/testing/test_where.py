"""The command that prints where names are defined."""

from __future__ import annotations

from pathlib import Path

import pytest

import mbdkit
import mbdkit.plugin
from mbdkit.base.errors import SpecError
from mbdkit_testing import item_places


@pytest.mark.parametrize(
    ("name", "field", "file", "begins"),
    [
        ("gauss", "create", "mbdkit/methods/gauss.py", "def create("),
        ("gauss", "options", "mbdkit/methods/gauss.py", "class GaussOptions("),
        ("single-pendulum", "build", "mbdkit/models/pendulums.py", "def build_single("),
        ("table", "law", "mbdkit/laws/tabulated.py", "LAW = "),
        ("modes", "target", "plugins/mbdkit-statics/src/mbdkit_statics/commands.py", "def modes("),
        ("plugins new", "target", "plugins/mbdkit-testing/src/mbdkit_testing/commands.py", "def plugins_new("),
        ("drift", "spec", "plugins/mbdkit-paper/src/mbdkit_paper/drift/study.yaml", ""),
    ],
)
def test_where_prints_the_line_that_defines_what_a_name_adds(name, field, file, begins):
    found = item_places.whereabouts(name)
    (place,) = (place for item in found["items"] for place in item["places"] if place["field"] == field)
    path = Path(place["file"])
    assert path == Path(mbdkit.__file__).parents[1] / file
    assert path.read_text(encoding="utf-8").splitlines()[place["line"] - 1].startswith(begins)
    assert f"{path}:{place['line']}" in item_places.whereabouts_text(found)


def test_where_suggests_a_name():
    with pytest.raises(SpecError, match="there is no item 'gaus' \\(did you mean 'gauss'"):
        item_places.whereabouts("gaus")
