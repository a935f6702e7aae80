"""Devices worn by a person: a mechanism of its own, whose links cuffs attach to the limbs of the model of the person.

The key `devices` of a model adds the elements of each device to the mechanism, with the name of the device in front:
body ``lower`` of the device ``brace`` is ``brace.lower``, and the cuff of this link has the same name.

A device is fitted in the *neutral posture*: the initial positions of its own mechanism, in which its links lie on the
limbs of an upright person. In this posture, the tissue under all cuffs is at rest. The initial positions in the model
of the person may be others: each attached link starts where its tissue is at rest, and the joints of the device are
then closed by the least change in the metric of its masses.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, model_validator

from mbdkit import load_spec
from mbdkit.plugin import GROUND, Body, Mechanism, Number, Point, SpecError, StrictModel, did_you_mean, listed, quoted
from mbdkit.plugin.equations import LeastChange, compile_mechanism, elementary, workspace_at_start
from mbdkit.plugin.seams import element_files, mechanism_attribute, model_extension
from mbdkit.plugin.specs import Choice, StrictSpec, parse_key, put, read_source
from mbdkit_wearable.cuff import Tissue

#: Largest distance of a cuff from the centre of mass of its limb, relative to that of the farthest joint of the limb.
REACH = 1.5


CLOSED = 1e-12  #: Largest residual of the joints of a device at the start [m, rad, m/s, rad/s].

T = TypeVar("T", float, np.ndarray)


class DeviceAttachment(StrictModel):
    """The cuff with which a link of a device is attached to a limb."""

    limb: str
    """Body of the person."""
    at: Point
    """Point of the limb [m], in its frame, where the point `on` of the link lies in the neutral posture if the device
    fits exactly."""
    on: Point = (0.0, 0.0)
    """Point of the link [m], in its frame, at which the forces act; by default, its centre of mass."""
    angle: Number | None = None
    """Angle of the link relative to the limb in the neutral posture [rad]; by default, the initial angle of the link in
    the mechanism of the device, which is right if the frame of the limb is then parallel to the global frame."""
    cuff: Tissue
    """Properties of the cuff: `stiffness`, and further keys of `cuffs`."""


class Device(StrictModel):
    """A device worn by a person."""

    file: str | None = None
    """Name of a spec whose model is the mechanism of the device, in its neutral posture; relative to the folder of the
    spec."""
    mechanism: Annotated[BaseModel | None, Choice("model", optional=True, has_keys=False)] = None
    """The mechanism of the device itself: the name of a model, and its parameters; an alternative to `file`."""
    attach: dict[str, DeviceAttachment]
    """Cuffs by the name of the link of the device."""
    offset: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    """Misfit x, y and angle [m, m, rad]: displacement of the device from where it fits exactly, and rotation about the
    origin of its global frame, both in this frame in the neutral posture."""
    worn: bool = True
    """Whether measured loads, such as those of force plates, include the weight and inertia of the device."""
    joins_limbs: bool = False
    """Whether the device joins limbs on purpose, as a band between both feet does; otherwise, cuffs on two legs are
    refused."""

    @model_validator(mode="after")
    def _has_mechanism(self) -> Device:
        if self.mechanism is None:
            raise SpecError("is missing: a model and its parameters, or the `file` of a spec with one", key="mechanism")
        if not self.attach:
            raise SpecError("is empty: attach at least one link of the device to a limb", key="attach")
        return self


@element_files
def read_devices(devices: Mapping[str, object], folder: Path) -> None:
    """Replace the names of files by the mechanisms that they contain."""
    for name, device in devices.items():
        if isinstance(device, dict) and isinstance(device.get("file"), str):
            key = f"model.devices.{quoted(name)}"
            if "mechanism" in device:
                raise SpecError("give either `file` or `mechanism`, not both", key=f"{key}.file")
            try:
                document = read_source(folder / device.pop("file"))
                document.data = {"integrator": {"name": "rk4"}, "time": {"steps": 1, "step": 1e-3}} | document.data
                device["mechanism"] = load_spec(document).mechanism().to_spec()
            except SpecError as error:
                raise error if error.key else SpecError(str(error), key=f"{key}.file") from None


@model_extension
def add_devices(devices: Mapping[str, Device], mechanism: Mechanism) -> None:
    """Add the elements of devices and their cuffs to the mechanism of a person."""
    for name, device in devices.items():
        assert device.mechanism is not None
        key = f"devices.{quoted(name)}"
        try:
            own = Choice.build_model(device.mechanism)
        except SpecError as error:
            raise SpecError(error.message, key=f"{key}.mechanism.{error.key.removeprefix('model.')}") from None
        assert isinstance(own, Mechanism)
        _Worn(name, device, own, mechanism, key).add()


class _Devices(StrictSpec):
    """What `wear` gets, so that errors are those of a spec, and numbers may have units."""

    devices: dict[str, Device]


@mechanism_attribute
def wear_method(mechanism: Mechanism) -> Callable[..., None]:
    """Return the method that adds a device to a mechanism: its name, its own mechanism, and keys of `devices`."""

    def wear(name: str, device: Mechanism, **keys: Any) -> None:
        given = {"mechanism": {"name": "mechanism", **device.to_spec()}, **keys}
        valid = _Devices(devices={name: given}).devices[name]
        _Worn(name, valid, device, mechanism, f"devices.{quoted(name)}").add()
        mechanism.validate()

    return wear


def _moved(bodies: Mapping[str, Body], q: np.ndarray, v: np.ndarray) -> dict[str, Body]:
    """Return bodies with positions and velocities (B, 3)."""
    found = {}
    for (name, body), (x, y, angle), (vx, vy, spin) in zip(bodies.items(), q.tolist(), v.tolist(), strict=True):
        turn = {} if body.inertia is None else {"angle": angle, "angular_velocity": spin}
        found[name] = body.model_copy(update={"position": (x, y), "velocity": (vx, vy), **turn})
    return found


def turned(angle: T, point: tuple[T, T]) -> tuple[T, T]:
    """Return a point (x, y), turned by an angle [rad]; or points, by angles, as arrays."""
    c, s = elementary.cos(angle), elementary.sin(angle)
    return c * point[0] - s * point[1], s * point[0] + c * point[1]


class _Worn:
    """A device that is added to the mechanism of a person; `key` is that of the device in the model."""

    def __init__(self, name: str, device: Device, own: Mechanism, person: Mechanism, key: str):
        self.name, self.device, self.own, self.person, self.key = name, device, own, person, key
        if own.beams:
            raise SpecError("has beams, which devices cannot have yet", key=f"{key}.mechanism")
        self.rests = {link: self._rest(link, one) for link, one in device.attach.items()}
        if not device.joins_limbs and (apart := self._apart()) is not None:
            first, second = (f"that of '{link}' is on '{device.attach[link].limb}'" for link in apart)
            raise SpecError(
                f"has cuffs on two limbs: {first}, and {second}; attach both to the same limb, describe the device as "
                "two devices, or set `joins_limbs: true` if it is meant to join these limbs",
                key=f"{key}.attach.{quoted(apart[1])}.limb",
            )

    def _apart(self) -> tuple[str, str] | None:
        """Return two links whose limbs only the trunk joins, which the device is not attached to; None without such.

        A trunk is a body that joins at least two limbs of two or more bodies, which do not contain the heaviest body.
        """
        near: dict[str, set[str]] = {name: set() for name in self.person.bodies}
        for joint in self.person.joints.values():
            for one, other in itertools.permutations({body for _, body, _ in joint.attachments()} & near.keys(), 2):
                near[one].add(other)
        heaviest = max(near, key=lambda name: self.person.bodies[name].mass)
        worn = {one.limb: link for link, one in self.device.attach.items() if near.get(one.limb)}
        for trunk in ("", *near):  # first, limbs that nothing joins, as those of legs on a fixed hip
            parts = _components({name: others - {trunk} for name, others in near.items() if name != trunk})
            limbs = [part for part in parts if not trunk or heaviest not in part]
            links = [[link for limb, link in worn.items() if limb in part] for part in limbs]
            on_limbs = [of_part[0] for of_part in links if of_part]
            is_trunk = not trunk or sum(len(part) > 1 for part in limbs) > 1
            if is_trunk and len(on_limbs) > 1 and sum(map(len, links)) == len(worn):
                return on_limbs[0], on_limbs[1]
        return None

    def prefixed(self, name: str) -> str:
        """Return the name of an element or body of the device in the mechanism of the person."""
        return name if name == GROUND else f"{self.name}.{name}"

    def _rest(self, link: str, one: DeviceAttachment) -> tuple[tuple[float, float], float]:
        """Return the point of the limb where a link's point is at rest [m], and the relative angle at rest [rad]."""
        key = f"{self.key}.attach.{quoted(link)}"
        if link not in self.own.bodies:
            known = did_you_mean(link, self.own.bodies) or f"; its links are {listed(list(self.own.bodies))}"
            raise SpecError(f"the device has no link '{link}'{known}", key=key)
        if one.limb != GROUND and one.limb not in self.person.bodies:
            known = did_you_mean(one.limb, self.person.bodies) or f"; its bodies are {listed(list(self.person.bodies))}"
            raise SpecError(f"there is no limb '{one.limb}' for the cuff of '{link}'{known}", key=f"{key}.limb")
        x, y, turn = self.device.offset
        angle = self.own.bodies[link].angle
        held = self.own.bodies[link].to_global(one.on)
        swung = turned(turn, held)
        frame = 0.0 if one.angle is None else one.angle - angle
        move = turned(frame, (x + swung[0] - held[0], y + swung[1] - held[1]))
        at = one.at[0] + move[0], one.at[1] + move[1]
        pins = [place[2] for pin in self.person.joints.values() for place in pin.attachments() if place[1] == one.limb]
        farthest = max((elementary.hypot(*point) for point in pins), default=0.0)
        if one.limb != GROUND and (far := elementary.hypot(*at)) > REACH * farthest > 0.0:
            moved, of_offset = elementary.hypot(*move), f"{self.key}.offset"
            what = f"moves the cuff of '{link}' by {moved:.3g} m, to" if moved else "is"
            raise SpecError(
                f"{what} {far:.3g} m from the centre of mass of '{one.limb}', beyond the reach of this limb, whose "
                f"joints are at most {farthest:.3g} m from there",
                key=of_offset if moved else f"{key}.at",
            )
        return at, frame + angle + turn

    def _carried(self, body: Body, at: tuple[float, float], angle: float, limb: str) -> Body:
        """Return a body whose centre of mass is at a point of a limb, at an angle relative to it, and moves with it."""
        if limb == GROUND:
            return body.model_copy(update={"position": at, "angle": angle})
        of = self.person.bodies[limb]
        x, y = of.to_global(at)
        spin = of.angular_velocity
        velocity = of.velocity[0] - spin * (y - of.position[1]), of.velocity[1] + spin * (x - of.position[0])
        placed = {"position": (x, y), "velocity": velocity}
        turn = {} if body.inertia is None else {"angle": of.angle + angle, "angular_velocity": spin}
        return body.model_copy(update=placed | turn)

    def _bodies(self) -> dict[str, Body]:
        """Return the links of the device on the limbs: attached ones at rest, others with the first attached one."""
        first = next(iter(self.rests))
        found = {}
        for name, body in self.own.bodies.items():
            link = name if name in self.rests else first
            one, (at, angle), lead = self.device.attach[link], self.rests[link], self.own.bodies[link]
            # the point of the limb below the centre of mass, by way of the point of the attached link
            x, y = lead.to_local(body.position)
            arm = turned(angle, (x - one.on[0], y - one.on[1]))
            place = at[0] + arm[0], at[1] + arm[1]
            found[name] = self._carried(body, place, angle + body.angle - lead.angle, one.limb)
        return self._closed(found)

    def _closed(self, bodies: dict[str, Body]) -> dict[str, Body]:
        """Return the links with the least change that closes the joints of the device.

        The joints are those of the neutral posture, because gears count their angles from there.
        """
        neutral = Mechanism()
        neutral.bodies, neutral.joints = dict(self.own.bodies), dict(self.own.joints)
        neutral.assembly = self.own.assembly
        if not neutral.joints:
            return bodies
        try:
            _, start = workspace_at_start(neutral)
        except SpecError as error:
            raise SpecError(error.message, key=f"{self.key}.mechanism.{error.key.removeprefix('model.')}") from None
        neutral.bodies = _moved(neutral.bodies, start.q, start.v)
        search = LeastChange(compile_mechanism(neutral), 0.0, np.zeros(3 * len(bodies), dtype=bool))
        q = np.array([[*body.position, body.angle] for body in bodies.values()]).ravel()
        v = np.array([[*body.velocity, body.angular_velocity] for body in bodies.values()]).ravel()
        if np.abs(search.evaluate(q)[0]).max() > CLOSED:
            q = search.positions(q, CLOSED)
        phi, jacobian, phi_t = search.evaluate(q)
        if not np.abs(phi).max() <= CLOSED:
            row = search.compiled.rows[int(np.nanargmax(np.abs(phi)))]
            name, gap = row.label.rpartition(".")[0], f"{np.nanmax(np.abs(phi)):.3g} {row.unit}"
            raise SpecError(
                f"the device cannot close in the posture of the person at the start: its joint '{name}' stays open by "
                f"{gap}; start in another posture, or change the device",
                key=self.key,
            )
        if np.abs(search.rates(jacobian, v, phi_t)).max() > CLOSED:
            v = search.velocities(v, jacobian, phi_t, CLOSED)
        return _moved(bodies, q.reshape(-1, 3), v.reshape(-1, 3))

    def add(self) -> None:
        """Add the elements of the device, and its cuffs."""
        person, own = self.person, self.own
        for name, joint in own.joints.items():
            if GROUND in joint.bodies:
                key = f"{self.key}.mechanism.joints.{quoted(name)}.bodies"
                raise SpecError("joins the device to the ground, but a worn device moves with the person", key=key)
        for name, body in self._bodies().items():
            person.add("bodies", self.prefixed(name), **body.model_dump(mode="json", exclude_defaults=True))
        renamed = _Renaming(own, self.prefixed)
        others = {kind: getattr(own, kind) for kind in ("states", "inputs", "controllers", "coordinates")}
        for kind, elements in (own.elements | others).items():
            for name, element in elements.items():
                person.add(kind, self.prefixed(name), **renamed.keys(element))
        for link, one in self.device.attach.items():
            at, angle = self.rests[link]
            tissue = one.cuff.model_dump(mode="json", exclude_defaults=True)
            pair = (one.limb, self.prefixed(link))
            person.add("cuffs", self.prefixed(link), bodies=pair, at=at, on=one.on, angle=angle, **tissue)


