"""Sliders in the browser: answers, the server and its guards, and the page in a headless Chromium."""

from __future__ import annotations

import gc
import http.client
import json
import logging
import math
import re
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_explore.explorer import explorer_of
from mbdkit_explore.server import LARGEST, Exploration
from tests.browser import executable, launched, until

httpx = pytest.importorskip("httpx")
pytest.importorskip("uvicorn")

HANGING = {
    "mbdkit": 1, "model": {"name": "single-pendulum", "mass": 2.0, "angle": -math.pi / 2},
    "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01},
}  # fmt: skip
BROWSER = executable()
MOVE = """value => new Promise(done => {
    const slider = document.querySelector("input[data-key='model.body_mass']"), began = performance.now();
    new MutationObserver((_, observer) => {  // the numbers are shown before the motion and the curves are drawn
        observer.disconnect();
        requestAnimationFrame(() => setTimeout(() => done(performance.now() - began)));
    }).observe(document.getElementById("headlines"), { childList: true });
    slider.value = value;
    slider.dispatchEvent(new Event("input"));
})"""


def test_the_force_follows_the_mass_and_the_spec_keeps_it() -> None:
    explorer = explorer_of(HANGING, ["model.mass"])
    (mass,) = explorer.sliders
    assert (mass.low, mass.high, mass.words, mass.unit) == (1.0, 4.0, "mass", "kg")
    at_rest, force = ("largest force in J1", "19.62 N"), "max(abs(joints.J1.force))"
    assert explorer.answer({})["headlines"] == [[*at_rest, force]]  # 2 kg at rest
    heavier = explorer.answer({"model.mass": 3.0})
    assert heavier["headlines"] == [["largest force in J1", "29.43 N", force]]
    assert "mass: 3.0" in heavier["spec"]
    assert explorer.answer({"model.length": 9.0, "time.end": 99.0})["headlines"] == [[*at_rest, force]]
    assert "should be greater than 0" in explorer.answer({"model.mass": -1.0})["error"]


def test_every_measure_is_shown() -> None:
    measures = {f"after_{k}": f"at(rod1.x, {k}/100)" for k in range(1, 8)}
    shown = explorer_of({**HANGING, "measures": measures}, ["model.mass"]).answer({})["headlines"]
    assert [name for name, *_ in shown] == list(measures)


def test_sliders_are_the_parameters_of_the_spec_or_numbers_of_its_model() -> None:
    named = {**HANGING, "parameters": {"m": 2.0, "twice": "2*m"}, "model": {**HANGING["model"], "mass": "m"}}
    assert [one.key for one in explorer_of(named).sliders] == ["parameters.m"]
    assert explorer_of(named).answer({"parameters.m": 4.0})["headlines"][0][1] == "39.24 N"
    keys = {one.key: one for one in explorer_of("knee").sliders}
    assert {"model.body_mass", "model.springs.support.stiffness", "model.flexion"} <= keys.keys()
    assert keys["model.flexion"].high - keys["model.flexion"].low == pytest.approx(math.radians(60))
    with pytest.raises(SpecError, match=r"no number 'model.mas' \(did you mean 'mass'\?\)"):
        explorer_of(HANGING, ["model.mas"])


def test_a_device_changes_the_loads_of_inverse_dynamics() -> None:
    explorer = explorer_of(load_inverse_spec("walking", ["motion.errors=none"]), ["model.body_mass"])
    (mass,) = explorer.sliders
    (name, usual, _), *_ = explorer.answer({})["headlines"]
    (same, heavier, _), *_ = explorer.answer({mass.key: 1.2 * mass.value})["headlines"]
    assert name == same == "hip_force"
    assert heavier != usual


def test_an_answer_leaves_no_run_for_the_garbage_collector() -> None:
    explorer = explorer_of("knee", ["model.body_mass"])
    gc.collect()
    gc.disable()
    try:
        others = {id(item) for item in gc.get_objects() if isinstance(item, Run)}  # of other tests
        explorer.answer({"model.body_mass": 70.0})
        assert not [item for item in gc.get_objects() if isinstance(item, Run) and id(item) not in others]
    finally:
        gc.enable()


@pytest.fixture(scope="module")
def knee() -> Iterator[Exploration]:
    with mbdkit.explore("knee", ["model.body_mass", "model.springs.support.stiffness"]) as exploration:
        assert httpx.get(exploration.url, timeout=30).status_code == 200  # the server listens at once
        yield exploration


def test_only_this_machine_with_the_token_is_served(knee: Exploration) -> None:
    base, _, token = knee.url.partition("/?token=")
    assert base.startswith("http://127.0.0.1:")
    assert httpx.get(base).status_code == 403
    assert httpx.get(f"{base}/?token={token[:-1]}").status_code == 403
    assert httpx.post(f"{base}/answer", json={}).status_code == 403
    assert httpx.get(knee.url, headers={"host": "evil.example"}).status_code == 400
    page = httpx.get(knee.url)
    assert "http" not in page.text.replace("http-equiv", "").replace("http://www.w3.org", "")
    assert httpx.post(f"{base}/answer", headers={"x-token": token}, json=[1]).status_code == 400
    assert knee.url.replace("&", "&amp;") in knee._repr_html_()


