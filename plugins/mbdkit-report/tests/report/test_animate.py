from __future__ import annotations

import json
import re
import subprocess

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from PIL import Image
from tests.report.page_elements import Elements

from mbdkit.base.errors import SpecError
from mbdkit_report.figures.scene import nearest_rows, round_speed, scene
from mbdkit_report.pages.animate import animate, page

EVIL = "</script><script>alert('x')</script><img src=https://evil.example/x.png onerror=alert(1)> @@DATA@@ & \"q\""


def data_of(text: str) -> dict:
    (film,) = json.loads(next(script for script in Elements(text).scripts if script.startswith("[")))
    return film


def test_a_gif_moves_in_real_time_and_repeats(make_run, tmp_path):
    path = animate(make_run(rows=101, step=0.02), tmp_path / "a.gif")
    with Image.open(path) as image:
        assert image.format == "GIF"
        first = np.asarray(image.convert("RGB"))
        assert image.size[0] == 640
        assert image.info["loop"] == 0
        assert image.convert("RGB").getpixel((2, image.height - 2)) == (255, 255, 255)
        durations = []
        for number in range(image.n_frames):
            image.seek(number)
            durations.append(image.info["duration"])
        assert np.any(np.asarray(image.convert("RGB")) != first)
    assert 47 <= len(durations) <= 51
    assert sum(durations) == pytest.approx(2000 + 1000, abs=50)


def test_a_long_run_makes_no_more_than_four_hundred_frames(make_run, tmp_path):
    run = make_run(rows=20_001, step=0.1)
    shown = scene(run, rate=25, most=401, shortest=2.0, longest=16.0)
    assert len(shown.time) <= 401
    assert shown.time[[0, -1]].tolist() == [0.0, 2000.0]
    assert shown.pace == "200 times faster than real time"
    assert animate(run, tmp_path / "a.html").stat().st_size < 1_000_000


@pytest.mark.parametrize(
    ("duration", "speed", "pace"),
    [
        (0.0, 1.0, "real time"),
        (5.0, 1.0, "real time"),
        (0.3, 0.1, "10 times slower than real time"),
        (60.0, 5.0, "5 times faster than real time"),
    ],
)
def test_time_runs_by_a_round_factor_that_is_told(make_run, duration, speed, pace):
    assert round_speed(duration, 2.0, 16.0) == speed
    if duration:
        run = make_run(rows=11, step=duration / 10)
        assert scene(run, rate=25, most=401, shortest=2.0, longest=16.0).pace == pace


def test_every_frame_is_a_recorded_row(make_run):
    run = make_run(rows=37, step=0.13)
    shown = scene(run, rate=25, most=401, shortest=2.0, longest=16.0)
    recorded = run.array("trajectory/position")
    for time, pose in zip(shown.time, shown.poses, strict=True):
        row = int(np.flatnonzero(run.time == time)[0])
        np.testing.assert_array_equal(pose, recorded[row])


def test_the_nearest_row_is_nearest():
    time = np.array([0.0, 0.1, 1.0])
    assert nearest_rows(time, [0.0, 0.04, 0.06, 0.5, 0.6, 1.0]).tolist() == [0, 0, 1, 1, 2, 2]
    assert nearest_rows(time[:1], [0.0, 0.0]).tolist() == [0, 0]


def test_a_page_holds_all_that_it_needs_and_asks_the_network_for_nothing(make_run, tmp_path):
    text = animate(make_run(), tmp_path / "a.html").read_text(encoding="utf-8")
    outline = Elements(text)
    assert outline.links == ["data:,"]
    assert not re.search(r"(?i)https?:|//[a-z0-9-]+\.[a-z]|url\(|@import|\bfetch\(|XMLHttpRequest|\bimport\b", text)
    assert "default-src 'none'" in text
    assert "@@" not in text


def test_text_from_a_spec_can_do_no_harm_in_a_page(make_run):
    run = make_run(
        title=EVIL, bodies=[EVIL, "b"], model={"name": "acme:<b>"}, status="failed", reason=f"not-finite: {EVIL}"
    )
    text = page(run)
    outline = Elements(text)
    assert outline.tags.count("script") == 3
    assert "img" not in outline.tags
    assert "b" not in outline.tags
    assert outline.title == EVIL
    assert data_of(text)["bodies"] == [EVIL, "b"]


def test_the_poses_in_a_page_are_those_of_the_run(make_run):
    run = make_run(rods=3, rows=201)
    data = data_of(page(run))
    frames = len(data["time"])
    poses = np.array(data["poses"], dtype=float).reshape(frames, 3, 3)
    grain, angle = data["grain"]
    left, right, bottom, top = data["view"]
    rows = nearest_rows(run.time, data["time"])
    recorded = run.array("trajectory/position")[rows]
    centre = [(left + right) / 2, (bottom + top) / 2]
    # margin: half a grain of the page
    np.testing.assert_allclose(poses[..., :2] * grain + centre, recorded[..., :2], rtol=0, atol=0.65 * grain)
    # margin: half a grain of the page
    np.testing.assert_allclose(poses[..., 2] * angle, recorded[..., 2], rtol=0, atol=0.65 * angle)
    assert data["speed"] == 1.0


def test_a_page_of_a_thousand_bodies_stays_small(make_run, tmp_path):
    assert animate(make_run(rods=1000, rows=600, step=0.02), tmp_path / "a.html").stat().st_size < 5_000_000


@pytest.mark.parametrize("suffix", ["gif", "html"])
def test_runs_that_ended_badly_can_be_animated(make_run, tmp_path, suffix):
    def spoil(data):
        data["trajectory/position"][-2:] = [[np.nan], [np.inf]]

    run = make_run(rows=6, change=spoil, status="failed", reason="not-finite: the state is not finite")
    animate(run, tmp_path / f"a.{suffix}")
    animate(make_run(rows=1, status="failed", reason="singular: at the start"), tmp_path / f"b.{suffix}")
    with pytest.raises(SpecError, match="no rows"):
        animate(make_run(rows=0, status="interrupted"), tmp_path / f"c.{suffix}")
    assert len(list(tmp_path.iterdir())) == 2


def test_without_ffmpeg_an_mp4_is_refused_with_what_is_needed(make_run, tmp_path, monkeypatch):
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(SpecError, match=r"needs the program ffmpeg.*\.gif or \.html"):
        animate(make_run(), tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not FFMpegWriter.isAvailable(), reason="there is no ffmpeg")
def test_an_mp4_plays(make_run, tmp_path):
    path = animate(make_run(), tmp_path / "a.mp4")
    assert path.read_bytes()[4:8] == b"ftyp"
    done = subprocess.run(
        [FFMpegWriter.bin_path(), "-v", "error", "-i", str(path), "-f", "null", "-"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
