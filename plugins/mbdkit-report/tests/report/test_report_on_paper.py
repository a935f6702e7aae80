"""The printed report: whole, light, without controls, and not longer than it must be."""

from __future__ import annotations

import shutil
import subprocess
from itertools import pairwise

import pytest

from tests.browser import opened


def test_on_paper_everything_is_whole_light_and_without_controls(browser, any_path):
    watched = opened(browser, any_path, width=703, color_scheme="dark")  # px: A4 without its margins
    tab = watched.page
    tab.emulate_media(media="print")
    tab.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    tab.wait_for_timeout(300)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 703
    assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert tab.locator(".main-svg").first.evaluate("svg => svg.style.background") == "rgb(255, 255, 255)"
    for name in (".tools", ".player .controls", ".magnifier", ".modebar", ".on-screen", "nav", "summary"):
        assert not any(one.is_visible() for one in tab.locator(name).all()), name
    cut = tab.evaluate(
        """() => [...document.querySelectorAll("figure, table, pre")].filter(one => {
            const box = one.getBoundingClientRect();
            return box.right > 703.5 || one.scrollWidth > one.clientWidth + 1
                || [...one.querySelectorAll(".main-svg")].some(svg => {
                    const own = svg.getBoundingClientRect();
                    return own.right > box.right + 0.5 || own.bottom > box.bottom + 0.5 || own.width < 330;
                });
        }).map(one => one.id || one.outerHTML.slice(0, 60))"""
    )
    assert cut == []
    heights = tab.evaluate("[...document.querySelectorAll('figure')].map(one => one.offsetHeight)")
    assert max(heights) < 1000  # px: a page has 1017
    kept = tab.evaluate(
        "[...document.querySelectorAll('figure')].every(f => getComputedStyle(f).breakInside === 'avoid')"
    )
    assert kept
    tab.context.close()


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext (poppler-utils) is not installed")
def test_the_printed_report_has_every_figure(browser, page_path, tmp_path):
    watched = opened(browser, page_path)
    watched.page.pdf(path=tmp_path / "page.pdf", format="A4")
    titles = watched.page.locator("#figures ~ .figures h3, #verdict ~ .figures h3").all_inner_texts()
    subprocess.run(["pdftotext", tmp_path / "page.pdf", tmp_path / "page.txt"], check=True)
    printed = (tmp_path / "page.txt").read_text(encoding="utf-8")
    pages = [" ".join(sheet.split()) for sheet in printed.split("\f")]
    captions = watched.page.locator(".figures figcaption").all_inner_texts()
    for title, text in zip(titles, captions, strict=True):
        assert any(title in sheet and text[:40] in sheet for sheet in pages), title  # on one page
    assert "Download" not in printed
    watched.page.context.close()


def test_the_motion_is_printed_as_frames_side_by_side_and_then_shown_as_before(browser, page_path):
    tab = opened(browser, page_path, width=703).page
    tab.get_by_role("button", name="Pause").click()
    picture = tab.evaluate("document.getElementById('stage').toDataURL()")
    drawn, last = tab.evaluate(
        """() => {
            const paint = Stage.prototype.paint, drawn = [];
            Stage.prototype.paint = function (frame, ...others) {
                const { a, e, f } = this.pen.getTransform(), { canvas } = this;
                const inside = e + a * this.width <= canvas.width + a && f + a * this.height <= canvas.height + a;
                drawn.push([frame, e / a, f / a, inside]);
                paint.call(this, frame, ...others);
            };
            window.dispatchEvent(new Event("beforeprint"));
            Stage.prototype.paint = paint;
            return [drawn, Number(document.getElementById("scrub").max)];
        }"""
    )
    frames = [frame for frame, *_ in drawn]
    assert frames[0] == 0
    assert frames[-1] == last
    assert all(a < b for a, b in pairwise(frames))
    assert len({(x, y) for _, x, y, _ in drawn}) == len(drawn) == 6
    assert all(inside for *_, inside in drawn)
    tab.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert tab.evaluate("document.getElementById('stage').toDataURL()") == picture
    tab.context.close()
