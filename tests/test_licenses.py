"""What others made is listed with its licence."""

from __future__ import annotations

import re
from fnmatch import fnmatch

from tests.first_party import PACKAGES, ROOT

KINDS = {"*.csv", "*.json", "*.min.js", "*.yaml"}
NAMED = re.compile(r"CC BY|BSD|Apache|MIT licen[cs]e|copyright", re.IGNORECASE)


def test_each_packaged_file_that_names_a_licence_is_listed() -> None:
    text = (ROOT / "mbdkit" / "LICENSES.md").read_text(encoding="utf-8")
    patterns = [f"*{name.removesuffix('.csv').removesuffix('-*')}*" for name in re.findall(r"`([\w*/.-]+)`", text)]
    files = [file for folder in PACKAGES.values() for kind in KINDS for file in folder.rglob(kind)]
    made = [file for file in files if NAMED.search(file.read_text(encoding="utf-8")[:3000])]
    assert len(made) > 10
    assert [str(file) for file in made if not any(fnmatch(str(file), pattern) for pattern in patterns)] == []
