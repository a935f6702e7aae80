"""Names, titles and labels that spreadsheets, browsers or terminals would execute, in everything that is exported."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from .archive_attacks import command_in_child
from .attack import Attack
from .folder_attacks import work_here

TEXTS = (
    "=cmd|calc!A0",
    '=HYPERLINK("http:","x")',
    "+1+1",
    "-2+3",
    "@SUM(1)",
    "\uff1d1+1",
    "\uff0b1",
    "\uff0d1",
    "\uff20x",
    "<script>alert(1)",
    "]]><!--",
    "'\"&;",
    "%0d%0a=1",
    "a,b;c",
    "| a | b",
    "$(id)",
)
"""Texts that names may have."""

TITLES = (*TEXTS, "\t=1+1", "\r=1+1", "\n=1+1", "\x1b]0;owned\x07", "\u202e=1", "\x00=1", " =1+1")

FORMULA = re.compile("[=+@\uff1d\uff0b\uff0d\uff20\t\r\n-]")

HARMFUL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e]|<script>alert")


def spec(random: np.random.Generator) -> dict[str, Any]:
    """Return the spec of a rod with hostile names."""

    def name() -> str:
        return f"{TEXTS[int(random.integers(len(TEXTS)))].replace('.', '')}{random.integers(1000)}"

    body = name()
    model = {
        "name": "mechanism",
        "bodies": {body: {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {name(): {"type": "revolute", "bodies": ["ground", body], "points": [[0, 0], [-0.5, 0]]}},
        "forces": {name(): {"type": "torque", "body": body, "value": "sin(t)"}},
        "markers": {name(): {"body": body, "point": [0.5, 0.0]}},
    }
    return {
        "mbdkit": 1,
        "title": TITLES[int(random.integers(len(TITLES)))],
        "model": model,
        "integrator": {"name": "rk4"},
        "time": {"end": 0.05, "step": 0.01},
        "events": {name(): {"when": "t - 0.02"}},
    }


def formulas(random: np.random.Generator, folder: Path) -> list[str]:
    """Export runs and studies with hostile names."""
    one = spec(random)
    chosen = [TEXTS[index] for index in random.integers(len(TEXTS), size=2)]
    labels = [{"label": f"{chosen[0]}1", "value": {"name": "rk4"}}, {"label": chosen[1], "value": {"name": "rk-gill"}}]
    study = {"mbdkit_study": 1, "title": one["title"], "base": one, "axes": [{"integrator": labels}]}
    (folder / "run.json").write_text(json.dumps(one))
    (folder / "study.json").write_text(json.dumps(study))
    found = []
    for words in (
        ("run", "run.json", "-o", "run.h5"),
        ("archive", "export", "run.h5", "--to", "csv", "-o", "tables"),
        ("plot", "run.h5", "-o", "plot.svg"),
        ("report", "run.h5", "-o", "run.html"),
        ("report", "run.h5", "-o", "run.md"),
        ("study", "study.json", "-o", "study", "--report"),
        ("archive", "export", "study", "--to", "csv", "-o", "runs"),
    ):
        ending = command_in_child(*words, folder=folder, seconds=300, prepare=work_here)
        found += [text for text in ending.problems(allowed=(0, 3), what=" ".join(words)) if " took " not in text]
        if HARMFUL.search((ending.output + ending.errors).replace("<script>alert", "")):
            found.append(f"{' '.join(words)} printed control characters")
    for path in folder.rglob("*.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            found += [
                f"{path.name} has the cell {cell[:40]!r}" for row in csv.reader(file) for cell in row if _runs(cell)
            ]
    for path in (*folder.rglob("*.html"), *folder.rglob("*.md"), *folder.rglob("*.svg")):
        if match := HARMFUL.search(path.read_text(encoding="utf-8")):
            found.append(f"{path.name} has {match[0]!r}")
    for path in folder.rglob("*.svg"):
        try:
            ElementTree.parse(path)
        except ElementTree.ParseError as error:
            found.append(f"{path.name} is not well-formed: {error}")
    return found


def _runs(cell: str) -> bool:
    """Return whether a spreadsheet takes a cell for a formula: it begins like one, and is no number."""
    if not FORMULA.match(cell):
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False


ATTACKS = (Attack("formulas", "hostile names in tables, pages and pictures: displayed, never executed", 300, formulas),)
