"""The report in a real headless browser, by eye, by keyboard, by screen reader, on a telephone, and on paper."""

from __future__ import annotations

import csv
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import mbdkit
from mbdkit.base.text import csv_cell
from mbdkit.spec import load_spec
from mbdkit.spec.yaml_reader import read_yaml
from mbdkit_report import render, report, run_report
from mbdkit_report.figures.player_data import film_data
from mbdkit_report.plot.caption import caption
from tests.browser import opened, until

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="pages are tested with axe and playwright")

EVIL = "</script><script>alert('x')</script><img src=https://evil.example/x.png onerror=alert(1)> & \"q\""

# Contrast and structure that a reader depends on; everything that axe knows of WCAG 2.1 A and AA.
RULES = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]}}


@pytest.fixture(scope="module")
def shared_page(browser, page_path):
    """A page for tests that leave the player alone and depend on nothing that another of them changes."""
    watched = opened(browser, page_path)
    yield watched
    watched.page.context.close()


def position(page):
    return int(page.locator("#scrub").input_value())


def test_the_animation_moves_and_can_be_stopped(page):
    tab = page.page
    tab.locator("#stage").scroll_into_view_if_needed()
    before = tab.evaluate("document.getElementById('stage').toDataURL()")
    start = position(tab)
    until(tab, f"document.getElementById('scrub').valueAsNumber > {start + 10}")
    assert tab.evaluate("document.getElementById('stage').toDataURL()") != before
    tab.get_by_role("button", name="Pause").click()
    stopped = position(tab)
    picture = tab.evaluate("document.getElementById('stage').toDataURL()")
    tab.wait_for_timeout(300)
    assert position(tab) == stopped
    assert tab.evaluate("document.getElementById('stage').toDataURL()") == picture


def test_the_gap_of_a_joint_is_drawn_between_its_bodies_ends(shared_page):
    """Magnified M times, the drawn points of a joint lie M gaps apart, whatever the drawing's own rounding."""
    tab = shared_page.page
    apart, wanted = tab.evaluate(
        """() => {
            const [film] = JSON.parse(document.getElementById("films").textContent);
            const stage = new Stage(document.createElement("canvas"));
            stage.show(film);
            const frame = film.time.length - 1, joint = film.gaps.joints.indexOf("J2"), [a, b] = film.gaps.ends[joint];
            const vector = factor => {
                stage.place(frame, factor);
                return [0, 1].map(k => stage.world[2 * b + k] - stage.world[2 * a + k]);
            };
            const [x, y] = vector(1), [far_x, far_y] = vector(101);
            return [Math.hypot(far_x - x, far_y - y), 100 * Math.hypot(...stage.gap(frame, joint))];
        }"""
    )
    assert wanted > 0
    assert apart == pytest.approx(wanted, rel=1e-6)


def test_the_keyboard_reaches_every_control_in_the_order_of_the_page(shared_page):
    tab = shared_page.page
    seen = []
    for _ in range(110):
        tab.keyboard.press("Tab")
        name = tab.evaluate("document.activeElement.id || document.activeElement.dataset.figure || ''")
        if name and name not in seen:
            seen.append(name)
    order = ["scrub", "play", "back", "next", "speed", "whole", "magnify", "misalignment", "trajectory"]
    assert [name for name in seen if name in order] == order


def test_the_keyboard_plays_steps_and_magnifies(page):
    tab = page.page
    tab.locator("#play").focus()
    tab.keyboard.press("Space")
    assert tab.locator("#play").inner_text() == "Play"
    tab.locator("#next").focus()
    before = position(tab)
    tab.keyboard.press("Enter")
    assert position(tab) == before + 1
    tab.locator("#magnify").focus()
    tab.keyboard.press("End")
    assert "times" in tab.locator("#gap").inner_text()


