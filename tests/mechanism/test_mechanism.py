"""The builder, the spec form and the cross-checks of a mechanism."""

import math
from typing import Any

import pytest

from mbdkit.base.errors import SpecError
from mbdkit.engine.assembly import assemble
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.joints import Revolute
from mbdkit.mechanism.mechanism import Mechanism

SPRING = {"type": "spring-damper", "bodies": ["ground", "rod"], "points": [[0.0, 1.0], [0.5, 0.0]]}
SPEC = {
    "name": "mechanism",
    "gravity": [0.0, -1.62],
    "bodies": {
        "crank": {"mass": 1.0, "inertia": 0.0833, "position": [0.5, 0.0], "angular_velocity": 2.0},
        "rod": {"mass": 2.0, "inertia": 0.1, "position": [1.5, 0.0], "angle": 0.25, "velocity": [0.0, 1.0]},
        "bob": {"mass": 0.5, "position": [2.0, 0.0]},
    },
    "joints": {
        "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0.0, 0.0], [-0.5, 0.0]]},
        "D": {"type": "distance", "bodies": ["crank", "rod"], "points": [[0.5, 0.0], [-0.5, 0.0]], "length": 0.1},
        "E": {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle", "motion": "0.5*sin(2*pi*t)"},
        "Y": {"type": "driver", "bodies": ["ground", "bob"], "coordinate": "y", "motion": 0.0},
    },
    "forces": {
        "s": SPRING | {"stiffness": 100.0, "damping": 1.0, "free_length": 0.5},
        "t": {"type": "torsion-spring", "bodies": ["crank", "rod"], "stiffness": 5.0, "free_angle": -0.1},
        "m": {"type": "torque", "body": "crank", "value": "0.033", "reaction_body": "rod"},
        "f": {"type": "force", "body": "rod", "point": [0.1, 0.0], "value": [1.0, "2*cos(t)"]},
    },
    "assembly": {"fix": ["crank"], "tolerance": 1e-10},
}


def built() -> Mechanism:
    m = Mechanism(gravity=(0, -1.62))
    crank = m.body("crank", mass=1, inertia=0.0833, position=(0.5, 0), angular_velocity=2)
    rod = m.body("rod", mass=2, inertia=0.1, position=(1.5, 0), angle=0.25, velocity=(0, 1))
    bob = m.body("bob", mass=0.5, position=(2, 0))
    m.revolute("A", m.ground, crank, at=(0, 0))
    m.distance("D", crank, rod, points=[(0.5, 0), (-0.5, 0)], length=0.1)
    m.driver("E", m.ground, crank, coordinate="angle", motion="0.5*sin(2*pi*t)")
    m.driver("Y", m.ground, bob, coordinate="y", motion=0)
    m.spring_damper("s", m.ground, rod, points=[(0, 1), (0.5, 0)], stiffness=100, damping=1, free_length=0.5)
    m.torsion_spring("t", crank, rod, stiffness=5, free_angle=-0.1)
    m.torque("m", crank, value="0.033", reaction_body=rod)
    m.force("f", rod, point=(0.1, 0), value=(1, "2*cos(t)"))
    m.hold(crank, tolerance=1e-10)
    return m


def test_builder_and_spec_give_the_same_mechanism():
    assert built().to_spec() == SPEC
    read = Mechanism.from_spec(SPEC)
    assert read.to_spec() == SPEC
    assert (read.bodies, read.joints, read.forces) == (built().bodies, built().joints, built().forces)
    assert (read.gravity, read.assembly) == (built().gravity, built().assembly)


def test_tables_must_cover_the_run():
    m = Mechanism()
    a = m.body("a", mass=1, inertia=1)
    m.driver("D", m.ground, a, coordinate="angle", motion={"table": [[0, 0.3], [2, 3]]})
    m.force("f", a, value=(0, {"table": [[-1, 1], [2, 3]]}))
    m.check_span(0.0, 0.3)
    m.check_span(0.0, 0.1 + 0.2)  # what three steps of 0.1 s come to
    for start, end in ((-0.1, 0.2), (0.0, 0.31)):
        with pytest.raises(SpecError, match=r"covers 0\.0 s to 0\.3 s, but the run goes from") as caught:
            m.check_span(start, end)
        assert caught.value.key == "model.joints.D.motion.table[0]"
    del m.joints["D"]
    with pytest.raises(SpecError) as caught:
        m.check_span(0.0, 2.0)
    assert caught.value.key == "model.forces.f.value[1].table[0]"


def test_description_counts_elements_rows_and_freedoms():
    assert built().description() == ("3 bodies, 2 joints, 2 drivers, 4 forces; 5 constraint rows")
    m = Mechanism()
    m.revolute("A", m.ground, m.body("a", mass=1, inertia=1), at=(0, 0))
    assert m.description() == "1 body, 1 joint, 0 drivers, 0 forces; 2 constraint rows"


def test_constraint_rows_are_named_by_joint_and_row():
    rows = [("A.x", "m"), ("A.y", "m"), ("D.length", "m"), ("E.angle", "rad"), ("Y.y", "m")]
    assert built().constraint_rows() == rows


PAIR = [[0, 0], [0, 0]]


def test_the_builder_answers_at_once():
    m = Mechanism()
    rod = m.body("rod", mass=1, inertia=1)
    for words, call in (
        (r"already in use", lambda: m.body("rod", mass=1)),
        (r"model\.bodies\.bob\.mass: .*greater than 0", lambda: m.body("bob", mass=0)),
        (r"did you mean 'rod'", lambda: m.revolute("A", m.ground, "rodd", at=(0, 0))),
        (r"use a revolute joint", lambda: m.distance("D", m.ground, rod, from_=(1, 1), to=(1, 1))),
        (r"not both", lambda: m.force("f", rod, value=(1, 0), at=(0, 0), point=(0, 0))),
        (r"model\.name: .*'mechanism'", lambda: Mechanism.from_spec({**SPEC, "name": "double-pendulum"})),
        (r"model\.gravity", lambda: Mechanism(gravity=(0, math.inf))),
        (r"joints\.A\.bodies\[0\]: should be text, not 0", lambda: m.revolute("A", 0, rod, at=(0, 0))),
        (r"joints\.A\.at\[1\]: should be a number", lambda: m.revolute("A", m.ground, rod, at=(0, "1"))),
        (r"joints\.A\.att: unknown key \(did you mean 'at'", lambda: m.revolute("A", m.ground, rod, att=(0, 0))),
        (r"no elements called 'joint' \(did you mean 'joints'", lambda: m.add("joint", "A", type="weld")),
        (r"not a quantity of a joint", lambda: m.coordinate("q", "rood.angle")),
        (r"s\.to: .* two numbers", lambda: m.spring_damper("s", "ground", rod, from_=(0, 0), to=1, stiffness=1)),
    ):
        with pytest.raises(SpecError, match=words):
            call()
    with pytest.raises(TypeError, match=r"revolute\(\) missing 1 required positional argument: 'b'"):
        m.revolute("A", m.ground)
    assert not m.joints | m.forces | m.coordinates


def test_a_key_that_is_no_text_is_refused():
    with pytest.raises(SpecError):
        Mechanism.from_spec({"bodies": {"a": {"mass": 1}}, 1: 2})


def test_validate_finds_what_was_put_in_by_hand():
    m = Mechanism()
    with pytest.raises(SpecError, match="at least one body"):
        m.validate()
    m.bodies["a"] = Body(mass=1)
    m.joints["J"] = Revolute(bodies=("ground", "a"), points=((0, 0), (0.1, 0)))
    with pytest.raises(SpecError, match="point mass"):
        m.validate()


# ---- points in the global frame ------------------------------------------------------------------------------------

TURNED = {"mass": 1.0, "inertia": 0.1, "position": [1.0, 2.0], "angle": 0.7}
GLOBALLY: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "revolute": ("joints", {"type": "revolute"}, {"at": [0.3, -0.4]}),
    "prismatic": ("joints", {"type": "prismatic", "axis": [1.0, 2.0]}, {"at": [0.3, -0.4]}),
    "point-on-line": ("joints", {"type": "point-on-line", "axis": [1.0, 2.0]}, {"at": [0.3, -0.4]}),
    "weld": ("joints", {"type": "weld"}, {"at": [0.3, -0.4]}),
    "distance": ("joints", {"type": "distance"}, {"from": [0.3, -0.4], "to": [0.6, 0.0]}),
    "spring-damper": ("forces", {"type": "spring-damper", "stiffness": 2.0}, {"from": [0.3, -0.4], "to": [0.6, 0.0]}),
}
CALLS = {
    "revolute": Mechanism.revolute,
    "prismatic": Mechanism.prismatic,
    "point-on-line": Mechanism.point_on_line,
    "weld": Mechanism.weld,
    "distance": Mechanism.distance,
    "spring-damper": Mechanism.spring_damper,
}


