"""Elements of a plugin that act on a body by laws of their own, with a section in run specs, and an attribute that a
plugin adds to mechanisms.
"""

from __future__ import annotations

import json
import math

import pytest

from tests.installing import install_module, python

pytestmark = pytest.mark.end_to_end

PLUGIN = """
from typing import Annotated
import sympy
from mbdkit.plugin import (
    Accessor, Element, ElementForces, ElementKind, StrictModel, Target, Treatment, TreatmentName, hookimpl,
)
from mbdkit import ExpressionLaw

SIZE = sympy.Symbol("size", real=True)
PULSES = ExpressionLaw(SIZE * sympy.cos(sympy.Symbol("time", real=True)), parameters=dict)
STEADY = ExpressionLaw(SIZE, parameters=dict)

class JetSection(StrictModel):
    treatment: Annotated[str, TreatmentName("jets", "pulses")] = "pulses"
    scale: float = 1.0

class Jet(Element):
    body: str
    sizes: list[float]

    def places(self):
        return [("body", self.body)]

def lower(jets, lowering, acting):
    [chosen] = lowering.mechanism.treatments
    law, scale = {"pulses": PULSES, "steady": STEADY}[chosen.item.name], chosen.section.scale
    for name, jet in jets.items():
        laws = [lowering.law(name, law, {"size": scale * size}, "jets") for size in jet.sizes]
        lowering.wrench(name, lowering.number(jet.body), laws)
    return tuple(jets)

def thrust_of(mechanism):
    return sum(jet.sizes[0] for jet in mechanism.jets.values())

@hookimpl
def mbdkit_items():
    return [
        ElementKind(name="jet", summary="Jets by name.", key_in_model="jets", builder="jet",
                    model=Target("jet_kit:Jet"), acts=ElementForces(lower=Target("jet_kit:lower")), section="jetting",
                    section_model=Target("jet_kit:JetSection")),
        *(Treatment(name=name, summary="Forces by time.", of="jets") for name in ("pulses", "steady")),
        Accessor(name="thrust", summary="Sum of thrusts.", of="Mechanism", target=Target("jet_kit:thrust_of")),
    ]
"""
PROGRAM = """
import json, mbdkit
m = mbdkit.Mechanism(gravity=(0.0, 0.0))
m.body("ship", mass=2.0, inertia=0.5)
m.jet("main", body="ship", sizes=[3.0, -1.0, 0.25])
assert "thrust" in dir(m)
found = {"thrust": m.thrust}
for name in ("dop853", "gauss"):
    with mbdkit.run(m, integrator={"name": name}, time={"end": 2.0, "step": 0.01}) as run:
        ship = run.bodies["ship"]
        speeds = [*ship.velocity[-1].tolist(), float(ship.angular_velocity[-1])]
        found[name] = [*speeds, float(run.energy.work[-1])]
        assert "jetting" not in run.spec
times = {"integrator": {"name": "gauss"}, "time": {"end": 2.0, "step": 0.01}}
with mbdkit.run(m, jetting={"treatment": "steady", "scale": 2}, **times) as run:
    found["steady"] = run.bodies["ship"].velocity[-1].tolist()
    assert run.spec["jetting"] == {"scale": 2.0, "treatment": "steady"}
try:
    mbdkit.run(m, jetting={"treatment": "steadi"}, **times)
except mbdkit.SpecError as error:
    found["wrong"] = str(error)
print(json.dumps(found))
"""


