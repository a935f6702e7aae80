"""Files that `mbdkit plot` writes: size, fonts, text, and the same bytes in every call; the options of the command."""

from __future__ import annotations

import re
import shutil
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from PIL import Image

from mbdkit.base.errors import SpecError
from mbdkit_report.plot.save_plot import plot, size_in_mm

SVG = "{http://www.w3.org/2000/svg}"
NAMES = ["_a$x^$", "振り子 & <b>"]


@pytest.fixture
def two(make_run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """Two archives in the current folder, which differ in their titles."""
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        make_run(title=name, joints=["A", "B"]).save(f"{name}.h5")
    return "a.h5", "b.h5"


def fonts_of(pdf: Path) -> set[str]:
    """Kinds of the fonts in a PDF file, as `pdffonts` or the file itself names them."""
    if shutil.which("pdffonts"):
        told = subprocess.run(["pdffonts", pdf], capture_output=True, text=True, check=True).stdout
        return {line[37:54].strip() for line in told.splitlines()[2:]}
    data = pdf.read_bytes()
    parts = [data]
    for stream in re.finditer(rb"stream\r?\n(.*?)endstream", data, re.DOTALL):
        try:
            parts.append(zlib.decompress(stream[1]))
        except zlib.error:
            continue
    return {kind.decode() for part in parts for kind in re.findall(rb"/Subtype\s*/(Type3|TrueType|CIDFontType2)", part)}


def test_pdf_has_no_type_3_fonts_and_the_same_bytes_twice(make_run: Any, tmp_path: Path) -> None:
    run = make_run(joints=NAMES)
    first, second = (plot(run, "reactions", tmp_path / f"{k}.pdf", size=(85.0, 60.0)).read_bytes() for k in "ab")
    kinds = fonts_of(tmp_path / "a.pdf")
    assert kinds
    assert not {kind for kind in kinds if "Type" in kind and "3" in kind}
    assert first == second
    assert b"CreationDate" not in first


@pytest.mark.parametrize("kind", ["trajectory", "reactions"])
def test_svg_has_text_no_date_and_the_same_bytes_twice(make_run: Any, tmp_path: Path, kind: str) -> None:
    run = make_run(joints=NAMES)
    first, second = (plot(run, kind, tmp_path / f"{k}.svg", size=(85.0, 60.0)).read_bytes() for k in "ab")
    assert first == second
    assert b"date>" not in first
    words = {"".join(element.itertext()).strip() for element in ElementTree.fromstring(first).iter(f"{SVG}text")}
    assert words & {"time [s]", "x [m]"}
    if kind == "reactions":
        assert words >= set(NAMES)


def test_a_figure_has_the_size_of_the_column(make_run: Any, tmp_path: Path) -> None:
    run = make_run()
    page = plot(run, "drift", tmp_path / "a.pdf", size=(85.0, 60.0)).read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([0-9.]+) ([0-9.]+) ?\]", page)
    assert box is not None
    assert [float(side) * 25.4 / 72 for side in box.groups()] == pytest.approx([85.0, 60.0], abs=0.01)
    with Image.open(plot(run, "drift", tmp_path / "a.png", size=(85.0, 60.0))) as image:
        assert image.size == pytest.approx((85 / 25.4 * 300, 60 / 25.4 * 300), abs=1.3)  # margin: whole pixels
        assert image.info["dpi"][0] == pytest.approx(300, abs=0.1)


def test_sizes_are_read_in_mm() -> None:
    assert size_in_mm("85mm") == (85.0, pytest.approx(0.66 * 85))
    assert size_in_mm("85mmx60mm") == (85.0, 60.0)
    assert size_in_mm("85.5 mm x 60 mm") == (85.5, 60.0)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ("85 85x60 85cm mm -85mm 8.5.5mm 85mmx nanmm", "as in 85mm or 85mmx60mm"),
        ("5mm 85mmx2000mm 1000000mm", "30 to 1000 mm"),
    ],
)
def test_other_sizes_are_refused(texts: str, message: str) -> None:
    for text in texts.split():
        with pytest.raises(SpecError, match=message):
            size_in_mm(text)


def words_of(svg: Path) -> list[str]:
    """Text of an SVG file."""
    return ["".join(text.itertext()).strip() for text in ElementTree.parse(svg).getroot().iter(f"{SVG}text")]


def test_the_command_draws_one_component_of_one_joint_of_two_runs(
    two: tuple[str, str], mbdkit: Callable[..., Any]
) -> None:
    options = ["--kind", "reactions", "--joint", "B", "--component", "x", "--size", "85mm", "-o", "fig.svg"]
    result = mbdkit("plot", *two, *options)
    assert result.exit_code == 0, result.stderr
    assert result.stdout == "fig.svg\n"
    words = words_of(Path("fig.svg"))
    assert {"B", "a", "b", "joint force, x component [N]", "time [s]"} <= set(words)


def test_the_default_file_is_named_after_the_first_run(two: tuple[str, str], mbdkit: Callable[..., Any]) -> None:
    assert mbdkit("plot", "a.h5", "--kind", "drift").stdout == "a-drift.png\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kind", "reactions", "--joint", "C"], "the run has no joint 'C'; available: A, B"),
        (["--kind", "energy", "--joint", "A"], "--joint is an option of --kind drift, reactions or torques, not of"),
        (["--kind", "drift", "--component", "x"], "--component is an option of --kind reactions or beams, not of"),
        (["--kind", "reactions", "--component", "z"], "not 'z'"),
        (["--size", "85"], "the size '85' is not understood"),
        (["--kind", "forces", "--size", "85mm"], "no force element of this run exerts a force"),
        (["-o", "fig.jpg"], "must end in .png, .svg or .pdf"),
        (["-o", "b.h5"], "this file is the input"),
    ],
)
def test_wrong_options_are_refused_in_a_sentence(
    two: tuple[str, str], refusal: Callable[..., str], options: list[str], message: str
) -> None:
    assert message in refusal("plot", *two, *options)
