"""Base inertial parameters: the combinations of masses, centres of mass and inertias on which a motion depends.

Kinetic and potential energy are linear in the mass, the first moments and the inertia of each body about a reference
point. They do not change if a point mass at a pin, or an inertia at a prismatic joint, is transferred from one body of
the joint to the other. One quantity can be eliminated for each such transfer (W. Khalil, E. Dombre, Modeling,
Identification and Control of Robots, 2002, chapter 9; M. Gautier, J. Robotic Systems 8, 1991).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp

from mbdkit.plugin import GROUND, RunSpec, path_text

PIN, SLIDE = "revolute", "prismatic"
ORIGIN = sp.zeros(2, 1)


def symbol(name: str) -> sp.Symbol:
    """Return the symbol of a parameter."""
    return sp.Symbol(name, positive=True)


def base_parameters(spec: RunSpec, names: Sequence[str]) -> list[sp.Expr]:
    """Return the base inertial parameters of a mechanism that depend on given named parameters or key paths.

    Only pins and prismatic joints count. The list is empty for models that are not free-form mechanisms.
    """
    model = spec.sections()["model"]
    if model.get("name") != "mechanism":
        return []
    texts = _Texts(spec, names)
    bodies = {name: _Body(texts, name, body) for name, body in model["bodies"].items()}
    joints = [
        (joint["type"] == PIN, joint["bodies"], texts.points(name, joint, bodies))
        for name, joint in model["joints"].items()
        if joint["type"] in (PIN, SLIDE) and "center" not in joint and {*joint["bodies"]} <= {GROUND, *bodies}
    ]
    references, tree = {GROUND: ORIGIN}, []  # a point of each body, from the ground outwards
    order = [GROUND]
    for inner in order:  # which grows meanwhile
        for joint in joints:
            outer = 1 if joint[1][0] == inner else 0
            if inner in joint[1] and (name := joint[1][outer]) not in references:
                references[name] = joint[2][outer]
                order.append(name)
                tree.append((joint, name))
    order = [*order[1:], *(name for name in bodies if name not in references)]
    quantities: list[sp.Expr] = []
    for name in order:
        body, center = bodies[name], -references.setdefault(name, ORIGIN)
        quantities += [body.mass, *(body.mass * center), body.inertia + body.mass * center.dot(center)]
    in_tree = [joint for joint, _ in tree]
    transfers = []
    for joint, outer in [*reversed(tree), *((joint, "") for joint in joints if joint not in in_tree)]:
        is_pin, pair, points = joint
        transfer = [sp.S.Zero] * len(quantities)
        for name, point, sign in zip(pair, points, (1, -1), strict=True):
            if name != GROUND:
                x, y = point - references[name]
                start = 4 * order.index(name)
                unit = (1, x, y, x**2 + y**2) if is_pin else (0, 0, 0, 1)
                transfer[start : start + 4] = [sp.expand(sign * entry) for entry in unit]
        transfers.append((transfer, 4 * order.index(outer) + (0 if is_pin else 3) if outer else None))
    return [quantity for quantity in _eliminate(quantities, transfers) if quantity.free_symbols & {*map(symbol, names)}]


def _eliminate(quantities: list[sp.Expr], transfers: list[tuple[list[sp.Expr], int | None]]) -> list[sp.Expr]:
    """Return the quantities after elimination of one for each transfer: the given one, or, for joints that close loops,
    a first moment of the outermost body if possible.
    """
    while transfers:
        (transfer, pivot), *transfers = transfers
        if pivot is None:
            nonzero = [index for index, entry in enumerate(transfer) if entry != 0]
            if not nonzero:
                continue
            pivot = max(nonzero, key=lambda index: (index // 4, index % 4 in (1, 2)))
        rows = [quantities, *(other for other, _ in transfers)]
        rows = [
            [sp.expand(sp.cancel(a - row[pivot] / transfer[pivot] * b)) for a, b in zip(row, transfer, strict=True)]
            for row in rows
        ]
        quantities, transfers = rows[0], [(row, index) for row, (_, index) in zip(rows[1:], transfers, strict=True)]
    return quantities


class _Texts:
    """Numbers and expressions of a spec as formulas with exact numbers."""

    def __init__(self, spec: RunSpec, names: Sequence[str]):
        self.names, self.parameters = {*names}, spec.parameters or {}
        self.symbols = {name: symbol(name) for name in self.parameters} | {
            "degrees": lambda angle: angle * sp.pi / 180, "min": sp.Min, "max": sp.Max,
        }  # fmt: skip

    def formula(self, value: Any, *path: str | int) -> sp.Expr:
        """Return the value at a key path as a formula of parameters; texts were validated as expressions of these."""
        if path_text(path) in self.names:
            return symbol(path_text(path))
        if not isinstance(value, str):
            return sp.Rational(str(value)) if value and abs(value) > 1e-14 else sp.S.Zero
        formula = sp.sympify(value, locals=self.symbols, rational=True)
        for name in sorted(map(str, formula.free_symbols)):
            if isinstance(self.parameters.get(name), str) and name not in self.names:
                formula = formula.subs(symbol(name), self.formula(self.parameters[name], "parameters", name))
        return formula

    def point(self, value: Sequence[Any], *path: str | int) -> sp.Matrix:
        """Return a point (2, 1)."""
        return sp.Matrix([self.formula(part, *path, index) for index, part in enumerate(value)])

    def points(self, name: str, joint: Mapping[str, Any], bodies: Mapping[str, _Body]) -> list[sp.Matrix]:
        """Return the point of each body at a joint, in the frame of the body."""
        path = ("model", "joints", name)
        if joint.get("points") is not None:
            return [self.point(point, *path, "points", index) for index, point in enumerate(joint["points"])]
        at = self.point(joint["at"], *path, "at")
        return [at if body == GROUND else bodies[body].local(at) for body in joint["bodies"]]


class _Body:
    """A body: mass, inertia about the centre of mass, and initial pose."""

    def __init__(self, texts: _Texts, name: str, body: Mapping[str, Any]):
        path = ("model", "bodies", name)
        self.mass, self.inertia, self.angle = (
            texts.formula(body.get(key), *path, key) for key in ("mass", "inertia", "angle")
        )
        self.position = texts.point(body["position"], *path, "position")

    def local(self, point: sp.Matrix) -> sp.Matrix:
        """Return a global point in the frame of the body."""
        cos, sin = sp.cos(self.angle), sp.sin(self.angle)
        return (sp.Matrix([[cos, sin], [-sin, cos]]) * (point - self.position)).applyfunc(sp.simplify)