def with_element(kind: str, element: dict[str, Any], **rod: Any) -> dict[str, Any]:
    bodies = {"rod": {**TURNED, **rod}, "bob": {"mass": 1.0, "position": [0.1 + 0.2, 0.5]}}
    return {"name": "mechanism", "bodies": bodies, kind: {"E": {"bodies": ["bob", "rod"], **element}}}


@pytest.mark.parametrize("case", GLOBALLY)
def test_an_element_placed_in_the_global_frame_is_that_of_the_builder(case: str) -> None:
    kind, element, places = GLOBALLY[case]
    first = "at" if "at" in places else "from"
    m = Mechanism.from_spec(with_element(kind, {**element, **places, "bodies": ["ground", "rod"]}))
    built = Mechanism()
    rod = built.body("rod", **TURNED)
    options = {key: value for key, value in element.items() if key != "type"}
    options |= {"from_" if key == "from" else key: place for key, place in places.items()}
    CALLS[case](built, "E", built.ground, rod, **options)
    one = getattr(m, kind)["E"]
    assert one == getattr(built, kind)["E"]
    # by hand: R(-0.7) (p - r)
    x, y = places["at" if first == "at" else "to"]
    c, s = math.cos(0.7), math.sin(0.7)
    assert one.points == (tuple(places[first]), pytest.approx((c * (x - 1) + s * (y - 2), -s * (x - 1) + c * (y - 2))))
    if case == "distance":
        assert one.length == pytest.approx(0.5)
    assert Mechanism.from_spec(m.to_spec()).to_spec() == m.to_spec()
    assert "points" in m.to_spec()[kind]["E"]
    assert first not in m.to_spec()[kind]["E"]