def test_the_keyboard_zooms_a_figure_and_shows_all_again(shared_page):
    tab = shared_page.page
    chart = tab.locator('[data-figure="misalignment"]')
    width = "e => e._fullLayout.xaxis.range[1] - e._fullLayout.xaxis.range[0]"
    whole = chart.evaluate(width)
    chart.focus()
    tab.keyboard.press("+")
    assert chart.evaluate(width) == pytest.approx(0.7 * whole)
    tab.keyboard.press("0")
    assert chart.evaluate(width) == pytest.approx(whole)


def test_the_button_of_a_curve_hides_it_and_brings_it_back(shared_page):
    tab = shared_page.page
    figure = tab.locator("#figure-misalignment")
    assert figure.locator(".scatterlayer .trace").count() == 2
    button = figure.get_by_role("button", name="J1")
    button.focus()
    tab.keyboard.press("Enter")
    assert button.get_attribute("aria-pressed") == "false"
    assert figure.locator(".scatterlayer .trace").count() == 1
    tab.keyboard.press("Enter")
    assert figure.locator(".scatterlayer .trace").count() == 2


def test_the_player_of_inverse_dynamics_shows_and_hides_forces(browser, tmp_path):
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=2.0, inertia=0.2, position=(0.0, -0.5))
    m.revolute("hip", m.ground, rod, at=(0, 0))
    time = np.linspace(0.0, 1.0, 51)
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": {"time": time, "hip.angle": 0.3 * np.sin(6 * time)}}}
    mbdkit.inverse(spec, archive=tmp_path / "run.h5").close()
    tab = opened(browser, report(tmp_path / "run.h5"), reduced_motion="reduce").page
    picture = "document.getElementById('stage').toDataURL()"
    assert "force in a joint" in tab.locator("#legend").inner_text()
    assert "longest arrow" in tab.locator("#legend").inner_text()
    shown = tab.evaluate(picture)
    tab.get_by_role("checkbox", name="Forces").uncheck()
    hidden = tab.evaluate(picture)
    assert hidden != shown
    tab.get_by_role("checkbox", name="Forces").check()
    assert tab.evaluate(picture) == shown
    tab.context.close()


def test_headings_are_in_order_and_everything_that_is_seen_has_a_name(browser, any_path):
    tab = opened(browser, any_path).page
    levels = tab.evaluate("[...document.querySelectorAll('h1,h2,h3,h4')].map(e => Number(e.tagName[1]))")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    unnamed = tab.evaluate(
        """() => [...document.querySelectorAll("canvas, .chart, input, button, select")]
            .filter(e => !(e.ariaLabel || e.labels?.length || e.textContent.trim()) && !e.closest(".modebar"))
            .map(e => e.outerHTML.slice(0, 80))"""
    )
    assert unnamed == []
    tab.context.close()


def test_axe_finds_nothing_to_mend(browser, any_path):
    # The colours are the same on both pages: one is looked at in the light, and one in the dark.
    watched = opened(browser, any_path, color_scheme="light" if any_path.name == "study.html" else "dark")
    watched.page.wait_for_timeout(300)
    found = axe.Axe().run(watched.page, options=RULES)
    assert found.response["violations"] == [], found.generate_report()
    watched.page.context.close()


def test_in_the_dark_page_and_figures_are_dark_and_follow_a_change(browser, page_path):
    watched = opened(browser, page_path, color_scheme="dark")
    tab = watched.page
    dark = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    paper = "document.querySelector('.chart .main-svg').style.background"
    assert dark == "rgb(22, 24, 27)"
    assert tab.evaluate(paper) == dark
    tab.emulate_media(color_scheme="light")
    until(tab, f"{paper} === 'rgb(255, 255, 255)'")
    assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    tab.context.close()


@pytest.mark.parametrize(("light", "paper"), [("true", "#ffffff"), ("false", "#16181b")])
def test_the_player_in_a_notebook_is_as_dark_as_its_theme(browser, make_run, tmp_path, light, paper):
    path = tmp_path / "notebook.html"
    cell = make_run().animate()._repr_html_()
    path.write_text(f'<!DOCTYPE html><body data-jp-theme-light="{light}">{cell}</body>', encoding="utf-8")
    tab = opened(browser, path, color_scheme="null").page  # no emulation, which frames would follow
    until(tab, "frames.length === 1")
    tab.wait_for_timeout(300)
    shown = tab.frames[1].evaluate("getComputedStyle(document.documentElement).getPropertyValue('--paper').trim()")
    assert shown == paper
    tab.context.close()


