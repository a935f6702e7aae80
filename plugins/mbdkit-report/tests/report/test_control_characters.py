"""Control characters of titles and labels reach neither pages nor pictures."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import mbdkit
from mbdkit_report import report
from mbdkit_report.plot.plot_kinds import plot_kinds
from mbdkit_report.plot.save_plot import plot

ESCAPE = "red \x1b[31m\x00\x07\u202egnp \ufffe"
"""Colours of a terminal, a null character, a bell, reversed text, and a character that XML does not allow."""

HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\ufffe]")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Run:
    """A run whose title has control characters."""
    archive = tmp_path_factory.mktemp("run") / "run.h5"
    return mbdkit.run("double-pendulum", title=ESCAPE, time={"end": 0.1, "step": 0.01}, archive=archive)


@pytest.mark.parametrize("kind", plot_kinds())
def test_pictures_are_valid_xml(kind: str, run: mbdkit.Run, tmp_path: Path) -> None:
    try:
        plot(run, kind, tmp_path / "one.svg")
    except mbdkit.MbdkitError:
        pytest.skip("the double pendulum has none of these quantities")
    text = "".join(ElementTree.parse(tmp_path / "one.svg").getroot().itertext())
    assert "\\u001b[31m" in text
    assert not HARMFUL.search(text)


def test_pages_show_them_escaped(run: mbdkit.Run, tmp_path: Path) -> None:
    page = report(run.path, tmp_path / "run.html").read_text(encoding="utf-8")
    assert "\\u001b[31m" in page
    assert not HARMFUL.search(page)


@pytest.mark.usefixtures("pictures")
def test_reports_of_studies_and_their_pictures_show_them_escaped(tmp_path: Path) -> None:
    labels = [
        {"label": f"{ESCAPE[:9]}{number}", "value": {"name": name}} for number, name in enumerate(["rk4", "gauss"])
    ]
    base = {"model": {"name": "double-pendulum"}, "time": {"end": 0.1, "step": 0.01}}
    axes = [{"integrator": labels}, {"time.step": [0.01, 0.02]}]
    mbdkit.study({"mbdkit_study": 1, "title": ESCAPE, "base": base, "axes": axes}, out=tmp_path / "s")
    page = report(tmp_path / "s", tmp_path / "page.html", figures=tmp_path / "figures")
    assert not HARMFUL.search(page.read_text(encoding="utf-8"))
    pictures = list((tmp_path / "figures").glob("*.svg"))
    assert pictures
    for picture in pictures:
        ElementTree.parse(picture)