def test_elements_act_by_laws_of_their_own_and_mechanisms_have_attributes_of_plugins(tmp_path) -> None:
    # expected: integrals of F cos(t) / m and of its power; the law of the torque is the third one; twice F t / m if the
    # section of the run chooses so
    install_module(tmp_path / "site", "jet-kit", PLUGIN)
    done = python("-c", PROGRAM, path=(tmp_path / "site",), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    sine = 0.9092974268256817  # sin(2)
    speeds = [3.0 / 2.0 * sine, -1.0 / 2.0 * sine, 0.25 / 0.5 * sine]
    work = 0.5 * (2.0 * (speeds[0] ** 2 + speeds[1] ** 2) + 0.5 * speeds[2] ** 2)
    assert found["thrust"] == 3.0
    assert found["steady"] == pytest.approx([2.0 * 3.0 * 2.0 / 2.0, -2.0 * 2.0 / 2.0], rel=1e-12)
    assert (
        found["wrong"]
        == "jetting.treatment: should be 'pulses' or 'steady', not the text 'steadi' (did you mean 'steady'?)"
    )
    for name in ("dop853", "gauss"):
        assert found[name] == pytest.approx([*speeds, work], rel=1e-9)


LINKS = """
from typing import ClassVar
import sympy
from mbdkit import ExpressionLaw
from mbdkit.plugin import ElementForces, ElementKind, LineForce, Number, Positive, Target, hookimpl

LENGTH, STIFFNESS = sympy.symbols("length stiffness", real=True)

class Strand(LineForce):
    stiffness: Positive
    force_law: ClassVar[ExpressionLaw] = ExpressionLaw(
        STIFFNESS * LENGTH, parameters=lambda strand: {"stiffness": strand.stiffness})

class Link(LineForce):
    stiffnesses: tuple[float, float]
    turns: Number = 1.0

def forces(links):
    return {f"{name}.{k}": force(link, k) for name, link in links.items() for k in (0, 1)}

def force(link, k):
    if link.turns == 2.0:
        return link
    ends = {"from": (0.0, 1.0), "to": (0.0, 0.0)} if link.turns == 3.0 else {"points": link.ends}
    return Strand(bodies=link.bodies, stiffness=link.stiffnesses[k], **ends)

@hookimpl
def mbdkit_items():
    return [ElementKind(name="link", summary="Links by name.", key_in_model="links", builder="link",
                        model=Target("link_kit:Link"), acts=ElementForces(forces=Target("link_kit:forces")))]
"""
LINKED = """
mbdkit: 1
model:
  name: mechanism
  gravity: [0, 0]
  bodies: {b: {mass: 2.0, position: [1.0, 0.0]}}
  links: {l: {bodies: [ground, b], from: [0, 0], to: [1, 0], stiffnesses: [3.0, 5.0]}}
integrator: {name: gauss, stages: 3}
time: {end: 1.0, step: 0.01}
"""
FAILS = {
    "stiffnesses: [3.0, -5.0]": (4, "the element kind 'link-kit:link' failed: ValidationError"),
    "stiffnesses: [3.0, 5.0], turns: 2": (4, "element 'l.0' of the kind of elements 'link' has no `force_law`, which"),
    "stiffnesses: [3.0, 5.0], turns: 3": (4, "element 'l.0' of the kind of elements 'link' has no `points`, the"),
    "stiffnesses: [3.0]": (2, "model.links.l.stiffnesses[1]: is missing"),
    "stiffnesses: 3.0": (2, "model.links.l.stiffnesses: should be a list, not 3.0"),
}


def test_elements_may_act_by_forces_of_another_class_whose_errors_name_the_plugin(tmp_path) -> None:
    # expected: a mass of 2 kg on springs of 3 and 5 N/m without a free length, x = cos(2 t)
    site = tmp_path / "site"
    install_module(site, "link-kit", LINKS)
    program = """
import mbdkit
m = mbdkit.Mechanism(gravity=(0.0, 0.0))
m.body("b", mass=2.0, position=(1.0, 0.0))
m.link("l", bodies=("ground", "b"), from_=(0.0, 0.0), to=(1.0, 0.0), stiffnesses=[3.0, 5.0])
m.link("idle", bodies=("ground", "b"), from_=(0.0, 0.0), to=(1.0, 0.0), stiffnesses=(1e-300, 1e-300))
for model in (m, "linked.yaml"):
    times = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 1.0, "step": 0.01}}
    with mbdkit.run(model, **times if model is m else {}) as run:
        print(repr(float(run["b"].position[-1, 0])))
"""
    (tmp_path / "linked.yaml").write_text(LINKED, encoding="utf-8")
    done = python("-c", program, path=(site,), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [float(line) for line in done.stdout.split()] == pytest.approx([math.cos(2.0)] * 2, rel=1e-9)
    for values, (status, sentence) in FAILS.items():
        (tmp_path / "wrong.yaml").write_text(LINKED.replace("stiffnesses: [3.0, 5.0]", values), encoding="utf-8")
        done = python("-m", "mbdkit", "run", "wrong.yaml", "-o", "wrong.h5", path=(site,), cwd=tmp_path)
        assert (done.returncode, "bug" in done.stderr) == (status, False), done.stderr
        assert sentence in done.stderr
        assert not (tmp_path / "wrong.h5").exists()
    without = LINKS.replace(', acts=ElementForces(forces=Target("link_kit:forces"))', "")
    install_module(tmp_path / "other", "link-kit", without)
    done = python("-m", "mbdkit", "run", "linked.yaml", path=(tmp_path / "other",), cwd=tmp_path)
    assert "give the kind `acts=ElementForces(...)` with `forces` or `lower`" in done.stderr
    assert python("-m", "mbdkit", "run", "linked.yaml", path=(site,), cwd=tmp_path).returncode == 0
    done = python("-m", "mbdkit", "rerun", "linked.h5", path=(), cwd=tmp_path)
    assert "the element kind 'link-kit:link' is not installed here" in done.stderr
