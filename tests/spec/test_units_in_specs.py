"""Numbers with units in specs: their values are those of the definitions of the units, and wrong units are refused."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import jsonschema
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit.base.units import described_units, read_quantity
from mbdkit.spec.loading import load_spec
from mbdkit.spec.schema import run_schema

SPEC: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"k": "2 N/mm", "half": "25 cm", "rate": "10 Hz"},
    "model": {
        "name": "mechanism",
        "gravity": [0, "-981 cm/s^2"],
        "bodies": {
            "crank": {"mass": "1200 g", "inertia": "833 kg cm^2", "position": ["35 mm", 0], "angle": "30 deg",
                      "angular_velocity": "60 rev/min"},
            "slide": {"mass": 1, "position": [1, 0]},
        },
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], ["-half", 0]]},
            "turn": {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle", "motion": "30 deg"},
            "push": {"type": "driver", "bodies": ["ground", "slide"], "coordinate": "x", "motion": "1 m"},
        },
        "forces": {
            "spring": {"type": "spring-damper", "bodies": ["ground", "crank"], "points": [[0, "1 m"], [0, 0]],
                       "stiffness": "k", "damping": "1 N*s/m"},
            "hinge": {"type": "torsion-spring", "bodies": ["ground", "crank"], "stiffness": "2 N*m/deg"},
            "motor": {"type": "torque", "body": "crank", "value": "300 N mm"},
            "stop": {"type": "law", "law": "one-sided", "acts": "tension", "pathway": {"type": "relative-angle",
                     "bodies": ["ground", "crank"]}, "stiffness": "1 N*m/deg", "free_length": "90 deg"},
            "wire": {"type": "law", "law": "one-sided", "acts": "tension", "pathway": {"type": "two-points",
                     "bodies": ["ground", "crank"], "points": [[1, 0], [0, 0]]}, "stiffness": "1 kN/m",
                     "free_length": "90 mm"},
        },
    },
    "integrator": {"name": "dopri5", "adaptive": True, "atol": "1 um"},
    "time": {"end": "500 ms", "step": "0.1 ms"},
    "limits": {"energy_jump": "5 %", "misalignment": "1 %"},
}  # fmt: skip


def changed(key: str, value: Any) -> dict[str, Any]:
    """Return the spec with another value at a dotted key."""
    spec = copy.deepcopy(SPEC)
    *path, last = key.split(".")
    holder: Any = spec
    for part in path:
        holder = holder[part]
    holder[last] = value
    return spec


def test_values_are_those_of_the_definitions_of_the_units() -> None:
    spec = load_spec(SPEC)
    crank, forces = spec.mechanism().bodies["crank"], spec.mechanism().forces
    assert (crank.mass, crank.inertia, crank.position) == (1.2, 0.0833, (0.035, 0.0))
    assert (crank.angle, crank.angular_velocity) == (math.radians(30), 2 * math.pi)
    assert spec.mechanism().gravity == (0.0, -9.81)
    values = [forces["spring"].stiffness, forces["hinge"].stiffness]
    assert values == pytest.approx([2000, 360 / math.pi], rel=1e-15)
    assert (spec.time.end, spec.time.step, spec.limits.energy_jump) == (0.5, 1e-4, 0.05)
    assert (spec.integrator.atol, spec.limits.misalignment) == (1e-6, 0.01)
    assert spec.parameters == {"k": 2000.0, "half": 0.25, "rate": 10.0}


def test_specs_and_mechanisms_keep_si_values_only() -> None:
    plain = json.loads(load_spec(SPEC).canonical_json())
    assert plain["model"]["bodies"]["crank"]["angle"] == math.radians(30)
    assert plain["model"]["forces"]["spring"]["stiffness"] == "k"
    assert load_spec(plain).run_id() == load_spec(SPEC).run_id()
    made = mbdkit.Mechanism.from_spec(SPEC["model"], SPEC["parameters"]).to_spec()
    assert made["forces"]["motor"]["value"] == 0.3


@pytest.mark.parametrize("text", ["2*k", "k*half/half", "k + 100", "load/half", "k*free", "sqrt(k**2)"])
def test_expressions_of_parameters_with_units_that_fit(text: str) -> None:
    parameters = SPEC["parameters"] | {"load": "3 N", "free": 2}
    spec = load_spec(changed("model.forces.wire.stiffness", text) | {"parameters": parameters})
    assert spec.mechanism().forces["wire"].stiffness > 0


def test_calls_in_python_take_numbers_with_units() -> None:
    m = mbdkit.Mechanism(name="swing")
    m.body("rod", mass="500 g", inertia="0.02 kg m^2", position=("100 mm", 0))
    m.revolute("A", m.ground, "rod", at=(0, "0 cm"))
    assert (m.bodies["rod"].mass, m.bodies["rod"].position) == (0.5, (0.1, 0.0))
    with pytest.raises(SpecError, match=r"bodies\.other\.mass: '2 N' has the unit N, but this is a number in kg"):
        m.body("other", mass="2 N")
    prepared = mbdkit.prepare(m, integrator={"name": "rk4"}, time={"end": "10 ms", "step": "5 ms"})
    with prepared.run(initial={"rod.angle": "30 deg", "rod.angular_velocity": "60 rev/min"}) as run:
        assert run.bodies["rod"].angle[0] == pytest.approx(math.pi / 6, rel=1e-15)
        assert run.bodies["rod"].angular_velocity[0] == pytest.approx(2 * math.pi, rel=1e-14)
    with pytest.raises(SpecError, match=r"\"rod\.angle\": '3 mm' has the unit mm, but this is a number in rad"):
        prepared.run(initial={"rod.angle": "3 mm"})


def test_the_schema_accepts_units_where_specs_do() -> None:
    check = jsonschema.Draft202012Validator(run_schema())
    assert check.is_valid(SPEC)
    assert not check.is_valid(changed("time.end", "500ms"))


def test_every_unit_in_a_description_is_a_unit() -> None:
    assert described_units("Stiffness [N/m or N m/rad].") == ("N/m", "N m/rad")
    assert described_units("Points ``[[x, y], [x, y]]`` [m].") == ("m",)


@pytest.mark.parametrize("text", ["2*k", "2 sin(t)", "2", "2e3", "k", "", "N", "two N", "2 k/3*(1)"])
def test_what_is_no_number_with_a_unit_is_left_to_expressions(text: str) -> None:
    assert read_quantity(text, {"k"}) is None


def test_stiffness_and_dissipation_of_a_contact_have_the_units_of_its_law() -> None:
    # expected: k d^1.5 of Hunt and Crossley, k d of the linear law, and k d^2 of OpenSim's half space are forces
    def compliance(law: str, **numbers: str) -> Any:
        contact = {"bodies": ["ground", "puck"], "shapes": [{"line": {"normal": [0, 1]}}, {"circle": {"radius": 0.1}}]}
        model = {"name": "mechanism", "bodies": {"puck": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 0.2]}}}
        model["contacts"] = {"floor": contact | {"compliance": {"law": law, **numbers}}}
        spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
        return load_spec(spec).mechanism().contacts["floor"].compliance

    assert compliance("hunt-crossley", stiffness="2.0e7 N/m^1.5").stiffness == 2e7
    assert compliance("hunt-crossley", stiffness="1 N/mm^1.5").stiffness == pytest.approx(1000**1.5, rel=1e-15)
    linear = compliance("linear", stiffness="20 N/mm", dissipation="500 N s/m")
    assert (linear.stiffness, linear.dissipation) == (2e4, 500.0)
    assert compliance("smooth-sphere-half-space", stiffness="1 MPa", dissipation="1 s/m").stiffness == 1e6
    for law, numbers, unit in (
        ("hunt-crossley", {"stiffness": "2.0e4 N/mm"}, r"N/m\^1.5"),
        ("linear", {"stiffness": "1 N/mm", "dissipation": "500 s/m"}, "N s/m"),
        ("smooth-sphere-half-space", {"stiffness": "2 N/m"}, r"N/m\^2"),
    ):
        with pytest.raises(SpecError, match=rf"has the unit .*, but this is a number in {unit}$"):
            compliance(law, **numbers)


def _driven(motion: str, load: str = "0", torque: str = "0", **parameters: str) -> None:
    ground = {"bodies": ["ground", "crank"]}
    driver = {"type": "driver", **ground, "coordinate": "angle", "motion": motion}
    twist = {"type": "torque", "body": "crank", "value": torque}
    forces = {"load": {"type": "force", "body": "crank", "value": [0, load]}, "twist": twist}
    model = {
        "name": "mechanism",
        "bodies": {"crank": {"mass": 1.0, "inertia": 0.01}},
        "joints": {"axle": {"type": "revolute", **ground, "at": [0, 0]}, "motor": driver},
        "forces": forces,
    }
    time = {"end": 0.1, "step": 0.01}
    load_spec({"mbdkit": 1, "parameters": parameters, "model": model, "integrator": {"name": "rk4"}, "time": time})


@pytest.mark.parametrize(
    ("motion", "load", "torque", "parameters"),
    [
        ("w*t", "-F", "T*sin(w*t)", {"w": "360 deg/s", "F": "3 kN", "T": "2 N m"}),
        ("2*pi*f*t", "-F*(1 - exp(-t/0.1))", "F*a*cos(2*pi*f*t)", {"f": "6 Hz", "F": "3 N", "a": "5 mm"}),
        ("w*t", "F*exp(-k*t)", "0", {"w": "120 rpm", "F": "3 N", "k": "60 1/min"}),
        ("a*t/0.5", "-m*g*min(t/0.5, 1)", "k*a", {"a": "30 deg", "m": "3 kg", "g": "9.81 m/s^2", "k": "2 N m"}),
        ("w*t", "-F", "F*a", {"w": "6", "F": "3 N", "a": "0.1"}),  # a number without a unit can be any quantity
        ("phi + t", "-F", "F*r", {"r": "90 mm", "d": "0.25", "phi": "max(0.1, atan2(d, r))", "F": "3 N"}),
        ("phi", "-F", "F*r", {"r": "90 mm", "d": "250 mm", "phi": "acos(r/d)", "F": "3 N"}),
    ],
)
def test_functions_of_time_accept_units_that_fit(motion: str, load: str, torque: str, parameters: Any) -> None:
    _driven(motion, load, torque, **parameters)


@pytest.mark.parametrize(
    ("motion", "load", "torque", "parameters", "message"),
    [
        ("w*t", "0", "0", {"w": "6 Hz"}, r"motor\.motion.*is a number of cycles.*2\*pi\*w \* t"),
        ("w*t", "0", "0", {"w": "120 min^-1"}, r"motor\.motion: 'w \* t' is a number of cycles.*2\*pi\*w \* t"),
        ("w*t", "0", "0", {"w": "6 m/s"}, r"motor\.motion: 'w\*t' has the unit m, but this is a number in rad"),
        ("a*sin(3*t)", "0", "0", {"a": "300 mm"}, r"motor\.motion: .* has the unit m"),
        ("0", "-F", "0", {"F": "3 kg"}, r"load\.value\[1\]: '-F' has the unit kg, but this is a number in N"),
        ("0", "F*sin(f*t)", "0", {"F": "3 N", "f": "2 Hz"}, r"load\.value\[1\]: 'f \* t' is a number of cycles"),
        ("0", "0", "b", {"b": "5 mm"}, r"twist\.value: 'b' has the unit mm, but this is a number in N m"),
    ],
)
def test_functions_of_time_refuse_other_units(
    motion: str, load: str, torque: str, parameters: Any, message: str
) -> None:
    with pytest.raises(SpecError, match=message):
        _driven(motion, load, torque, **parameters)
