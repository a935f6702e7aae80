"""What notebooks show: every text escaped, nothing loaded, names and numbers those of the object."""

from __future__ import annotations

import base64
import io
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_studies.study import Study

HOSTILE = "<img src=x onerror=alert(1)>"


class Elements(HTMLParser):
    """Tags with their attributes, the text outside of styles, and the names in the drawing."""

    def __init__(self, html: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text, self._style, self.html = "", False, html
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._style = tag == "style"

    def handle_data(self, data: str) -> None:
        self.text += "" if self._style else f" {data}"

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def names(self) -> set[str]:
        (drawing,) = re.findall(r"<svg.*?</svg>", self.html, flags=re.DOTALL)
        return {text.text or "" for text in ElementTree.fromstring(drawing).iter("text")}


def elements(thing: Any) -> Elements:
    """Return the elements of what a notebook shows, after checking that they load and run nothing."""
    found = Elements(thing._repr_html_())
    assert not {"script", "link", "iframe", "object", "embed"} & {tag for tag, _ in found.tags}
    for _, attributes in found.tags:
        assert not [name for name in attributes if name.startswith("on") or name in ("href", "xlink:href")]
        assert (attributes.get("src") or "data:").startswith("data:")
    assert "@import" not in found.html
    assert "url(" not in found.html
    return found


def test_a_run_shows_its_verdict_its_summary_and_three_pictures(knee: mbdkit.Run) -> None:
    found = elements(knee)
    text = " ".join(found.text.split())
    assert f"Verdict {knee.verdict}: " in text
    for line in knee.summary().splitlines():
        if not line.startswith("run "):  # the heading
            assert " ".join(line.split()).removeprefix("verdict ").removeprefix("answer ")[:80] in text
    assert {"acl", "pcl", "shank", "A", "B", "C", "D", "support"} <= found.names
    pictures = [str(one["src"]).removeprefix("data:image/png;base64,") for one in found.of("img")]
    assert [one["alt"].partition(".")[0] for one in found.of("img")] == ["Joint forces", "Misalignment of the joints"]
    for one in pictures:
        with Image.open(io.BytesIO(base64.b64decode(one))) as picture:
            assert len(picture.convert("RGB").getcolors(100_000)) > 4  # several curves


def test_a_mechanism_shows_its_names_masses_and_pose() -> None:
    mechanism = load_spec("slider-crank").mechanism()
    found = elements(mechanism)
    names = {*mechanism.bodies, *mechanism.joints, *mechanism.forces}
    assert names <= found.names
    assert f"mass of {sum(body.mass for body in mechanism.bodies.values()):g} kg" in found.text
    assert len(found.of("details")) == 3


def test_a_mechanism_can_be_shown_while_it_is_built() -> None:
    m = mbdkit.Mechanism()
    assert "no bodies yet" in elements(m).text
    m.body("ball", mass=1.0)
    assert "ball" in elements(m).text


def test_a_study_shows_its_runs(in_tmp_path: Path) -> None:
    study = mbdkit.study(
        {"mbdkit_study": 1, "title": HOSTILE, "base": "pendulum", "axes": [{"time.step": [0.02, 0.01]}]}, out="steps"
    )
    found = elements(study)
    assert HOSTILE in found.text
    assert len(found.of("tr")) == 1 + len(study.points)
    assert "step 0.02 s" in found.text
    assert isinstance(study, Study)
    largest = study.points[0].values["misalignment_max"]
    assert any(one.get("data-value") == repr(largest) for one in found.of("td"))


def test_an_equilibrium_shows_where_the_bodies_rest_and_what_the_joints_carry() -> None:
    # the weight of 3 kg hangs below its pin, which carries it
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=3.0, inertia=0.25, position=(0.5, 0.0))
    m.revolute("pin", m.ground, rod, at=(0.0, 0.0))
    found = mbdkit.equilibrium(m)
    shown = elements(found)
    values = [float(one["data-value"] or "nan") for one in shown.of("td") if one.get("data-value")]
    assert values == pytest.approx([0.0, -0.5, float(found["rod"][2]), 0.0, 3.0 * 9.81, 0.0], abs=1e-9)
    assert "Stable" in shown.text
    assert {"rod", "pin"} <= shown.names


