"""Muscles in OpenSim files: lengths agree with those of OpenSim 4.6, and ignored components are named."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import osim_texts as osim
import pytest

import mbdkit
from mbdkit import Mechanism
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.muscles.muscle_path import MusclePath
from mbdkit_opensim.building import build_mechanism


def frame(body: str) -> str:
    return f"<socket_parent_frame>{osim.path_of(body)}</socket_parent_frame>"


def point(name: str, body: str, place: tuple[float, float, float]) -> str:
    return f'<PathPoint name="{name}">{frame(body)}<location>{osim.numbers(*place)}</location></PathPoint>'


def conditional(name: str, body: str, place: tuple[float, float, float], limits: tuple[float, float]) -> str:
    return (
        f'<ConditionalPathPoint name="{name}">{frame(body)}<location>{osim.numbers(*place)}</location>'
        f"<socket_coordinate>/jointset/knee/knee_angle</socket_coordinate><range>{osim.numbers(*limits)}</range>"
        "</ConditionalPathPoint>"
    )


def moving(name: str, body: str) -> str:
    sockets = "".join(
        f"<socket_{axis}_coordinate>/jointset/knee/knee_angle</socket_{axis}_coordinate>" for axis in "xyz"
    )
    functions = {
        "x": osim.points("SimmSpline", [-2.0, -1.5, -1.0, -0.4, 0.1], [0.03, 0.042, 0.05, 0.056, 0.058]),
        "y": "<PolynomialFunction><coefficients>0.01 -0.02 0.02</coefficients></PolynomialFunction>",
        "z": "<Constant><value>0.004</value></Constant>",
    }
    places = "".join(f"<{axis}_location>{one}</{axis}_location>" for axis, one in functions.items())
    return f'<MovingPathPoint name="{name}">{frame(body)}{sockets}{places}</MovingPathPoint>'


def muscle(kind: str, name: str, points: list[str], more: str = "", wraps: str = "") -> str:
    return (
        f'<{kind} name="{name}"><GeometryPath name="path"><PathPointSet><objects>{"".join(points)}</objects>'
        f"</PathPointSet><PathWrapSet><objects>{wraps}</objects></PathWrapSet></GeometryPath>"
        "<max_isometric_force>1500</max_isometric_force><optimal_fiber_length>0.12</optimal_fiber_length>"
        f"<tendon_slack_length>0.2</tendon_slack_length>{more}</{kind}>"
    )


CYLINDER = (
    '<WrapObjectSet name="wraps"><objects><WrapCylinder name="condyle"><xyz_body_rotation>0 0 0.3</xyz_body_rotation>'
    "<translation>0.0 -0.4 0.0</translation><quadrant>+x</quadrant><radius>0.03</radius><length>0.2</length>"
    '</WrapCylinder><WrapSphere name="ball"><radius>0.03</radius></WrapSphere></objects></WrapObjectSet>'
)
WRAP = '<PathWrap name="w"><wrap_object>{}</wrap_object><method>hybrid</method><range>-1 -1</range></PathWrap>'
MILLARD = "Millard2012EquilibriumMuscle"
MUSCLES = [
    muscle(
        MILLARD, "hamstrings", [point("a", "ground", (-0.06, 0.93, 0.07)), point("b", "shank", (-0.03, -0.05, 0.02))],
    ),
    muscle(
        "Thelen2003Muscle", "gastroc",
        [
            point("a", "thigh", (-0.02, -0.39, -0.02)), conditional("b", "thigh", (-0.03, -0.402, -0.03), (-0.8, 0.2)),
            point("c", "shank", (-0.04, -0.4, 0.0)),
        ],
        "<pennation_angle_at_optimal>0.3</pennation_angle_at_optimal>",
    ),
    muscle("DeGrooteFregly2016Muscle", "vasti", [point("a", "thigh", (0.03, -0.2, 0.03)), moving("b", "shank")]),
    muscle(
        MILLARD, "wrapped", [point("a", "thigh", (0.03, -0.1, 0.0)), point("b", "shank", (0.03, -0.1, -0.06))],
        wraps=WRAP.format("condyle"),
    ),
    muscle(
        MILLARD, "over_ball", [point("a", "thigh", (0.03, -0.1, 0.0)), point("b", "shank", (0.03, -0.1, 0.0))],
        wraps=WRAP.format("ball"),
    ),
    muscle(
        MILLARD, "idle", [point("a", "thigh", (0, 0, 0)), point("b", "shank", (0, 0, 0))],
        "<appliesForce>false</appliesForce>",
    ),
]  # fmt: skip
READ = ("hamstrings", "gastroc", "vasti", "wrapped")


def leg(tmp_path: Path) -> str:
    """Write a leg whose knee slides and whose shank lies 6 cm beside the thigh, and return its path."""
    knee = osim.transform(
        osim.axis("rotation1", osim.Z, osim.linear(), "knee_angle"),
        osim.axis("rotation2", "0 1 0", osim.constant(0.0)),
        osim.axis("rotation3", "1 0 0", osim.constant(0.0)),
        osim.axis("translation1", "1 0 0", osim.points("SimmSpline", osim.KNEE, osim.KNEE_X), "knee_angle"),
        osim.axis("translation2", "0 1 0", osim.points("SimmSpline", osim.KNEE, osim.KNEE_Y), "knee_angle"),
        osim.axis("translation3", osim.Z, osim.constant(0.06)),
    )
    thigh = osim.body("thigh", 9.3, (0.01, -0.17, 0.02), 0.13).replace("</Body>", f"{CYLINDER}</Body>")
    text = osim.document(
        [thigh, osim.body("shank", 3.7, (0.0, -0.187, 0.0), 0.05)],
        [
            osim.joint("PinJoint", "hip", "ground", "thigh", "hip_flexion", at=(0.0, 0.9, 0.08)),
            osim.joint("CustomJoint", "knee", "thigh", "shank", "knee_angle", transform=knee),
        ],
        more=f"<ForceSet><objects>{''.join(MUSCLES)}</objects></ForceSet>",
    )
    path = tmp_path / "leg.osim"
    path.write_text(text)
    return str(path)


ANGLES = [(0.0, 0.0), (0.5, -0.6), (-0.3, -1.2)]
LENGTHS = {
    "hamstrings": [0.4847824644271496, 0.48765846364532056, 0.41792078455386567],
    "gastroc": [0.422615475754512, 0.40996879086964577, 0.39148740448465985],
    "vasti": [0.1804638422252533, 0.20700811697736893, 0.23671062124308678],
    "wrapped": [0.3957547896824418, 0.41719828116152297, 0.43426850883018103],
}
"""Lengths of the muscles at these angles of hip and knee, computed by OpenSim 4.6 [m]."""


def lengths(m: Mechanism, names: tuple[str, ...] = READ) -> list[float]:
    """Return the lengths of muscles at the start."""
    q = np.array([x for body in m.bodies.values() for x in (*body.position, body.angle)])[None]
    return [float(MusclePath(name, m.muscles[name], QuantityNames(m)).at(np.zeros(1), q).length[0]) for name in names]


@pytest.mark.parametrize("row", range(3))
def test_lengths_are_those_of_opensim(tmp_path: Path, row: int) -> None:
    hip, knee = ANGLES[row]
    m = build_mechanism(leg(tmp_path), {"hip_flexion": hip, "knee_angle": knee}, {}, muscles=True)
    np.testing.assert_allclose(lengths(m), [LENGTHS[name][row] for name in READ], rtol=0, atol=1e-12)


@pytest.mark.skipif(not importlib.util.find_spec("opensim"), reason="the package opensim is not installed")
def test_the_lengths_above_are_by_opensim(tmp_path: Path) -> None:
    import opensim

    opensim.Logger.setLevelString("error")
    model = opensim.Model(leg(tmp_path))
    state = model.initSystem()
    for row, (hip, knee) in enumerate(ANGLES):
        for name, value in (("hip_flexion", hip), ("knee_angle", knee)):
            model.updCoordinateSet().get(name).setValue(state, value, False)
        model.realizePosition(state)
        for name in READ:
            found = model.getMuscles().get(name).getLength(state)
            assert found == pytest.approx(LENGTHS[name][row], abs=1e-12)


def test_parameters_are_read_and_what_is_not_read_is_named(tmp_path: Path) -> None:
    m = build_mechanism(leg(tmp_path), {}, {}, muscles=True)
    assert tuple(m.muscles) == READ
    gastroc = m.muscles["gastroc"]
    assert (gastroc.max_force, gastroc.optimal_length, gastroc.tendon_length, gastroc.pennation) == (
        1500, 0.12, 0.2, 0.3,
    )  # fmt: skip
    assert (gastroc.curves, m.muscles["vasti"].curves) == ("millard", "de-groote-fregly")
    told = "\n".join((*m.warnings, *m.left_out))
    assert "muscle 'over_ball' of the model of OpenSim is left out: it wraps around a WrapSphere" in told
    assert "the curves of Thelen2003Muscle are replaced by those of Millard: gastroc" in told
    assert "has 1 Millard2012EquilibriumMuscle, which the mechanism leaves out: idle" in told


def test_inverse_dynamics_says_which_muscles_are_left_out(tmp_path: Path) -> None:
    zero = [0.0] * 6
    columns = {name: {"column": "a", "rate": "a", "acceleration": "a"} for name in ("hip_flexion", "knee_angle")}
    motion = {"data": {"time": [0.1 * i for i in range(6)], "a": zero}, "columns": columns}
    model = {"name": "opensim", "file": leg(tmp_path), "muscles": True}
    recruitment = {"capacity": "isometric", "reserves": 5.0}
    run = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": motion, "recruitment": recruitment})
    assert tuple(run.muscles) == READ
    assert any("left out: it wraps around a WrapSphere" in warning for warning in run.warnings)


def test_muscles_are_left_out_unless_they_are_asked_for(tmp_path: Path) -> None:
    m = build_mechanism(leg(tmp_path), {}, {})
    assert not m.muscles
    assert any("which the mechanism leaves out: hamstrings, wrapped" in sentence for sentence in m.left_out_of_runs)
