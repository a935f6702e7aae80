"""The guide to measures says the truth: each of its blocks is tried."""

from __future__ import annotations

import re
from pathlib import Path

import mbdkit
from mbdkit.measures.measured_quantities import ATTRIBUTES
from mbdkit.measures.take import describe
from mbdkit.spec import load_spec
from mbdkit.spec.reading import read_text
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.spec.study_loading import load_study_spec

GUIDE = (Path(mbdkit.__file__).parent / "guide" / "measures.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL)


def test_the_study_is_valid_and_has_the_units_that_it_says() -> None:
    text, _ = (text for language, text in BLOCKS if language == "yaml")
    plan = plan_study(load_study_spec(read_text(text, "guide").data))
    units = {name: column.units for name, column in plan.defined.items()}
    assert units == {"peak_B": "N", "mean_B": "kN", "bend": "deg", "spring_work": "J"}


def test_the_measures_of_beams_are_valid() -> None:
    _, text = (text for language, text in BLOCKS if language == "yaml")
    spec = load_spec("leaf-spring", measures=read_text(text, "guide").data["measures"])
    units = {one.name: describe(one, spec).units for one in spec.defined_measures()}
    assert units == {
        "largest_moment": "N m", "stress_in_the_middle": "MPa", "stress_at_the_clamp": "MPa",
        "moment_at_the_end": "N m", "moment_near_a": "N m", "moment_at_a": "N m",
    }  # fmt: skip


def test_every_quantity_is_listed() -> None:
    for kind, names in ATTRIBUTES.items():
        row = next(line for line in GUIDE.splitlines() if line.startswith(f"| `{kind}"))
        missing = [name for name in names if f"`{name}`" not in row and not re.match(r"force_\w*[xy]$", name)]
        assert missing == []