def test_who_asks_for_less_motion_gets_a_still_picture(browser, page_path):
    watched = opened(browser, page_path, reduced_motion="reduce")
    watched.page.wait_for_timeout(400)
    assert position(watched.page) == 0
    assert watched.page.locator("#play").inner_text() == "Play"
    watched.page.context.close()


def test_of_several_films_the_reader_chooses_one(browser, make_run, tmp_path):
    runs = [make_run(), make_run(rods=3)]
    films = [film_data(run, 10_000, label) for run, label in zip(runs, ("two rods", "three rods"), strict=True)]
    path = tmp_path / "films.html"
    path.write_text(render("animation.html", {"caption": caption(runs[0]), "films": films}), encoding="utf-8")
    watched = opened(browser, path)
    tab = watched.page
    assert tab.locator("#legend li").count() == 2
    tab.get_by_label("Run").select_option(label="three rods")
    assert tab.locator("#legend li").count() == 3
    assert tab.locator("#stage").get_attribute("aria-label") == "The mechanism in motion: three rods"
    assert watched.console == []
    tab.context.close()


def test_text_from_a_spec_does_no_harm(browser, make_run, tmp_path):
    run = make_run(
        title=EVIL, bodies=[EVIL, "<b>"], joints=[f"A {EVIL}", "J<b>"], status="failed", reason=f"not-finite: {EVIL}",
        model={"name": f"acme:{EVIL}"},
    )  # fmt: skip
    path = tmp_path / "evil.html"
    path.write_text(run_report(run).html(), encoding="utf-8")
    watched = opened(browser, path)
    tab = watched.page
    tab.wait_for_timeout(300)
    assert tab.locator("h1").inner_text() == EVIL
    assert tab.locator("img, main b").count() == 0
    assert EVIL in tab.locator("p.verdict").inner_text()
    assert tab.locator("#figure-misalignment .key button").first.inner_text() == f"A {EVIL}"
    assert watched.console == []
    assert watched.outside == []
    tab.context.close()


BUTTONS = ["Download plot as a PNG", "Zoom", "Pan", "Zoom in", "Zoom out", "Reset axes"]


def test_the_console_is_silent_and_no_control_sends_anything_anywhere(browser, any_path):
    watched = opened(browser, any_path)
    tab, pages = watched.page, []
    tab.context.on("page", lambda page: pages.append(page.url))
    bars = tab.evaluate(
        "[...document.querySelectorAll('.modebar')]"
        ".map(bar => [...bar.querySelectorAll('.modebar-btn')].map(button => button.dataset.title))"
    )
    assert bars
    for bar in bars:
        assert bar == BUTTONS
    assert tab.locator("form, iframe, a[href^=http]").count() == 0
    tab.evaluate(
        """() => {
            for (const details of document.querySelectorAll("details")) details.open = true;
            const click = () => new MouseEvent("click", { bubbles: true });
            for (const control of document.querySelectorAll("button")) control.dispatchEvent(click());
        }"""
    )
    tab.wait_for_timeout(1000)
    assert (watched.console, watched.outside, pages) == ([], [], [])
    assert tab.url == any_path.resolve().as_uri()
    tab.context.close()


def test_the_policy_of_the_page_stops_what_a_script_might_try(page):
    tab = page.page
    blocked = tab.evaluate(
        """async () => {
            const form = document.createElement("form");
            form.action = "https://evil.example/";
            document.body.append(form);
            const said = [];
            document.addEventListener("securitypolicyviolation", event => said.push(event.effectiveDirective));
            form.submit();
            await fetch("https://evil.example/").catch(() => 0);
            await new Promise(resolve => setTimeout(resolve, 200));
            return said.sort();
        }"""
    )
    assert blocked == ["connect-src", "form-action"]
    assert page.outside == []


