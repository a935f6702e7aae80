"""What others made is listed with its licence, and files that describe the project agree."""

from __future__ import annotations

import json
import re
import tomllib
from fnmatch import fnmatch

import yaml

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


def test_files_that_describe_the_project_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    about = json.loads((ROOT / ".github" / "codemeta.json").read_text(encoding="utf-8"))
    assert project["version"] == str(citation["version"]) == about["version"]
    assert (project["license"], about["license"]) == (
        citation["license"],
        f"https://spdx.org/licenses/{citation['license']}",
    )
    assert project["urls"]["Source"] == citation["repository-code"] == about["codeRepository"]
    assert project["description"] == about["description"]
    assert project["keywords"] == about["keywords"] == citation["keywords"]
    assert [one["name"] for one in project["authors"]] == [one["name"] for one in about["author"]]