def _components(near: Mapping[str, set[str]]) -> list[set[str]]:
    """Return the connected sets of bodies, given the neighbours of each body."""
    found: list[set[str]] = []
    for name in near:
        if not any(name in part for part in found):
            part, queue = {name}, [name]
            for one in queue:
                queue += sorted(near[one] - part)
                part |= near[one]
            found.append(part)
    return found


class _Renaming:
    """Replaces the names of the elements of a device, in elements and in expressions, by those with the prefix."""

    def __init__(self, own: Mechanism, prefixed: Callable[[str], str]):
        self.own, self.prefixed = own, prefixed
        self.names = {kind: getattr(own, kind) for kind in ("bodies", "states", "inputs", "controllers", *own.elements)}

    def text(self, text: str) -> str:
        """Return an expression of the state with the names of elements in the mechanism of the person."""
        source, bare = " ".join(text.splitlines()).strip().encode(), self.own.bodies | self.own.joints
        changes: list[tuple[ast.expr, str, str]] = []
        for node in ast.walk(ast.parse(source, mode="eval")):
            match node:
                case ast.Attribute(ast.Name(id=kind), attr=name) | ast.Subscript(
                    ast.Name(id=kind), ast.Constant(value=str() as name)
                ) if name in self.names.get(kind, ()):
                    changes.append((node, kind, name))
                case ast.Attribute(ast.Name(id=name)) if name in bare and name not in self.names:
                    changes.append((node.value, "bodies" if name in self.own.bodies else "joints", name))
        for node, kind, name in sorted(changes, key=lambda change: -change[0].col_offset):
            renamed = f'{kind}["{self.prefixed(name)}"]'.encode()
            source = source[: node.col_offset] + renamed + source[node.end_col_offset :]
        return source.decode()

    def keys(self, value: Any) -> dict[str, Any]:
        """Return the keys of an element, state, input, controller or coordinate, as `Mechanism.add` takes them."""
        data: dict[str, Any] = value.model_dump(mode="json", exclude_defaults=True)
        data |= {"type": value.type} if hasattr(value, "type") else {}
        for key, body in getattr(value, "places", tuple)():
            put(data, parse_key(key), self.prefixed(body))
        for key, text in getattr(value, "expressions", tuple)():
            put(data, parse_key(key), self.text(text))
        if isinstance(pathway := data.get("pathway"), dict) and "angles" in pathway:
            pathway["angles"] = {self.prefixed(joint): radius for joint, radius in pathway["angles"].items()}
        if hasattr(value, "relative_to"):
            data |= {key: self.prefixed(data[key]) for key in ("of", "relative_to") if key in data}
        return {"from_" if key == "from" else key: data[key] for key in data}