def test_a_pathway_and_a_force_are_placed_in_the_global_frame() -> None:
    pathway = {"type": "two-points", "bodies": ["ground", "rod"], "from": [0.3, -0.4], "to": [1.0, 2.0]}
    spec = with_element("forces", {"type": "force", "body": "rod", "at": [1.0, 2.0], "value": [1, 0]})
    del spec["forces"]["E"]["bodies"]
    spec["forces"]["L"] = {"type": "law", "law": "linear", "pathway": pathway, "stiffness": 1.0}
    m = Mechanism.from_spec(spec)
    assert m.forces["E"].point == (0, 0)
    assert m.forces["L"].pathway.points == ((0.3, -0.4), (0, 0))


WRONGLY: dict[str, tuple[dict[str, Any], str, str]] = {
    "neither": ({"type": "revolute"}, "points", "or give `at` in the global frame"),
    "both": ({"type": "weld", "at": [0, 0], "points": [[0, 0], [0, 0]]}, "at", "or as `at` (in the global frame), not"),
    "from alone": ({"type": "distance", "from": [0, 0]}, "to", "`from` and `to` go together"),
    "to alone": ({"type": "distance", "to": [0, 0], "length": 1}, "from", "`from` and `to` go together"),
    "all three": ({"type": "distance", "from": [0, 0], "to": [1, 0], "points": PAIR}, "from", "either as `points`"),
    "no length": ({"type": "distance", "points": [[0, 0], [0, 0]]}, "length", "only with `from` and `to`"),
    "one place": ({"type": "distance", "from": [0.3, 0.5], "to": [0.3, 0.5]}, "to", "use a revolute joint"),
    "point mass": ({"type": "revolute", "at": [0.31, 0.5]}, "at", "its only point is its position [0.3, 0.5]"),
    "slot in a mass": ({"type": "point-on-line", "at": [0.3, 0.5], "axis": [1, 0]}, "bodies[0]", "for a point-on-line"),
}


@pytest.mark.parametrize("case", WRONGLY)
def test_a_wrong_place_in_the_global_frame_is_answered_with_its_key(case: str) -> None:
    element, key, message = WRONGLY[case]
    with pytest.raises(SpecError) as caught:
        Mechanism.from_spec(with_element("joints", element))
    assert caught.value.key == f"model.joints.E.{key}"
    assert message in caught.value.message


def test_a_point_mass_is_held_at_its_place_whatever_its_rounding() -> None:
    m = Mechanism.from_spec(with_element("joints", {"type": "revolute", "at": [0.3, 0.5]}))
    assert m.joints["E"].points[0] == (0.0, 0.0)


def test_a_place_is_in_the_position_as_given_before_assembly() -> None:
    spec = with_element("joints", {"type": "revolute", "bodies": ["ground", "rod"], "at": [1.5, 2.0]}, angle=0.0)
    spec["joints"]["D"] = {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angle", "motion": 0.2}
    m = Mechanism.from_spec(spec)
    assert m.joints["E"].points == ((1.5, 2.0), (0.5, 0.0))
    x, y, angle = assemble(m).q[0]
    assert (x + 0.5 * math.cos(angle), y + 0.5 * math.sin(angle)) == pytest.approx((1.5, 2.0))


@pytest.mark.parametrize(
    ("query", "key"),
    [
        (lambda m: m.to_local("arn", (0.0, 0.0)), "body"),
        (lambda m: m.to_global("arn", (0.0, 0.0)), "body"),
        (lambda m: m.relative_angle("arm", "arn"), "b"),
    ],
)
def test_queries_refuse_an_unknown_body(query: Any, key: str) -> None:
    m = Mechanism()
    m.body("arm", mass=1.0, inertia=0.1)
    with pytest.raises(SpecError, match=rf"^{key}: there is no body 'arn' \(did you mean 'arm'\?\)"):
        query(m)
