"""The guide: its pages are found, their examples run as printed, their links lead somewhere, and none is stale."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit import Mechanism
from mbdkit.cli import app
from mbdkit.guide.pages import pages
from mbdkit.registry.manager import registry
from mbdkit.spec import load_spec
from mbdkit.spec.yaml_reader import read_yaml
from tests.first_party import PACKAGES, ROOT
from tests.printed_code import fenced_blocks, run_blocks

FILES = [path for folder in PACKAGES.values() for path in (folder / "guide").glob("*.md")]
PAGES = pages()
OWN = "plugins"
"""The page whose examples have tests of their own."""


def printed(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["guide", *arguments], prog_name="mbdkit")
    assert done.exit_code == 0
    return done.stdout


def test_every_file_of_the_folder_is_listed_with_one_line() -> None:
    files = {path.stem for path in FILES}
    lines = [line for line in printed().splitlines() if line.startswith(" ")]
    assert {line.split()[0] for line in lines} == files == set(PAGES)
    assert all(len(line) <= 140 and len(line.split()) > 4 for line in lines)


@pytest.mark.parametrize("topic", PAGES)
def test_a_page_is_printed_as_it_is(topic: str) -> None:
    assert printed(topic) == next(path for path in FILES if path.stem == topic).read_text(encoding="utf-8")
    assert PAGES[topic].text.startswith("# ")


def test_words_that_are_no_page_are_searched_for() -> None:
    found = printed("gas spring")
    assert "spec: `law: gas-spring`\n    " in found
    assert found == printed("gas-spring")


def test_a_wrong_topic_is_answered_with_the_nearest_one() -> None:
    done = CliRunner().invoke(app, ["guide", "studeis"], prog_name="mbdkit")
    assert done.exit_code == 2
    assert "no page 'studeis' (did you mean 'studies'?)" in done.stderr
    assert not done.stdout


@pytest.mark.end_to_end
@pytest.mark.parametrize("topic", [topic for topic, page in PAGES.items() if fenced_blocks(page.text) and topic != OWN])
@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
def test_the_examples_of_a_page_run_as_printed_and_without_a_doubt(topic: str, in_tmp_path: Path) -> None:
    judged = run_blocks(fenced_blocks(PAGES[topic].text), in_tmp_path)
    assert [reason for one in judged if one.level in ("doubtful", "bad") for reason in one.reasons] == []


def page_block(topic: str, start: str) -> str:
    """Return the YAML block of a page that begins with `start`."""
    return next(block.code for block in fenced_blocks(PAGES[topic].text) if block.code.startswith(start))


def test_the_parameters_that_the_guide_shows_are_those_of_a_mechanism() -> None:
    model = read_yaml(page_block("mechanism", "parameters:"))[0]
    spec = load_spec({"mbdkit": 1, **model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}})
    rows = [row for row, _ in spec.mechanism().constraint_rows()]
    assert rows == ["A.x", "A.y", "B.x", "B.y", "C.normal"]
    assert spec.mechanism().joints["C"].points[1] == pytest.approx((0.3, 0.0))


def test_the_forces_that_the_guide_shows_are_those_of_a_mechanism() -> None:
    forces = read_yaml(page_block("mechanism", "forces:"))[0]["forces"]
    m = Mechanism()
    m.body("load", mass=1.0, inertia=0.1)
    m.body("frame", mass=1.0, inertia=0.1)
    assert Mechanism.from_spec(m.to_spec() | {"forces": forces}).forces.keys() == {"rope", "bush"}


def test_the_devices_that_the_guide_shows_are_those_of_a_mechanism() -> None:
    forces = read_yaml(page_block("mechanism", "forces:\n  exotendon"))[0]["forces"]
    m = Mechanism()
    for name, y in (("thigh", 0.0), ("shank", -1.0), ("foot", -2.0), ("seat", 1.0)):
        m.body(name, mass=1.0, inertia=0.1, position=(0.0, y))
    for name, first, second in (("hip", m.ground, "thigh"), ("knee", "thigh", "shank"), ("ankle", "shank", "foot")):
        m.revolute(name, first, second, at=(0.0, 0.0))
    assert Mechanism.from_spec(m.to_spec() | {"forces": forces}).forces.keys() == {"exotendon", "brace", "strut"}


def test_the_jack_of_the_scissor_lift_exerts_the_force_of_statics(in_tmp_path: Path) -> None:
    # virtual work: F dx = W dy with x = L cos(angle), y = L sin(angle); half of each arm's weight counts
    (in_tmp_path / "lift.yaml").write_text(page_block("mechanism", "mbdkit: 1\ntitle: Scissor"), encoding="utf-8")
    force = mbdkit.run("lift.yaml").joints["jack"].reaction_force[[0, -1], 0]
    weight = (500 + 2 * 20 / 2) * 9.81
    assert -force == pytest.approx([weight / math.tan(math.radians(15)), weight / math.tan(math.radians(60))], rel=1e-6)


def anchors(text: str) -> set[str]:
    """Return the anchors that GitHub gives to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(path: Path) -> list[str]:
    """Return the relative links of a page that lead to no file or heading."""
    text = path.read_text(encoding="utf-8")
    prose = re.sub(r"^```.*?^```$|`[^`\n]*`", "", text, flags=re.MULTILINE | re.DOTALL)
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", prose):
        file, _, anchor = link.partition("#")
        target = path if not file else path.parent / file
        if link.startswith(("http", "mailto")):
            continue
        if not target.exists() or (anchor and anchor not in anchors(target.read_text(encoding="utf-8"))):
            broken.append(link)
    return broken


@pytest.mark.parametrize("path", sorted([*FILES, ROOT / "README.md"]), ids=lambda p: p.stem)
def test_links_lead_somewhere(path: Path) -> None:
    assert not broken_links(path)


def test_the_reference_has_every_joint_force_law_model_and_integrator() -> None:
    for item in registry().only("mbdkit").items:
        if item.kind in ("model", "integrator", "force-law", "measure"):
            assert re.search(rf"^#+ `(name|law): {item.name}`$|`{item.name}`$", PAGES["spec"].text, flags=re.MULTILINE)
