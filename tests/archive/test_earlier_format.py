"""An archive of format 1.0 stays readable: `format-1.0.h5`, a driven slider-crank with a spring, of that time.

Only its attributes `platform` and `command` were chosen.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.compare import compare
from mbdkit.archive.info import describe, text
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.cli import app
from mbdkit_report.pages.report import write_report

EARLIER = Path(__file__).with_name("format-1.0.h5")


@pytest.fixture
def earlier() -> Iterator[mbdkit.Run]:
    with mbdkit.load(EARLIER) as run:
        yield run


def test_it_loads_and_is_sound(earlier: mbdkit.Run) -> None:
    assert earlier.format_version == "1.0"
    assert check(EARLIER) == []
    assert earlier.joints["A"].reaction_force.shape == (21, 2)
    assert earlier.joints["A"].angle_units == ""
    assert "rod" in earlier.summary()
    assert "joints" in earlier.to_xarray()
    told = describe(EARLIER)
    assert (told["format_version"], told["forces"], told["markers"]) == ("1.0", {}, {})
    assert "format_version    1.0" in text(told)


def test_what_came_later_is_not_recorded_and_the_message_says_how_to_get_it(earlier: mbdkit.Run) -> None:
    for ask in (lambda: earlier.forces, lambda: earlier.markers, lambda: earlier.joints["A"].angle):
        with pytest.raises(NotRecordedError, match=r"its archive has format 1.0; `mbdkit rerun` with `-o`"):
            ask()
    assert not earlier.records("joints/driver_power")


def test_it_can_be_reported(earlier: mbdkit.Run, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    write_report(EARLIER, page)
    assert "an archive of format 1.0" in page.read_text()


def test_a_rerun_compares_the_arrays_that_both_have_and_says_so(earlier: mbdkit.Run, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["rerun", str(EARLIER), "-o", str(tmp_path / "new.h5")])
    told = " ".join(result.stdout.split())
    assert "the data that both archives have" in told
    assert "not compared: 17 arrays of forces and joints, which format 1.2 has and format 1.0 does not" in told
    result = CliRunner().invoke(app, ["archive", "diff", str(EARLIER), str(tmp_path / "new.h5"), "--json"])
    assert len(json.loads(result.stdout)["left_out"]) == 17
    with mbdkit.load(tmp_path / "new.h5") as later:
        found = compare(earlier, later)
        assert found.largest < 1e-6  # not to the bit, because machines and versions differ
        arrays, before = (set(describe(path)["arrays"]) for path in (tmp_path / "new.h5", EARLIER))
        assert set(found.left_out) == arrays - before
        assert compare(later, earlier).left_out == found.left_out
        np.testing.assert_allclose(later.joints["motor"].angle, 10.0 * later.time, atol=1e-12)
        assert later.forces["spring"].bodies == ("ground", "slider")


def test_a_changed_value_of_an_array_that_both_have_is_seen(earlier: mbdkit.Run, tmp_path: Path) -> None:
    spec = {**earlier.spec, "integrator": {"name": "gauss", "stages": 3}}
    with mbdkit.run(spec) as other:
        found = compare(earlier, other)
        assert not found.same_data
        assert 0 < found.differences["trajectory/position"] < 1e-4
        assert str(found).startswith("the data that both archives have differ by")
