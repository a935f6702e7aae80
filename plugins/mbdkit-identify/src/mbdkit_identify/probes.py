"""Probes: effects that a fitted model may lack, each as a parameter that is zero in the model.

The derivatives of the residuals with respect to probes show whether the data ask for one of them. A probe is another
element of the mechanism, such as the torque of friction in a joint, or a change of its numbers, such as the centre of
mass of a body. Probes of sensors need no run: their derivatives follow from the predicted values and their rates.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from mbdkit.plugin import GROUND, Body, Joint, Mechanism, RunSpec
from mbdkit.plugin.mechanisms import PointForce, SlidingJoint, SpringDamper, Torque, TorsionSpring, mechanism_size
from mbdkit.plugin.specs import parameters_in_use, parse_key, put
from mbdkit.plugin.studies import PreparedSensitivities

AT_ONCE = 12  #: Number of probes in one spec; the time to prepare a run grows with the number of its elements.
SLIP = 0.01  #: Rate below which dry friction is smooth, as a share of the typical rate of the mechanism.

SMOOTH = 1e-3  #: Rate below which quadratic drag is smooth, as such a share.

Limits = tuple[float, float]
Path = tuple[str | int, ...]  #: Key path: names, and indices of lists.
Elements = dict[str, dict[str, Any]]
ANY = (-math.inf, math.inf)
POSITIVE = (0.0, math.inf)
#: Changes of masses, inertias and stiffnesses, as shares of their values, that are plausible.
SHARE = (-0.9, 9.0)
CLOCK = (-0.2, 0.2)  #: Changes of the rate of a clock that are plausible.


@dataclass(frozen=True)
class Probe:
    """An effect that a model may lack.

    Attributes
    ----------
    name
        Name of its parameter, which is zero in the model.
    place
        What is wrong if the data ask for the effect, such as ``friction in the joint 'hub'``.
    kind
        The effect in words, such as ``viscous friction in the joint 'hub'``.
    unit
        Unit of the parameter; ``""`` for a share of the number that it changes.
    is_lacking
        Whether the model lacks the effect; otherwise, it has a number for it.
    limits
        Smallest and largest plausible value of the parameter.
    changes
        Numbers and expressions of the model that change: key path, and derivative with respect to the parameter. Inputs
        change wherever expressions use them.
    forces
        Forces to be added to the model, by name.
    markers
        Markers to be added to the model, by name.
    """

    name: str
    place: str
    kind: str
    unit: str = ""
    is_lacking: bool = True
    limits: Limits = ANY
    changes: Sequence[tuple[Path, str]] = ()
    forces: Elements = field(default_factory=dict)
    markers: Elements = field(default_factory=dict)


def probes_of(spec: RunSpec) -> list[Probe]:
    """Return the effects that a model may lack, or have with a wrong number.

    They are friction, stiffness and a constant torque or force in each revolute and prismatic joint, drag on each body,
    other laws of springs, other masses, inertias, centres of mass and lengths of bodies, other loads, other gains of
    inputs, and another direction of gravity.
    """
    return _Probes(spec).all()


def probe_spec(spec: RunSpec, probes: Sequence[Probe], quantities: Sequence[str] = ()) -> RunSpec:
    """Return the spec with a named parameter for each of the probes, all zero; its runs are those of `spec`.

    The model is written out as a mechanism with the present values of the parameters. Only the parameters that remain
    in expressions of the model or in `quantities` are kept.
    """
    data = json.loads(spec.canonical_json())
    model = _written_out(spec.mechanism())
    for probe in probes:
        for path, factor in probe.changes:
            holder: Any = model
            if path[0] == "inputs":
                name = re.escape(str(path[1]))
                use = re.compile(rf"""inputs(\.{name}\b|\[(\\"|'){name}(\\"|')\])""")
                model = json.loads(use.sub(rf"((1 + {probe.name})*\g<0>)", json.dumps(model)))
                continue
            for part in path:
                holder = holder[part]
            put(model, path, f"{holder if isinstance(holder, str) else repr(holder)} + ({factor})*{probe.name}")
        model["forces"] |= probe.forces
        model["markers"] |= probe.markers
    for key in ("gradients", "measures", "check", "accuracy", "choose"):
        data.pop(key, None)
    given = data.get("parameters") or {}
    used = parameters_in_use(given, [model, data | {"parameters": None, "model": None}, *quantities])
    kept = {name: value for name, value in given.items() if name in used}
    return type(spec)(**data | {"model": model, "parameters": kept | {probe.name: 0.0 for probe in probes}})


def probe_sensitivities(
    spec: RunSpec,
    probes: Sequence[Probe],
    quantities: Sequence[str],
    times: np.ndarray,
    initial: Mapping[str, float] | None = None,
) -> list[PreparedSensitivities]:
    """Return what evaluates the derivatives of quantities at given times with respect to probes, some probes each;
    `spec` has the estimates.
    """
    parts = [probes[first : first + AT_ONCE] for first in range(0, len(probes), AT_ONCE)]
    return [
        PreparedSensitivities(
            probe_spec(spec, some, quantities), quantities, times, [probe.name for probe in some], initial=initial
        )
        for some in parts
    ]


def sensor_probes(units: Mapping[str, str], experiments: Sequence[str]) -> list[Probe]:
    """Return the probes of the sensors of quantities, given with the units of their values, and those of the clocks of
    experiments.
    """
    probes = []
    for quantity, of in units.items():
        for what, unit in {"gain": "", "offset": of, "delay": "s", "drift": f"{of}/s"}.items():
            place = f"{what} of the sensor of {quantity}"
            probes.append(Probe(place, place, f"another {place}", unit, is_lacking=False))
    for name in experiments:
        place = f"clock of the experiment '{name}'"
        probes.append(Probe(place, place, f"another rate of the {place}", "", False, CLOCK))
    return probes


def sensor_derivatives(
    experiment: str, quantity: str, time: np.ndarray, values: np.ndarray, probes: Sequence[Probe]
) -> np.ndarray:
    """Return the derivatives (T, P) of a signal with respect to probes of sensors.

    Parameters
    ----------
    experiment, quantity
        The signal.
    time
        (T,) times [s].
    values
        (T,) predicted values, as the sensor shows them.
    probes
        Those of `sensor_probes`.
    """
    since, rate = time - time[0], CubicSpline(time, values)(time, 1)
    of = f"of the sensor of {quantity}"
    known = {
        f"gain {of}": values, f"offset {of}": np.ones_like(time), f"delay {of}": -rate, f"drift {of}": since,
        f"clock of the experiment '{experiment}'": since * rate,
    }  # fmt: skip
    return np.stack([known.get(probe.name, np.zeros_like(time)) for probe in probes], axis=-1)


def _written_out(mechanism: Mechanism) -> dict[str, Any]:
    """Return the model of a mechanism with all points and initial states, also those that are defaults."""
    model = mechanism.to_spec()
    model.setdefault("gravity", [*mechanism.gravity])
    model.setdefault("forces", {})
    model.setdefault("markers", {})
    for body in model["bodies"].values():
        for key in ("position", "velocity"):
            body.setdefault(key, [0.0, 0.0])
    for kind, elements in mechanism.elements.items():
        for name, element in elements.items():
            if name in model.get(kind, {}):
                for key, _, point in element.attachments():
                    *path, last = parse_key(key)
                    holder = model[kind][name]
                    if isinstance(last, int):
                        for part in path[:-1]:
                            holder = holder[part]
                        holder.setdefault(path[-1], [[0.0, 0.0], [0.0, 0.0]])[last] = [*point]
                    else:
                        put(holder, (*path, last), [*point])
    return model


class _Probes:
    """The probes of one mechanism."""

    def __init__(self, spec: RunSpec):
        self.mechanism = mechanism = spec.mechanism()
        self.model = _written_out(mechanism)
        self.own = [name for name in mechanism.bodies if name in self.model["bodies"]]
        self.probes: list[Probe] = []
        positions = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
        size = mechanism_size(mechanism, positions) or 1.0
        self.rate = max(
            math.sqrt(math.hypot(*mechanism.gravity) / size), 2 * math.pi / (spec.time.final - spec.time.start)
        )
        self.speed = self.rate * size
        self.prefix = "probe"
        while any(name.startswith(self.prefix) for name in (*spec.parameters, *mechanism.forces, *mechanism.markers)):
            self.prefix += "_"

    def all(self) -> list[Probe]:
        """Return all probes."""
        for name, joint in self.mechanism.joints.items():
            self._in_joint(name, joint)
            self._of_joint(name, joint)
        for name in self.own:
            self._of_body(name, self.mechanism.bodies[name])
        for name, force in self.mechanism.forces.items():
            if isinstance(force, Torque | PointForce):
                self._of_load(name)
            elif isinstance(force, SpringDamper | TorsionSpring) and force.stiffness:
                self._of_spring(name, force)
        for name in self.mechanism.inputs:
            self._wrong(f"gain of the input '{name}'", "", [(("inputs", name), "inputs")])
        if any(gravity := self.mechanism.gravity):
            turned = [(("gravity", 0), repr(-gravity[1])), (("gravity", 1), repr(gravity[0]))]
            self._wrong("direction of gravity", "rad", turned)
        return self.probes

    def _wrong(self, place: str, unit: str, changes: Sequence[tuple[Path, str]], limits: Limits = ANY) -> None:
        """Add a probe of numbers of the model."""
        probe = Probe(self._next, place, f"another {place}", unit, is_lacking=False, limits=limits, changes=changes)
        self.probes.append(probe)

    def _lacking(
        self, place: str, kind: str, unit: str, limits: Limits, forces: Elements, markers: Elements | None = None
    ) -> None:
        """Add a probe of an effect that the model lacks."""
        self.probes.append(Probe(self._next, place, kind, unit, True, limits, (), forces, markers or {}))

    @property
    def _next(self) -> str:
        """Name of the next probe."""
        return f"{self.prefix}_{len(self.probes) + 1}"

    # ---- joints ----------------------------------------------------------------------------------------------------

    def _in_joint(self, name: str, joint: Joint) -> None:
        """Add friction, springs and a constant torque or force in a joint."""
        a, b = joint.bodies
        angle = f'joints["{name}"].angle'
        helpers: Elements = {}
        if joint.type == "revolute" and self._turns(a) and self._turns(b):
            torque, along, slip = "torque", "rad", SLIP * self.rate
            rate = f"({self._of(b, 'angular_velocity')} - {self._of(a, 'angular_velocity')})"
        elif isinstance(joint, SlidingJoint) and joint.type == "prismatic":
            torque, along, slip = "force", "m", SLIP * self.speed
            pathway = {"type": "coordinate", "bodies": [a, b], "points": [[0.0, 0.0], [*joint.ends[1]]]}
            for axis in "xy":  # the rates of springs without stiffness
                spring = {"type": "law", "law": "linear", "pathway": pathway | {"coordinate": axis}}
                helpers[f"{self.prefix} {name} {axis}"] = spring
            rates = (f'{u!r}*forces["{key}"].rate' for u, key in zip(joint.direction, helpers, strict=True))
            rate = f"({' + '.join(rates)})"
        else:
            return
        unit = "N m" if torque == "torque" else "N"
        beside = [
            one
            for one in self.mechanism.forces.values()
            if {*getattr(getattr(one, "pathway", one), "bodies", ())} == {a, b}
        ]
        has_spring = any(getattr(one, "stiffness", 0.0) for one in beside)
        for what, kind, law, of, limits in (
            ("friction", "viscous friction", f"-{rate}", f"{unit} s/{along}", ANY if beside else POSITIVE),
            ("friction", "dry friction", f"-{rate}/sqrt({rate}**2 + {slip**2!r})", unit, POSITIVE),
            ("stiffness", "a linear spring", f"-{angle}", f"{unit}/{along}", POSITIVE),
            ("stiffness", f"a {torque} that grows with the cube of the displacement", f"-{angle}**3",
             f"{unit}/{along}^3", POSITIVE),
            (f"constant {torque}", f"a constant {torque}", f"1 + 0*{angle}", unit, ANY),
        ):  # equal functions of time are evaluated once, so constants are expressions of the state # fmt: skip
            if what != "stiffness" or not has_spring:
                value = f"{self._next}*({law})"
                forces = self._force(joint, value) if isinstance(joint, SlidingJoint) else self._torque(joint, value)
                self._lacking(
                    f"{what} in the joint '{name}'", f"{kind} in the joint '{name}'", of, limits, helpers | forces
                )

    def _torque(self, element: Joint | TorsionSpring, value: str) -> Elements:
        """Return a torque on the second body of an element, and the opposite on the first."""
        (a, b), sign = element.bodies, ""
        if b == GROUND:
            a, b, sign = b, a, "-"
        return {
            self._next: {"type": "torque", "body": b, "value": f"{sign}({value})"}
            | ({} if a == GROUND else {"reaction_body": a})
        }

    def _force(self, joint: SlidingJoint, value: str) -> Elements:
        """Return a force on the second body of a slide along its axis, and the opposite on the first."""
        (ux, uy), turn = joint.direction, self.mechanism.relative_angle(*reversed(joint.bodies))
        c, s = math.cos(turn), math.sin(turn)
        axes = (-ux, -uy), (c * ux - s * uy, s * ux + c * uy)
        return {
            f"{self._next} {body}": {"type": "force", "body": body, "point": [*point], "frame": "body",
                                     "value": [f"{x!r}*({value})", f"{y!r}*({value})"]}
            for body, point, (x, y) in zip(joint.bodies, joint.ends, axes, strict=True)
            if body != GROUND
        }  # fmt: skip

    def _of_joint(self, name: str, joint: Joint) -> None:
        """Add the length, the ratio and the points of a joint; the first joint of each body is its reference."""
        data = self.model["joints"][name]
        if (length := data.get("length")) is not None:
            self._wrong(f"length of the joint '{name}'", "", [(("joints", name, "length"), repr(length))], SHARE)
        if (radii := data.get("radii")) is not None:
            self._wrong(f"ratio of the joint '{name}'", "", [(("joints", name, "radii", 0), repr(radii[0]))], SHARE)
        for key, body, _ in joint.attachments():
            first = next(
                n for n, one in self.mechanism.joints.items() if body in {on for _, on, _ in one.attachments()}
            )
            if first != name and body in (GROUND, *self.own) and self._turns(body):
                place = f"position of the joint '{name}' on {'the ground' if body == GROUND else f'the body {body!r}'}"
                for axis in (0, 1):
                    self._wrong(place, "m", [(("joints", name, *parse_key(key), axis), "1")])

    # ---- bodies ----------------------------------------------------------------------------------------------------

    def _of_body(self, name: str, body: Body) -> None:
        """Add the mass, the inertia and the centre of mass of a body, and drag on it."""
        self._wrong(f"mass of the body '{name}'", "", [(("bodies", name, "mass"), repr(body.mass))], SHARE)
        vx, vy, w = (self._of(name, quantity) for quantity in ("vx", "vy", "angular_velocity"))
        drag, speed = f"drag on the body '{name}'", f"sqrt({vx}**2 + {vy}**2 + {(SMOOTH * self.speed) ** 2!r})"
        air = {"type": "force", "body": name, "value": [f"-{self._next}*{v}*{speed}" for v in (vx, vy)]}
        self._lacking(drag, f"quadratic {drag}", "N s^2/m^2", POSITIVE, {self._next: air})
        if body.inertia is None:
            return
        self._wrong(f"inertia of the body '{name}'", "", [(("bodies", name, "inertia"), repr(body.inertia))], SHARE)
        value = f"-{self._next}*{w}*sqrt({w}**2 + {(SMOOTH * self.rate) ** 2!r})"
        air = {"type": "torque", "body": name, "value": value}
        self._lacking(drag, f"a torque of quadratic {drag}", "N m s^2/rad^2", POSITIVE, {self._next: air})
        elements = [(kind, key, one) for kind, some in self.mechanism.elements.items() for key, one in some.items()]
        paths = [getattr(one, "pathway", None) for *_, one in elements]
        if any(path is not None and path.type == "coordinate" and path.bodies[0] == name for path in paths):
            return  # coordinates are measured from the centre of mass
        points = [
            (kind, key, *parse_key(at)) for kind, key, one in elements for at, on, _ in one.attachments()
            if on == name and key in self.model.get(kind, {})
        ]  # fmt: skip
        c, s, spin = math.cos(body.angle), math.sin(body.angle), body.angular_velocity
        for axis, (x, y) in enumerate(((c, s), (-s, c))):
            moved = {("position", 0): x, ("position", 1): y, ("velocity", 0): -spin * y, ("velocity", 1): spin * x}
            changes: list[tuple[Path, str]] = [(("bodies", name, *key), repr(value)) for key, value in moved.items()]
            self._wrong(
                f"centre of mass of the body '{name}'", "m", [*changes, *(((*path, axis), "-1") for path in points)]
            )

    # ---- forces ----------------------------------------------------------------------------------------------------

    def _of_load(self, name: str) -> None:
        """Add the gain of a load, unless it is a table."""
        value = self.model["forces"][name]["value"]
        values = (
            {("value", i): part for i, part in enumerate(value)} if isinstance(value, list) else {("value",): value}
        )
        changes: list[tuple[Path, str]] = [
            (("forces", name, *key), str(part)) for key, part in values.items() if not isinstance(part, dict)
        ]
        if changes:
            self._wrong(f"gain of the load '{name}'", "", changes)

    def _of_spring(self, name: str, spring: SpringDamper | TorsionSpring) -> None:
        """Add stiffness, free length, damping, and a cubic part of the force of a spring."""
        is_line = isinstance(spring, SpringDamper)
        free = "free_length" if isinstance(spring, SpringDamper) else "free_angle"
        length, unit, a, b = getattr(spring, free), "m" if is_line else "rad", *spring.bodies
        stiffness, path = f"stiffness of the spring '{name}'", ("forces", name)
        self._wrong(stiffness, "", [((*path, "stiffness"), repr(spring.stiffness))], SHARE)
        if length:
            self._wrong(f"{free.replace('_', ' ')} of the spring '{name}'", unit, [((*path, free), "1")])
        if spring.damping and is_line:
            self._wrong(f"damping of the spring '{name}'", "", [((*path, "damping"), repr(spring.damping))], SHARE)
        tension = f'{self._next}*(forces["{name}"].length - {length!r})**3'
        markers: Elements = {}
        if isinstance(spring, TorsionSpring):
            forces = self._torque(spring, f"-{tension}")
        else:
            ends = [f"{self._next} {end}" for end in "ab"]
            placed = [
                (end, body, [*point])
                for end, body, point in zip(ends, (a, b), spring.ends, strict=True)
                if body != GROUND
            ]
            markers = {end: {"body": body, "point": point} for end, body, point in placed}
            (xa, ya), (xb, yb) = (
                [f'markers["{end}"].{axis}' for axis in "xy"] if body != GROUND else [f"({x!r})" for x in point]
                for end, body, point in zip(ends, (a, b), spring.ends, strict=True)
            )
            length = f'forces["{name}"].length'
            forces = {
                end: {"type": "force", "body": body, "point": point,
                      "value": [f"{'-' * (end == ends[1])}{tension}*({to} - {at})/{length}"
                                for at, to in ((xa, xb), (ya, yb))]}
                for end, body, point in placed
            }  # fmt: skip
        kind = f"a cubic part of the force of the spring '{name}'"
        self._lacking(stiffness, kind, f"{'N' if is_line else 'N m'}/{unit}^3", ANY, forces, markers)

    def _turns(self, body: str) -> bool:
        return body == GROUND or self.mechanism.bodies[body].inertia is not None

    def _of(self, body: str, quantity: str) -> str:
        return "0" if body == GROUND else f'bodies["{body}"].{quantity}'
