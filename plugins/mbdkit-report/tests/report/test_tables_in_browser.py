"""Tables of the report in a real headless browser: sorted, saved, and on a telephone."""

from __future__ import annotations

import csv

import mbdkit
from mbdkit.base.text import csv_cell
from mbdkit_report import run_report
from tests.browser import opened


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
