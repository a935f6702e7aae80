"""The gallery: every packaged example has its picture, its entry in the page, and one source in both places."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from mbdkit.spec import example_names, example_text

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "mbdkit" / "models" / "examples" / "README.md"
ADDRESS = r"https://[^\s)>]+[^\s)>,.:;]"

every_example = pytest.mark.parametrize("name", example_names())


def entries() -> dict[str, str]:
    """Return the text of each entry of the page by its heading."""
    text = PAGE.read_text(encoding="utf-8")
    return dict(re.findall(r"^### (\S+)\n(.*?)(?=^##|\Z)", text, flags=re.MULTILINE | re.DOTALL))


def comments(name: str) -> str:
    """Return the comments at the head of an example, below the editor's line."""
    lines = example_text(name).splitlines()[1:]
    head = lines[: next(k for k, line in enumerate(lines) if not line.startswith("#"))]
    return "\n".join(line.removeprefix("#").strip() for line in head)


def test_the_page_has_every_example_and_no_other():
    assert sorted(entries()) == example_names()
    assert "(mbdkit/models/examples/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


@every_example
def test_example_says_where_it_comes_from(name):
    assert re.search(r"^Source: \S+", comments(name), flags=re.MULTILINE)


@every_example
def test_entry_has_the_picture_the_command_the_spec_and_the_source_of_the_example(name):
    entry = entries()[name]
    command = next(kind for kind in ("run", "inverse", "design", "predict", "identify") if name in example_names(kind))
    assert f"`mbdkit {command} {name}`" in entry
    assert re.search(rf"\([\w./-]*\b{re.escape(name)}\.yaml\)", entry)
    assert "* Source: " in entry
    assert set(re.findall(ADDRESS, entry)) <= set(re.findall(ADDRESS, comments(name)))
    shown, said = re.findall(r'<img src="(.*?)" width="\d+"\s+alt="(.+?)">', entry)[0]
    assert (PAGE.parent / shown).resolve() == ROOT / ".github" / "gallery" / f"{name}.png"
    assert len(said) > 20


@every_example
def test_picture_is_small_and_has_a_ground_of_its_own(name):
    path = ROOT / ".github" / "gallery" / f"{name}.png"
    assert path.stat().st_size < 60_000
    with Image.open(path) as picture:
        assert picture.getpixel((0, 0)) == picture.getpixel((picture.width - 1, picture.height - 1))
        corner = picture.convert("RGBA").getpixel((0, 0))
    assert corner == (255, 255, 255, 255)  # paper, not transparent: legible on a dark page too


def test_no_picture_is_left_over():
    assert sorted(path.stem for path in (ROOT / ".github" / "gallery").iterdir()) == example_names()
