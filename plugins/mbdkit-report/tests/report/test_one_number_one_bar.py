"""A number has one value and one bar: archive, JSON, summary, report and plots agree on each id."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

import mbdkit
from mbdkit.archive.reader import load
from mbdkit.base.plain_data import json_text
from mbdkit.base.text import plus_minus
from mbdkit.cli.outcome import _outcome
from mbdkit_report import run_report
from mbdkit_report.plot.save_plot import plot

NUMBER = r"-?[\d.]+(?:e[+-]\d+)?"
STATED = re.compile(rf"{NUMBER} (?:\+-|±) {NUMBER}")

#: Packaged examples, with the end of the motion where a whole check takes long [s].
FAST: dict[str, float | None] = {"slider-crank": 1.0, "crank-press": 0.6, "bouncing-ball": 0.3, "walking": None}
SLOW: dict[str, float | None] = {
    "andrews-squeezer": 0.01, "belt": 0.5, "cam-follower": 0.3, "car-axis": 0.3, "chain": 0.1, "point-pendulum": 0.5,
    "double-wishbone": 0.3, "elbow-curl": 0.2, "floating-slider-crank": 0.2, "four-bar": 0.5, "geared-five-bar": 0.5,
    "geared-knee-orthosis": 0.2, "gravity-balanced-arm": 0.5, "knee": 0.2, "knee-orthosis": 0.2, "leaf-spring": 0.05,
    "limit-stop": 0.2, "n-four-bar": 0.5, "particle-four-bar": 0.5, "pd-leg": 0.3, "pendulum": 0.5,
    "quick-return": 0.5, "rack-railway": 0.5, "series-elastic-knee": 0.2, "slider-crank-guide": 0.05,
    "watt-six-bar": 0.3, "person-walking": None, "walking-muscles": None,
}  # fmt: skip


class Stated(HTMLParser):
    """Texts of a page by id, and texts outside of elements with an id."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.inside: list[str] = []
        self.by_id: list[tuple[str, str, str]] = []
        self.without: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("td", "th", "dd", "script", "style", "pre"):
            given = dict(attrs)
            self.inside = [tag, given.get("data-id") or "", given.get("data-value") or ""]

    def handle_endtag(self, tag: str) -> None:
        if self.inside and tag == self.inside[0]:
            self.inside = []

    def handle_data(self, data: str) -> None:
        if self.inside and self.inside[1]:
            self.by_id.append((self.inside[1], self.inside[2], data))
        elif not self.inside or self.inside[0] not in ("script", "style", "pre"):
            self.without.append(data)


@pytest.mark.parametrize("name", [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_every_output_has_the_same_value_and_bar_of_an_id(name: str, tmp_path: Path) -> None:
    end, path = {**FAST, **SLOW}[name], tmp_path / "run.h5"
    if end is None:
        mbdkit.inverse(name, archive=path).close()
    else:
        spec = mbdkit.spec.load_spec(name, [f"time.end={end}", "check=true"])
        mbdkit.run(spec, archive=path).close()
    with load(path) as run:
        stored = {one["id"]: one for one in json.loads(run.file.attrs["answers"])}
        answers = json.loads(json_text(_outcome(run)["answers"]))
        summary, page = run.summary(), Stated(run_report(run).html())
        plot([run], "reactions" if run.joint_names else "energy", tmp_path / "plot.svg")
        picture = (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert {one["id"]: one for one in answers} == stored
    assert len(stored) == len(answers) > 0
    bars = {key: (one["lower"], one["upper"]) for key, one in stored.items() if one["lower"] is not None}
    numbers = {key: plus_minus(stored[key]["value"], bar) for key, bar in bars.items()}

    stated = set(STATED.findall(summary))
    assert stated <= {text for one in stored.values() for text in STATED.findall(one["text"])}
    assert not [text for text in page.without if STATED.search(text)]
    shown = [one for one in page.by_id if one[0] in stored]
    assert shown
    for key, value, text in shown:
        if value:  # a cell of a table: the number, or an end of its bar
            assert float(value) in (stored[key]["value"], *bars.get(key, ()))
            assert key not in numbers or text in re.split(r" \+- | \(", numbers[key])
        elif key in numbers:
            assert numbers[key].replace("+-", "±") in text
    for text in STATED.findall(picture):
        assert text.replace("±", "+-") in numbers.values()
    assert all(key in stored for key in re.findall(r'id="(max\([^"]*)"', picture))
