"""Newcomers find answers: the table has questions in their words, the page of each, and words of the answer."""

from __future__ import annotations

import csv
import functools
import subprocess
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from mbdkit.guide.pages import pages, search

with Path(__file__).with_name("newcomer_questions.tsv").open(encoding="utf-8") as file:
    QUESTIONS = list(csv.DictReader(file, delimiter="\t"))


#: Asks the worker of the theme, as the page does, and returns the addresses of the first three pages for each question.
ASK = """async questions => {
    const worker = new Worker(JSON.parse(document.getElementById("__config").textContent).search)
    const ask = (type, data) => new Promise(answer => {
        worker.onmessage = event => answer(event.data.data)
        worker.postMessage({type, data})
    })
    const index = await (await fetch("search/search_index.json")).json()
    await ask(0, {...index, options: {suggest: true}})
    const found = []
    for (const question of questions)
        found.push((await ask(2, question)).items.slice(0, 3).map(page => page[0].location))
    return found
}"""


@pytest.mark.parametrize("row", QUESTIONS, ids=lambda row: row["question"])
def test_the_page_answers_the_question_and_is_among_the_first_three(row: dict[str, str]) -> None:
    text = pages()[row["page"]].text.lower()
    assert [word for word in row["answer"].lower().split("; ") if word not in text] == []
    assert row["page"] in list(dict.fromkeys(hit.topic for hit in search(row["question"])))[:3]


@pytest.mark.slow
def test_the_search_of_the_site_finds_nearly_all_pages_among_the_first_three(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    browser = pytest.importorskip("tests.browser")
    command = ["mkdocs", "build", "-q", "-f", Path(__file__).parent.parent / ".mkdocs.yml", "-d", tmp_path]
    subprocess.run([sys.executable, "-m", *command], check=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(SimpleHTTPRequestHandler, directory=tmp_path))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with browser.launched(browser.executable()) as chromium:
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{server.server_port}/index.html")
        found = page.evaluate(ASK, [row["question"] for row in QUESTIONS])
    server.shutdown()
    missed = [row["question"] for row, addresses in zip(QUESTIONS, found, strict=True)
              if not any(f"/{row['page']}.html" in address for address in addresses)]  # fmt: skip
    assert len(missed) <= 3, missed


def test_every_page_answers_a_question() -> None:
    """Reference pages and the history of changes are read by other ways."""
    assert pages().keys() - {row["page"] for row in QUESTIONS} == {"spec", "changes", "elements", "kernels", "device"}
