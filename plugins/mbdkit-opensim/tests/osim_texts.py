"""OpenSim models as text, in the form that OpenSim 4 writes, but without optional parts."""

from __future__ import annotations

from collections.abc import Iterable

Z = "0 0 1"


def numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def body(name: str, mass: float, centre: tuple[float, float, float], inertia: float) -> str:
    return (
        f'<Body name="{name}"><mass>{mass!r}</mass><mass_center>{numbers(*centre)}</mass_center>'
        f"<inertia>{numbers(0.1, 0.1, inertia, 0, 0, 0)}</inertia></Body>"
    )


def offset(name: str, parent: str, place: tuple[float, float, float], turned: tuple[float, float, float]) -> str:
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>{parent}</socket_parent>'
        f"<translation>{numbers(*place)}</translation><orientation>{numbers(*turned)}</orientation></PhysicalOffsetFrame>"
    )


def path_of(frame: str) -> str:
    return "/ground" if frame == "ground" else f"/bodyset/{frame}"


def joint(
    kind: str,
    name: str,
    parent: str,
    child: str,
    coordinates: str = "",
    *,
    at: tuple[float, float, float] = (0, 0, 0),
    turned: tuple[float, float, float] = (0, 0, 0),
    child_at: tuple[float, float, float] = (0, 0, 0),
    child_turned: tuple[float, float, float] = (0, 0, 0),
    transform: str = "",
) -> str:
    """Return a joint. Each of `coordinates` is a name, optionally followed by ``=value`` and ``=locked``."""
    free = []
    for one in coordinates.split():
        word, value, locked = (*one.split("="), "0", "false")[:3]
        free.append(
            f'<Coordinate name="{word}"><default_value>{value}</default_value><locked>{locked}</locked></Coordinate>'
        )
    return (
        f'<{kind} name="{name}"><socket_parent_frame>{parent}_offset</socket_parent_frame>'
        f"<socket_child_frame>{child}_offset</socket_child_frame><coordinates>{''.join(free)}</coordinates><frames>"
        f"{offset(f'{parent}_offset', path_of(parent), at, turned)}"
        f"{offset(f'{child}_offset', path_of(child), child_at, child_turned)}</frames>{transform}</{kind}>"
    )


def axis(name: str, direction: str, function: str, coordinate: str = "") -> str:
    return (
        f'<TransformAxis name="{name}"><coordinates>{coordinate}</coordinates><axis>{direction}</axis>{function}'
        "</TransformAxis>"
    )


def linear(slope: float = 1.0, intercept: float = 0.0) -> str:
    return f'<LinearFunction name="function"><coefficients>{slope!r} {intercept!r}</coefficients></LinearFunction>'


def constant(value: float) -> str:
    return f'<Constant name="function"><value>{value!r}</value></Constant>'


def points(kind: str, x: list[float], y: list[float], name: str = "function") -> str:
    return f'<{kind} name="{name}"><x>{numbers(*x)}</x><y>{numbers(*y)}</y></{kind}>'


def multiplied(function: str, scale: float) -> str:
    inner = f"<function>{function}</function><scale>{scale!r}</scale>"
    return f'<MultiplierFunction name="function">{inner}</MultiplierFunction>'


def transform(*axes: str) -> str:
    return f"<SpatialTransform>{''.join(axes)}</SpatialTransform>"


def marker(name: str, frame: str, place: tuple[float, float, float]) -> str:
    return (
        f'<Marker name="{name}"><socket_parent_frame>{path_of(frame)}</socket_parent_frame>'
        f"<location>{numbers(*place)}</location></Marker>"
    )


def document(bodies: list[str], joints: list[str], markers: tuple[str, ...] = (), more: str = "") -> str:
    def group(tag: str, members: Iterable[str]) -> str:
        return f'<{tag} name="{tag.lower()}"><objects>{"".join(members)}</objects></{tag}>'

    return (
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40500"><Model name="subject">'
        '<Ground name="ground"/><gravity>0 -9.80665 0</gravity>'
        f"{group('BodySet', bodies)}{group('JointSet', joints)}{group('MarkerSet', markers)}{more}"
        "</Model></OpenSimDocument>"
    )


POLYNOMIAL = (
    '<PolynomialFunction name="function"><coefficients>0.02 -0.01 0.03 0.001</coefficients></PolynomialFunction>'
)
KNEE = [-2.1, -1.74, -1.4, -0.87, -0.35, -0.17, 0.1]
KNEE_X = [-0.0032, 0.00179, 0.00411, 0.0041, -0.002, -0.0031, -0.00525]
KNEE_Y = [-0.4226, -0.4162, -0.4099, -0.4026, -0.3976, -0.3966, -0.395]