def test_policies_of_content_and_frames_are_part_of_every_response(knee: Exploration) -> None:
    for url in (knee.url, knee.url.partition("?")[0]):
        headers = httpx.get(url).headers
        policy = dict(part.split(" ", 1) for part in headers["content-security-policy"].split("; "))
        assert policy["default-src"] == "'none'"
        assert policy["connect-src"] == "'self'"
        frames = policy["frame-ancestors"].split()  # notebooks on this machine
        assert {source.partition(":")[2].removesuffix(":*") for source in frames} == {"//127.0.0.1", "//localhost", ""}
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "body",
    [b"", b"{x", b"[" * 20_000, b'{"a": NaN}', b'{"a": 1e999}', b'{"a": ' + b"9" * 5000 + b"}", b'{"a": true}',
     b'{"\xe9": 1}', b'{"a": "1"}', b"{}" + b" " * LARGEST],
    ids=["empty", "not JSON", "nested", "nan", "infinite", "digits", "boolean", "Latin-1", "text", "large"],
)  # fmt: skip
def test_a_body_that_is_not_an_object_of_numbers_is_refused(
    knee: Exploration, body: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    base, _, token = knee.url.partition("/?token=")
    with caplog.at_level(logging.ERROR):
        reply = httpx.post(f"{base}/answer", headers={"x-token": token}, content=body)
    assert (reply.status_code, caplog.records) == (400, [])
    assert reply.text.startswith("The body should be a JSON object of numbers")


class _Slow:
    """An explorer that counts its answers; each takes 0.2 s, and that for `hangs` takes 10 s."""

    title, sliders = "slow", ()

    def __init__(self) -> None:
        self.count = 0

    def answer(self, values: Mapping[str, float]) -> dict[str, Any]:
        self.count += 1
        time.sleep(10.0 if "hangs" in values else 0.2)
        return dict(values)


def _left(url: str, body: bytes, length: int) -> None:
    """Send a request, and close the connection without waiting for the answer."""
    base, _, token = url.partition("/?token=")
    head = f"POST /answer HTTP/1.1\r\nHost: 127.0.0.1\r\nx-token: {token}\r\nContent-Length: {length}\r\n\r\n"
    with socket.create_connection(("127.0.0.1", int(base.rpartition(":")[2]))) as connection:
        connection.sendall(head.encode() + body)


def test_moves_whose_connection_was_closed_are_not_computed(caplog: pytest.LogCaptureFixture) -> None:
    slow: Any = _Slow()
    with caplog.at_level(logging.ERROR), Exploration(slow) as exploration:
        base, _, token = exploration.url.partition("/?token=")
        for _ in range(20):
            _left(exploration.url, b'{"a": 1}', 8)
        _left(exploration.url, b'{"a"', 100)  # in the middle of the body
        for value in (1.0, 2.0):
            reply = httpx.post(f"{base}/answer", headers={"x-token": token}, json={"a": value})
            assert reply.json() == {"a": value}
    assert slow.count <= 3  # the first of the abandoned moves may have been in progress
    assert not caplog.records


def test_closing_does_not_wait_for_the_answer_in_progress(caplog: pytest.LogCaptureFixture) -> None:
    slow: Any = _Slow()
    with caplog.at_level(logging.ERROR):
        exploration = Exploration(slow)
        base, _, token = exploration.url.partition("/?token=")
        headers = {"x-token": token}
        with ThreadPoolExecutor(2) as pool:
            replies = [pool.submit(httpx.post, f"{base}/answer", headers=headers, json={"hangs": k}) for k in (1, 2)]
            while not slow.count:
                time.sleep(0.01)
            began = time.monotonic()
            exploration.close()
            assert time.monotonic() - began < 3.0
            assert {reply.exception() is not None or reply.result().status_code for reply in replies} <= {True, 503}
    assert not caplog.records


@pytest.mark.end_to_end
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_the_memory_of_the_command_does_not_grow_with_moves_from_two_pages() -> None:
    command = [sys.executable, "-m", "mbdkit", "explore", "knee", "--no-browser", "--parameters", "model.body_mass"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        port, token = process.stdout.readline().strip().rpartition(":")[2].split("/?token=")

        def move(count: int) -> None:
            connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=60)
            for k in range(count):
                body = json.dumps({"model.body_mass": 70.0 + 0.01 * k})
                connection.request("POST", "/answer", body, {"x-token": token})
                assert "film" in json.loads(connection.getresponse().read())
            connection.close()

        def memory() -> float:
            text = Path(f"/proc/{process.pid}/status").read_text()
            return int(re.search(r"VmRSS:\s+(\d+)", text)[1]) / 1024  # type: ignore[index]

        move(20)
        before = memory()
        pages = [threading.Thread(target=move, args=(200,)) for _ in range(2)]
        for page in pages:
            page.start()
        for page in pages:
            page.join()
        growth = memory() - before
        process.send_signal(signal.SIGINT)
        assert process.wait(5) == 130
    assert growth < 12.0  # MiB; the results of 400 moves would take more


@pytest.mark.end_to_end
@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium")
def test_motion_and_forces_follow_a_slider_in_two_browsers(knee: Exploration) -> None:
    from axe_playwright_python.sync_playwright import Axe

    assert BROWSER is not None
    with launched(BROWSER) as browser:
        pages, posted = [], []
        for width in (1400, 390):
            page = browser.new_page(viewport={"width": width, "height": 900}, reduced_motion="reduce")
            asked: list[str] = []
            page.on("request", lambda request, asked=asked: asked.append(request.url))
            page.goto(knee.url)
            until(page, "document.querySelectorAll('#headlines dd').length > 0")
            pages.append((page, asked))
        page, asked = pages[0]
        page.on("request", lambda request: posted.append(request.post_data_json) if request.post_data else None)
        before, drawn = page.inner_text("#headlines"), page.evaluate("document.getElementById('stage').toDataURL()")
        took = []
        for value in (800, 200, 900):
            shown = page.inner_text("#headlines dd")
            took.append(page.evaluate(MOVE, value))
            assert page.inner_text("#headlines dd") != shown
        assert page.inner_text("#headlines") != before
        assert page.evaluate("document.getElementById('stage').toDataURL()") != drawn
        assert page.get_by_label("body mass [kg]", exact=True).get_attribute("data-key") == "model.body_mass"
        number = page.get_by_label("body mass, as a number")
        assert float(number.input_value()) == posted[-1]["model.body_mass"]  # all digits
        shown = page.inner_text("#headlines dd")
        number.fill("300.25")  # beyond the end of the slider
        number.press("Enter")
        until(page, f"document.querySelector('#headlines dd').innerText !== {shown!r}")
        assert posted[-1]["model.body_mass"] == 300.25
        assert page.get_by_label("body mass [kg]", exact=True).input_value() == "1000"
        assert "body_mass: 300.25\n" in page.evaluate("document.getElementById('spec').textContent")
        assert pages[1][0].inner_text("#headlines") == before  # the other window has sliders of its own
        assert all(url.startswith((knee.url.partition("?")[0], "data:")) for _, urls in pages for url in urls)
        page.route("**/answer", lambda route: route.fulfill(json={"error": "the mass is negative", "spec": "no spec"}))
        page.evaluate("document.querySelector('input[type=range]').dispatchEvent(new Event('input'))")
        until(page, "document.body.classList.contains('stale')")
        assert page.inner_text("#verdict").startswith("the mass is negative. The faded results")
        assert page.is_disabled("#save")
        page.unroute("**/answer")
        page.click("#reset")
        until(page, "!document.body.classList.contains('stale')")
        assert not page.is_disabled("#save")
        page.evaluate("document.body.style.paddingRight = '60px'")  # as a scrollbar that appears
        for name in ("stage", "ghost"):
            canvas = f"document.getElementById('{name}')"
            until(page, f"{canvas}.width === Math.round({canvas}.clientWidth * devicePixelRatio)")
        for page, _ in pages:
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
        assert statistics.median(took) < 1000.0  # 40 to 80 ms; machines that run tests are busy


@pytest.mark.parametrize("port", [70_000, -1, 10**30, "80"])
def test_a_port_that_does_not_exist_is_refused_in_one_sentence(port: Any) -> None:
    with pytest.raises(mbdkit.MbdkitError, match=f"port '?{port}'? of this machine cannot be used"):
        mbdkit.explore("double-pendulum", port=port)


def test_torques_of_drivers_are_plotted() -> None:
    charts: Any = explorer_of("slider-crank", ["model.bodies.rod.mass"]).answer({})["charts"]
    torques = next(chart for chart in charts if chart["name"] == "torques")
    assert [line["label"] for line in torques["lines"]] == ["motor"]
    assert torques["y"]["title"] == "torque [N m]"


def test_sliders_end_where_the_spec_is_valid() -> None:
    # expected: two rods between pins at a distance of 2 m, one of them 1 m long: the other is at least 1 m long
    keys = {one.key: one for one in explorer_of("slider-crank").sliders}
    assert "model.bodies.crank.angular_velocity" not in keys  # given by the motor, so that no other value is valid
    reaching = {
        "mbdkit": 1,
        "parameters": {"a": 1.5},
        "model": {
            "name": "mechanism",
            "bodies": {
                "one": {"mass": 1.0, "inertia": 0.1, "angle": 0.5054},
                "two": {"mass": 1.0, "inertia": 0.1, "position": [2, 0], "angle": -0.8128},
            },
            "joints": {
                "A": {"type": "revolute", "bodies": ["ground", "one"], "points": [[0, 0], [0, 0]]},
                "B": {"type": "revolute", "bodies": ["one", "two"], "points": [["a", 0], [-1, 0]]},
                "C": {"type": "revolute", "bodies": ["ground", "two"], "points": [[2, 0], [0, 0]]},
            },
        },
        "integrator": {"name": "rk4"},
        "time": {"end": 0.01, "step": 0.01},
    }
    (slider,) = explorer_of(reaching).sliders
    assert slider.low == pytest.approx(1.0, abs=0.75 / 2**6)
    assert slider.low >= 1.0