def test_modes_show_their_frequencies_and_shapes() -> None:
    m = mbdkit.Mechanism()
    cart = m.body("cart", mass=4.0, inertia=0.1, position=(1.0, 0.0))
    m.prismatic("guide", m.ground, cart, at=(1, 0), axis=(1, 0))
    m.spring_damper("spring", m.ground, cart, from_=(0, 0), to=(1, 0), stiffness=100.0, free_length=1.0)
    shown = elements(mbdkit.modes(m))
    values = [float(one["data-value"] or "nan") for one in shown.of("td") if one.get("data-value")]
    assert values == pytest.approx([5.0, 5.0 / (2 * np.pi), 0.0])  # sqrt(k / m)
    assert "cart" in shown.text
    assert len(shown.of("img")) == 1


def test_names_and_titles_are_text() -> None:
    m = mbdkit.Mechanism(name=HOSTILE)
    body = m.body("rod & <b>", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin<i>", m.ground, body, at=(0.0, 0.0))
    run = mbdkit.run(m, integrator={"name": "gauss"}, time={"end": 0.1, "step": 0.01}, title=HOSTILE)
    shown = [elements(thing) for thing in (m, run, mbdkit.equilibrium(m), mbdkit.modes(m))]
    assert not {"b", "i"} & {tag for found in shown for tag, _ in found.tags}
    assert all("rod & <b>" in found.text for found in shown)
    assert HOSTILE in shown[1].text


def test_a_run_that_failed_says_why() -> None:
    limits = {"max_steps": 3}
    with mbdkit.run("double-pendulum", time={"end": 2.0, "step": 0.1}, limits=limits) as run:
        found = elements(run)
    assert run.verdict == "bad"
    assert "max-steps" in next(line for line in found.html.splitlines() if '<p class="alarm">' in line)


def test_a_closed_run_is_shown_as_text_with_the_reason() -> None:
    run = mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01})
    run.close()
    assert unescape(run._repr_html_()) == f"<pre>{run!r}: this run is closed</pre>"


def test_an_animation_is_a_frame_without_access_to_the_notebook(knee: mbdkit.Run, tmp_path: Path) -> None:
    film = knee.animate()
    found = Elements(film._repr_html_())
    (style, _), (tag, attributes) = found.tags
    assert (style, tag) == ("style", "iframe")
    assert attributes["sandbox"] == "allow-scripts"
    assert (attributes["srcdoc"] or "").startswith("<!DOCTYPE html>")
    assert "default-src 'none'" in (attributes["srcdoc"] or "")
    film.save(tmp_path / "knee.html")
    assert (tmp_path / "knee.html").read_text("utf-8") == attributes["srcdoc"]  # a short run is shown in full
    with pytest.raises(mbdkit.SpecError, match=r"must end in .gif, .mp4 or .html"):
        film.save(tmp_path / "knee.avi")


def test_joints_accuracy_workload_and_gradient_are_tables() -> None:
    hanging = {"mbdkit": 1, "model": {"name": "single-pendulum", "mass": 2.0, "angle": -np.pi / 2}}
    hanging |= {"integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}, "check": True}
    run = mbdkit.run(hanging)
    joints = elements(run.joints)
    assert "J1" in joints.text
    assert "19.62" in joints.text  # 2 kg at rest
    assert "reaction force" in elements(run.accuracy).text
    assert "1.962" in elements(mbdkit.workload(run)).text  # for 0.1 s
    gradient = mbdkit.gradient(hanging, {"force": "max(abs(joints.J1.force))"}, "model.mass", check=False)
    assert "by model.mass" in elements(gradient).text
    assert "9.81" in elements(gradient).text
