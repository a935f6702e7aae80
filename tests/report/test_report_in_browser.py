"""The report in a real headless browser, by eye, by keyboard, by screen reader, on a telephone."""

from __future__ import annotations

from itertools import pairwise

import pytest
from axe_playwright_python.sync_playwright import Axe

import mbdkit
from mbdkit.plot.caption import caption
from mbdkit.report.player_data import film_data
from mbdkit.report.report import report
from mbdkit.report.run_report import run_report
from mbdkit.report.templating import render
from tests.report.browser import executable, launched, opened, until

EVIL = "</script><script>alert('x')</script><img src=https://evil.example/x.png onerror=alert(1)> & \"q\""

# Contrast and structure that a reader depends on; everything that axe knows of WCAG 2.1 A and AA.
RULES = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]}}


@pytest.fixture(scope="module")
def browser():
    path = executable()
    if path is None:
        pytest.skip("there is no Chromium to open the report in: install chromium, or name one in MBDKIT_TEST_BROWSER")
    with launched(path) as found:
        yield found


@pytest.fixture(scope="module")
def page_path(tmp_path_factory):
    """The report of a double pendulum under a coarse step: its joints come apart by millimetres."""
    folder = tmp_path_factory.mktemp("report")
    archive = folder / "swing.h5"
    mbdkit.run("double-pendulum", integrator={"name": "rk4"}, archive=archive).close()
    return report(archive)


@pytest.fixture(scope="module", params=["run", "study"])
def any_path(request, page_path, study_folder):
    """The report of a run, and that of a study."""
    return (
        page_path if request.param == "run" else report(study_folder, page_path.with_name("study.html"), overwrite=True)
    )


@pytest.fixture
def page(browser, page_path):
    watched = opened(browser, page_path)
    yield watched
    watched.page.context.close()


def position(page):
    return int(page.locator("#scrub").input_value())


def test_the_console_is_silent_and_no_request_leaves_the_page(browser, any_path):
    watched = opened(browser, any_path)
    watched.page.wait_for_timeout(500)
    assert watched.console == []
    assert watched.outside == []
    watched.page.context.close()


def test_the_verdict_stands_on_top(page):
    first = page.page.locator("main h2").first
    assert first.inner_text() == "Verdict"
    assert "The run completed" in page.page.locator("p.verdict").inner_text()


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


def alarmed(page):
    """Count the pixels of the colour in which gaps are drawn."""
    return page.evaluate(
        """() => {
            const canvas = document.getElementById("stage");
            const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
            let count = 0;
            for (let k = 0; k < data.length; k += 4)
                if (Math.hypot(data[k] - 0xb0, data[k + 1], data[k + 2] - 0x20) < 30) count++;
            return count;
        }"""
    )


def test_the_slider_magnifies_the_gaps(page):
    tab = page.page
    tab.get_by_role("button", name="Pause").click()
    tab.locator("#scrub").evaluate("e => { e.value = e.max; e.dispatchEvent(new Event('input')); }")
    slider = tab.get_by_label("Magnify the gaps in the joints")
    assert slider.get_attribute("aria-valuetext") == "not magnified"
    assert alarmed(tab) == 0
    counts = []
    for share in (0.8, 0.9, 1.0):
        slider.evaluate(f"e => {{ e.value = e.max * {share}; e.dispatchEvent(new Event('input')); }}")
        counts.append(alarmed(tab))
    assert 0 < counts[0] < counts[1] < counts[2]
    assert "times" in slider.get_attribute("aria-valuetext")
    # At its end the slider draws the largest gap over an eighth of the picture, whatever it is in metres.
    drawn = tab.evaluate(
        """() => {
            const [film] = JSON.parse(document.getElementById("films").textContent);
            const [left, right, bottom, top] = film.view;
            const factor = 10 ** document.getElementById("magnify").valueAsNumber;
            return factor * film.gaps.largest / Math.max(right - left, top - bottom);
        }"""
    )
    assert drawn == pytest.approx(0.12, rel=0.03)  # the slider has steps of a hundredth of a decade


def test_the_gap_of_a_joint_is_drawn_between_its_bodies_ends(page):
    """Magnified M times, the drawn points of a joint lie M gaps apart, whatever the drawing's own rounding."""
    tab = page.page
    tab.get_by_role("button", name="Pause").click()
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


