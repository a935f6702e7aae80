"""A device worn by a person whose motion is measured: what its cuffs exert on the limbs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbdkit import RunError
from mbdkit.kernels import Observed
from mbdkit.plugin import GROUND, Body, Mechanism, SpecError, quoted
from mbdkit.plugin.equations import GivenForces, StateObserver, elementary
from mbdkit.plugin.runs import AddedForces, Follower
from mbdkit.plugin.seams import follower
from mbdkit_wearable.device import Device, add_devices, turned
from mbdkit_wearable.worn.device_motion import DeviceMotion, LimbMotion

if TYPE_CHECKING:
    from mbdkit_wearable.acting_cuffs import ActingCuff

#: Standard deviations that are assumed of the offset of a device [m, rad], and of the logarithm of the stiffness of its
#: cuffs, unless `uncertainty.devices` states others.
DEVIATIONS: Mapping[str, float] = {"misfit_x": 0.01, "misfit_y": 0.01, "misfit_angle": 0.05, "tissue": 0.3}

#: Forces of a device on a limb beside those of its cuffs count as zero below this share of the largest force.
NEGLIGIBLE = 1e-9


@follower
def worn_device(value: Device, name: str, mechanism: Mechanism) -> WornDevice:
    """Return a device as bodies that follow the motion of the limbs; see `mbdkit.plugin.seams.follower`."""
    device = WornDevice(value, name, mechanism)
    device.alone({})
    return device


class WornDevice(Follower):
    """A device that follows the motion of limbs, on which it acts by its cuffs."""

    def __init__(self, device: Device, name: str, person: Mechanism):
        self.device, self.name, self.person = device, name, person
        self.worn, self.deviations = device.worn, DEVIATIONS
        limbs = dict.fromkeys(one.limb for one in device.attach.values() if one.limb != GROUND)
        if not limbs:
            raise SpecError("attaches no link to a limb", key=f"devices.{quoted(name)}.attach")
        self.limbs = tuple(body for body in person.bodies if body in limbs)
        self._motion: DeviceMotion | None = None
        self._near: DeviceMotion | None = None
        self._last: tuple[np.ndarray, np.ndarray, AddedForces] | None = None

    def alone(self, poses: Mapping[str, Mapping[str, object]]) -> Mechanism:
        """Return the limbs without joints, and the device with its cuffs, where the limbs have given `poses`."""
        whole, found = Mechanism(), Mechanism()
        whole.gravity = found.gravity = self.person.gravity
        bodies: dict[str, Body] = dict(self.person.bodies)
        whole.bodies = {name: body.model_copy(update=dict(poses.get(name, {}))) for name, body in bodies.items()}
        whole.joints = dict(self.person.joints)
        add_devices({self.name: self.device}, whole)
        prefix = f"{self.name}."
        own = (*self.limbs, *(name for name in whole.bodies if name.startswith(prefix)))
        found.bodies = {name: whole.bodies[name] for name in own}
        for kind, elements in whole.elements.items():
            getattr(found, kind).update({name: one for name, one in elements.items() if name.startswith(prefix)})
        for kind in ("states", "inputs", "controllers", "coordinates"):
            getattr(found, kind).update(getattr(whole, kind))
        return found

    def forces(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> AddedForces:
        """See `Follower.forces`."""
        if self._last is None or self._last[0] is not q or self._last[1] is not v:
            self._last = q, v, self._forces(time, *(self._of_limbs(x) for x in (q, v, a)))
        return self._last[2]

    def _of_limbs(self, values: np.ndarray) -> np.ndarray:
        every = list(self.person.bodies)
        return values[:, [3 * every.index(limb) + axis for limb in self.limbs for axis in range(3)]]

    def _forces(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> AddedForces:
        if self._motion is None:
            poses = {
                limb: {"position": (x, y), "angle": angle}
                for limb, (x, y, angle) in zip(self.limbs, q[0].reshape(-1, 3).tolist(), strict=True)
            }
            span = float(time[0]), float(time[-1])
            try:
                self._motion = DeviceMotion(self.alone(poses), self.limbs, span, self._near)
            except SpecError as error:
                place = f"devices.{quoted(self.name)}"
                raise error if place in error.key else SpecError(error.message, key=f"model.{place}") from None
        try:
            states = self._motion.states(LimbMotion(time, q, v, a))
        except RunError as error:
            raise RunError(f"{self.name}: {error}") from None
        return self._added(self._motion, time, *states)

    def _added(self, motion: DeviceMotion, time: np.ndarray, q: np.ndarray, v: np.ndarray) -> AddedForces:
        """Return the forces of the cuffs, and what else the device exerts on the limbs, in states (T, n)."""
        workspace = motion.prepared.workspace
        observer = StateObserver(workspace)
        observed: Observed = observer.arrays(len(time))
        positions, velocities = (np.column_stack([x, np.zeros((len(time), 3))]) for x in (q, v))
        none = [np.zeros((len(time), len(workspace.mechanism.topology.pairs), size)) for size in (2, 3)]
        observer.observe(time, positions, velocities, observed, GivenForces(np.zeros_like(positions), *none))
        cuffs: tuple[ActingCuff, ...] = workspace.mechanism.extensions["cuffs"]
        bodies = {name: q[:, 3 * k : 3 * k + 3] for k, name in enumerate(workspace.mechanism.bodies)}
        left = motion.forces(time, q, v).reshape(len(time), -1, 3)
        rows: list[tuple[str, str, np.ndarray, np.ndarray, np.ndarray]] = []
        for one in cuffs:
            limb, link = one.cuff.bodies
            if limb == GROUND:
                continue
            normal, shear, on_link = np.moveaxis(observed.forces[:, list(one.forces), 2], 1, 0)
            moment = -on_link
            (x, y), place = one.cuff.axis, bodies[limb]
            force = np.column_stack(turned(place[:, 2], (normal * x - shear * y, normal * y + shear * x)))
            px, py = np.tile(one.cuff.ends[1], (len(time), 1)).T
            point = bodies[link][:, :2] + np.column_stack(turned(bodies[link][:, 2], (px, py)))
            rows.append((one.name, limb, force, point, moment))
            arm, index = point - place[:, :2], self.limbs.index(limb)
            left[:, index, :2] -= force
            left[:, index, 2] -= arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0] + moment
        largest = max((float(np.max(np.abs(force))) for _, _, force, _, _ in rows), default=0.0)
        for index, limb in enumerate(self.limbs):
            if np.max(np.abs(left[:, index])) > NEGLIGIBLE * largest:
                rows.append((f"{self.name}.{limb}", limb, left[:, index, :2], bodies[limb][:, :2], left[:, index, 2]))
        names, limbs, *values = zip(*rows, strict=True)
        return AddedForces(names, limbs, *(np.stack(one, axis=1) for one in values))

    def changed(self, change: Mapping[str, float]) -> WornDevice:
        """See `Follower.changed`."""
        x, y, angle = self.device.offset
        moved = (x + change.get("misfit_x", 0.0), y + change.get("misfit_y", 0.0))
        factor = float(elementary.exp(change.get("tissue", 0.0)))
        attach = {}
        for link, one in self.device.attach.items():
            own = one.cuff.stiffness
            stiffness = own.model_copy(update={key: factor * value for key, value in own})
            attach[link] = one.model_copy(update={"cuff": one.cuff.model_copy(update={"stiffness": stiffness})})
        offset = (*moved, angle + change.get("misfit_angle", 0.0))
        found = WornDevice(self.device.model_copy(update={"offset": offset, "attach": attach}), self.name, self.person)
        found._near = self._motion or self._near
        return found