def test_the_spec_can_be_saved_and_copied(page):
    tab = page.page
    tab.locator("summary", has_text="Spec").click()
    with tab.expect_download() as begun:
        tab.get_by_role("button", name="Download: run.yaml").click()
    assert begun.value.suggested_filename == "run.yaml"
    saved = Path(begun.value.path()).read_text(encoding="utf-8")
    assert load_spec(read_yaml(saved)[0]).integrator.name == "rk4"
    tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
    tab.get_by_role("button", name="Copy: Spec").click()
    until(tab, "[...document.querySelectorAll('.tools button')].some(button => button.textContent === 'Copied')")
    assert tab.evaluate("navigator.clipboard.readText()") == saved


def test_a_table_is_sorted_by_the_button_in_its_heading(page):
    tab = page.page
    table = tab.locator('table[data-file="joints"]')
    head = table.locator("th[scope=col]").nth(2)
    values = "table => [...table.tBodies[0].rows].map(row => Number(row.cells[2].dataset.value))"
    first = table.evaluate(values)
    head.get_by_role("button").focus()
    for order, wanted in (("descending", sorted(first)[::-1]), ("ascending", sorted(first)), (None, first)):
        tab.keyboard.press("Enter")
        assert head.get_attribute("aria-sort") == order
        assert table.evaluate(values) == wanted


def test_a_table_is_saved_as_csv_with_all_digits_and_without_formulas(browser, tmp_path):
    m = mbdkit.Mechanism()
    names = ["=1+1", "+a", "@b", 'plain, "quoted"', "-c"]
    for number, name in enumerate(names):
        m.body(name, mass=1.0 / (3 + number), inertia=1.0)
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.05}) as run:
        path = tmp_path / "page.html"
        path.write_text(run_report(run).html(), encoding="utf-8")
    watched = opened(browser, path)
    watched.page.get_by_text("Bodies", exact=True).first.click()  # inputs are folded
    with watched.page.expect_download() as begun:
        watched.page.get_by_role("button", name="Download CSV: Bodies").click()
    assert begun.value.suggested_filename == "bodies.csv"
    with open(begun.value.path(), encoding="utf-8", newline="") as file:
        heading, *rows = csv.reader(file)
    assert heading[:2] == ["body", "mass [kg]"]
    assert [row[0] for row in rows] == [csv_cell(name) for name in names]
    assert [float(row[1]) for row in rows] == [1.0 / (3 + number) for number in range(len(names))]
    assert watched.outside == []
    watched.page.context.close()


def test_nothing_sticks_out_to_the_side(browser, any_path):
    tab = opened(browser, any_path).page
    for width in (1400, 390):
        tab.set_viewport_size({"width": width, "height": 900})
        tab.wait_for_timeout(300)
        wide, window = tab.evaluate("[document.documentElement.scrollWidth, innerWidth]")
        assert wide <= window == width
    tab.context.close()


def test_no_table_is_cut_off_on_a_telephone_and_every_value_has_its_name(browser, any_path):
    tab = opened(browser, any_path, width=390).page
    tab.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
    wide = "[...document.querySelectorAll('.scroll')].filter(box => box.scrollWidth > box.clientWidth + 1)"
    assert tab.evaluate(f"{wide}.map(box => box.ariaLabel)") == []
    labels = tab.evaluate(
        """() => [...document.querySelectorAll("table.stack")].flatMap(table => {
            const heads = [...table.tHead.rows[0].cells].map(head => head.textContent.trim());
            const shown = cell => getComputedStyle(cell, "::before").content.replaceAll('"', "").trim();
            return [...table.tBodies[0].rows].flatMap(row => [...row.cells].map((cell, k) => [shown(cell), heads[k]]));
        })"""
    )
    assert labels
    assert all(shown == head for shown, head in labels)
    tab.context.close()


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