def test_the_keyboard_reaches_every_control_in_the_order_of_the_page(page):
    tab = page.page
    seen = []
    for _ in range(40):
        tab.keyboard.press("Tab")
        name = tab.evaluate("document.activeElement.id || document.activeElement.dataset.figure || ''")
        if name and name not in seen:
            seen.append(name)
    order = ["scrub", "play", "back", "next", "speed", "whole", "magnify", "trajectory", "misalignment"]
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


def test_the_keyboard_zooms_a_figure_and_shows_all_again(page):
    tab = page.page
    chart = tab.locator('[data-figure="misalignment"]')
    width = "e => e._fullLayout.xaxis.range[1] - e._fullLayout.xaxis.range[0]"
    whole = chart.evaluate(width)
    chart.focus()
    tab.keyboard.press("+")
    assert chart.evaluate(width) == pytest.approx(0.7 * whole)
    tab.keyboard.press("0")
    assert chart.evaluate(width) == pytest.approx(whole)


def test_the_button_of_a_curve_hides_it_and_brings_it_back(page):
    figure = page.page.locator("#figure-misalignment")
    assert figure.locator(".scatterlayer .trace").count() == 2
    button = figure.get_by_role("button", name="J1")
    button.focus()
    page.page.keyboard.press("Enter")
    assert button.get_attribute("aria-pressed") == "false"
    assert figure.locator(".scatterlayer .trace").count() == 1
    page.page.keyboard.press("Enter")
    assert figure.locator(".scatterlayer .trace").count() == 2


def test_the_times_of_events_are_marked_in_figures(browser, tmp_path):
    events = {"low": {"when": "rod1.angle + pi/2"}}
    with mbdkit.run("pendulum", time={"end": 2.0, "step": 0.01}, events=events, archive=tmp_path / "run.h5"):
        pass
    tab = browser.new_page()
    tab.goto(report(tmp_path / "run.h5").as_uri())
    shapes = "chart => chart._fullLayout.shapes.map(shape => shape.x0)"
    assert tab.locator('[data-figure="energy"]').evaluate(shapes) == pytest.approx([0.48333371, 1.45000114], abs=1e-6)
    assert tab.locator('[data-figure="energy"] .annotation-text').all_text_contents() == ["low"]
    tab.close()


def test_the_mouse_zooms_a_figure(page):
    tab = page.page
    chart = tab.locator('[data-figure="misalignment"]')
    chart.scroll_into_view_if_needed()
    box = chart.locator(".nsewdrag").first.bounding_box()
    width = "e => e._fullLayout.xaxis.range[1] - e._fullLayout.xaxis.range[0]"
    whole = chart.evaluate(width)
    tab.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.2 * box["height"])
    tab.mouse.down()
    tab.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.8 * box["height"], steps=5)
    tab.mouse.up()
    tab.wait_for_timeout(200)
    assert chart.evaluate(width) == pytest.approx(0.3 * whole, rel=0.05)


def test_headings_are_in_order_and_everything_that_is_seen_has_a_name(browser, any_path):
    tab = opened(browser, any_path).page
    levels = tab.evaluate("[...document.querySelectorAll('h1,h2,h3,h4')].map(e => Number(e.tagName[1]))")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    unnamed = tab.evaluate(
        """() => [...document.querySelectorAll("canvas, .chart, input, button, select")]
            .filter(e => !(e.ariaLabel || e.labels?.length || e.innerText) && !e.closest(".modebar"))
            .map(e => e.outerHTML.slice(0, 80))"""
    )
    assert unnamed == []
    tab.context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_to_mend(browser, any_path, scheme):
    watched = opened(browser, any_path, color_scheme=scheme)
    watched.page.wait_for_timeout(300)
    found = Axe().run(watched.page, options=RULES)
    assert found.response["violations"] == [], found.generate_report()
    watched.page.context.close()


@pytest.mark.parametrize("width", [390, 1400])
def test_nothing_sticks_out_to_the_side(browser, any_path, width):
    watched = opened(browser, any_path, width=width)
    watched.page.wait_for_timeout(300)
    wide, window = watched.page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide <= window == width
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