def leg() -> str:
    """Return a free pelvis, a leg with every kind of planar joint in rotated frames, and a cart on a rail."""
    root = transform(
        axis("rotation1", Z, linear(), "pelvis_tilt"), axis("rotation2", "0 1 0", constant(0.0)),
        axis("rotation3", "1 0 0", constant(0.0)), axis("translation1", "1 0 0", linear(), "pelvis_tx"),
        axis("translation2", "0 1 0", linear(), "pelvis_ty"), axis("translation3", Z, constant(0.0)),
    )  # fmt: skip
    hip = transform(
        axis("rotation1", "0 0 -1", linear(1.0, 0.1), "hip_flexion"), axis("rotation2", "0 1 0", constant(0.0)),
        axis("rotation3", "1 0 0", constant(0.0)), axis("translation1", "1 0 0", constant(0.01)),
        axis("translation2", "0 1 0", constant(-0.02)), axis("translation3", Z, constant(0.03)),
    )  # fmt: skip
    knee = transform(
        axis("rotation1", Z, linear(), "knee_angle"),
        axis("rotation2", "0 1 0", constant(0.0)),
        axis("rotation3", "1 0 0", constant(0.0)),
        axis("translation1", "1 0 0", multiplied(points("SimmSpline", KNEE, KNEE_X, ""), 1.1), "knee_angle"),
        axis("translation2", "0 1 0", points("NaturalCubicSpline", KNEE, KNEE_Y), "knee_angle"),
        axis("translation3", Z, constant(0.0)),
    )
    ankle = transform(
        axis("rotation1", Z, linear(-1.0, 0.05), "ankle_angle"), axis("rotation2", "0 1 0", constant(0.0)),
        axis("rotation3", "1 0 0", constant(0.0)), axis("translation1", "1 0 0", POLYNOMIAL, "ankle_angle"),
        axis("translation2", "0 1 0", linear(0.01, -0.002), "ankle_angle"), axis("translation3", Z, constant(0.0)),
    )  # fmt: skip
    pi = 3.141592653589793
    return document(
        [
            body("pelvis", 11.7, (-0.07, 0.02, 0.0), 0.1),
            body("thigh", 9.3, (0.01, -0.17, 0.02), 0.13),
            body("shank", 3.7, (0.0, -0.187, 0.0), 0.05),
            body("foot", 1.2, (0.05, 0.02, 0.0), 0.004),
            body("toes", 0.2, (0.03, 0.0, 0.0), 0.0003),
            body("cart", 2.0, (0.1, 0.05, 0.0), 0.02),
            body("arm", 1.1, (0.0, -0.1, 0.0), 0.01),
        ],
        [
            joint("CustomJoint", "ground_pelvis", "ground", "pelvis", "pelvis_tilt pelvis_tx pelvis_ty=0.9",
                  at=(0.1, 0.2, 0.0), child_at=(0.02, 0.01, 0.0), child_turned=(0, 0, 0.2), transform=root),
            joint("CustomJoint", "hip", "pelvis", "thigh", "hip_flexion", at=(-0.07, -0.066, 0.08), turned=(0, 0, 0.3),
                  child_at=(0.0, 0.01, 0.0), child_turned=(0, 0, -0.2), transform=hip),
            joint("CustomJoint", "knee", "thigh", "shank", "knee_angle", turned=(0, 0, 0.15), transform=knee),
            joint("CustomJoint", "ankle", "shank", "foot", "ankle_angle", at=(0, -0.43, 0), turned=(0, pi, 0.2),
                  child_at=(0.01, 0.02, 0), child_turned=(0, pi, 0.1), transform=ankle),
            joint("WeldJoint", "mtp", "foot", "toes", at=(0.18, -0.002, 0.01), turned=(0, 0, 0.25),
                  child_turned=(0, 0, 0.05)),
            joint("SliderJoint", "rail", "pelvis", "cart", "rail_x=0.1", at=(0, 0.3, 0), turned=(0, 0, 0.4),
                  child_at=(0.02, 0, 0), child_turned=(0, 0, 0.1)),
            joint("PinJoint", "shoulder", "cart", "arm", "swing", at=(0.1, 0.2, -0.1), turned=(0, 0, -0.3)),
        ],
        (
            marker("asis", "pelvis", (0.1, 0.0, 0.1)),
            marker("trochanter", "thigh", (0.0, 0.0, 0.0)),
            marker("fibula", "shank", (0.03, -0.1, 0.02)),
            marker("heel", "foot", (-0.05, -0.03, 0.1)),
            marker("tip", "toes", (0.06, 0.0, 0.0)),
            marker("hand", "arm", (0.0, -0.3, 0.0)),
        ),
    )  # fmt: skip
