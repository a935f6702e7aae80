"""Wrong specs are refused with file, line and key of what is wrong, and words on what would be right.

The tables `wrong_specs.yaml` and `wrong_texts.yaml` say how they are read.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml

from mbdkit.base.errors import SpecError
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.spec_texts import place

REMOVED = "(removed)"
"""Value of a key that a change leaves out."""


def cases(file: str) -> list[Any]:
    """Return base and cells of each case of a table."""
    table = yaml.safe_load(Path(__file__).with_name(file).read_text(encoding="utf-8"))
    return [
        pytest.param(section["base"], *cells, id=f"{title}: {name}")
        for title, section in table.items()
        for name, cells in section["cases"].items()
    ]


@pytest.mark.parametrize(("base", "changes", "key", "words"), cases("wrong_specs.yaml"))
def test_a_wrong_spec_is_refused_with_its_key(
    base: dict[str, Any], changes: dict[str, Any], key: str, words: str
) -> None:
    spec = copy.deepcopy(base)
    for path, value in changes.items():
        *parents, last = path.split(" > ")
        section = spec
        for parent in parents:
            section = section[parent]
        if value == REMOVED:
            del section[last]
        else:
            section[last] = value
    with pytest.raises(SpecError) as caught:
        build(load_spec(spec))
    assert str(caught.value.key) == key
    assert words in caught.value.message
    assert "\n" not in caught.value.message
    assert len(caught.value.message) < 700


@pytest.mark.parametrize(("base", "old", "new", "line", "key", "words"), cases("wrong_texts.yaml"))
def test_a_wrong_text_is_refused_with_file_line_and_key(
    base: str, old: str, new: str, line: int | None, key: str, words: str, tmp_path: Path
) -> None:
    assert base.count(old) == 1
    file = tmp_path / "spec.yaml"
    file.write_text(base.replace(old, new))
    with pytest.raises(SpecError) as caught:
        build(load_spec(str(file)))
    assert str(caught.value).startswith(place(file, line, key))
    assert words in str(caught.value)
