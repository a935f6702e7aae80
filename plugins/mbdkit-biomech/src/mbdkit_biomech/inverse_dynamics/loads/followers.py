"""Loads of a problem with bodies that follow the motion, such as worn devices, and what the ground carries of them.

Force plates that were measured without these bodies carry the person alone. The forces of the bodies on the person then
change the force of the ground: by a force at the measured point of application and a free torque, so that force and
moment of all changes vanish and no residual forces arise. Feet share the change as they share the vertical force. Where
plates measure a part of what weight and acceleration need, as for one leg of two, they carry this share.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.model_keys import model_keys
from mbdkit.runs.followers import AddedForces, Follower, follower
from mbdkit_biomech.inverse_dynamics.loads.loads import Loads, loads_on
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

#: `mbdkit_biomech.inverse_dynamics.compute.InverseProblem`, whose module imports this one.
InverseProblem: TypeAlias = Any

LEAST = 0.05  #: Plates carry no share while less than this share of the weight is needed, as in flight.

#: Plates with more than the second share of the needed force carry all of a change, those with less than the first one
#: their own share; in between, what they carry grows linearly.
PART, WHOLE = 0.7, 0.9


def followers_of(spec: InverseSpec, mechanism: Mechanism) -> dict[str, Follower]:
    """Return the bodies of a spec that follow the motion of a mechanism, by name.

    Raises SpecError if there are none, although the spec says so, or if they do not fit the mechanism.
    """
    if spec.follows is None:
        return {}
    keys = {key: item.follow for key, item in model_keys(spec.model_item).items() if item.follow is not None}
    found = {
        name: follower.of(follow)(value, name, mechanism)
        for key, follow in keys.items()
        for name, value in getattr(spec.model, key, {}).items()
    }
    if not found:
        named = listed([f"`{key}`" for key in keys], "or") or "devices, for which no part is installed,"
        raise SpecError(f"has no effect: the model has no {named} whose bodies no data observe", key="follows")
    return found


def loads_of(problem: InverseProblem, motion: Motion) -> Loads:
    """Return the loads of a problem in the frames of a motion, with the forces of bodies that follow it."""
    loads = loads_on(motion, problem.loads, problem.fitter.bodies)
    for name, one in problem.followers.items():
        added = one.forces(motion.time, motion.q, motion.v, motion.a)
        parts = [added] if problem.is_loaded else []
        if one.worn != problem.is_loaded:
            parts.append(_of_ground(problem, motion, loads, name, added, -1.0 if problem.is_loaded else 1.0))
        for part in parts:
            loads = _with(loads, motion, part, problem.fitter.bodies)
    return loads


def _of_ground(
    problem: InverseProblem, motion: Motion, loads: Loads, name: str, added: AddedForces, sign: float
) -> AddedForces:
    """Return the change of the force of the ground that carries added forces, times `sign`."""
    plates = [index for index, load in enumerate(problem.spec.loads.values()) if load.is_plate]
    total = np.sum(added.force, axis=1)
    moment = np.sum(_cross(added.point, added.force) + added.torque, axis=1)
    share, point = _shares(problem, motion, loads, plates), loads.point[:, plates]
    torque = share * (moment[:, None] - _cross(point, total[:, None]))
    names = tuple(f"{name}.{loads.names[index]}" for index in plates)
    bodies = tuple(loads.bodies[index] for index in plates)
    return AddedForces(names, bodies, sign * share[..., None] * total[:, None], point, sign * torque)


def _shares(problem: InverseProblem, motion: Motion, loads: Loads, plates: list[int]) -> np.ndarray:
    """Return the shares (T, P) of P plates in a change of the force of the ground."""
    gravity = np.array(problem.names.mechanism.gravity)
    up = -gravity / (np.linalg.norm(gravity) or 1.0)
    mass, a = problem.fitter.manifold.mass.reshape(-1, 3)[:, :2], motion.a.reshape(len(motion.a), -1, 3)[..., :2]
    needed = np.sum(mass * (a - gravity) * up, axis=(1, 2))
    pushed = np.maximum(loads.force[:, plates] @ up, 0.0)
    weight = float(np.sum(mass[:, 0])) * float(np.linalg.norm(gravity))
    acts = (needed > LEAST * weight)[:, None]
    known = np.sum(pushed, axis=1) / np.where(acts[:, 0], needed, np.inf)
    whole = np.clip((known - PART) / (WHOLE - PART), 0.0, 1.0)
    carried = np.minimum(known * (1.0 - whole) + whole, 1.0)
    share = pushed / np.maximum(np.sum(pushed, axis=1), 1e-12)[:, None]
    return np.asarray(np.where(acts, share, 0.0) * carried[:, None])


def _with(loads: Loads, motion: Motion, added: AddedForces, bodies: tuple[str, ...]) -> Loads:
    """Return loads with added forces."""
    generalized, powers = loads.generalized.copy(), [loads.power]
    for index, body in enumerate(added.bodies):
        at = 3 * bodies.index(body)
        force, arm = added.force[:, index], added.point[:, index] - motion.q[:, at : at + 2]
        own = np.column_stack([force, _cross(arm, force) + added.torque[:, index]])
        generalized[:, at : at + 3] += own
        powers.append(np.sum(own * motion.v[:, at : at + 3], axis=1)[:, None])
    pairs = (loads.force, added.force), (loads.point, added.point), (loads.torque, added.torque)
    force, point, torque = (np.concatenate(pair, axis=1) for pair in pairs)
    names, on = (*loads.names, *added.names), (*loads.bodies, *added.bodies)
    return Loads(names, on, force, point, torque, generalized, np.concatenate(powers, axis=1))


def _cross(arm: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the moments (...) of forces (..., 2)."""
    return np.asarray(arm[..., 0] * force[..., 1] - arm[..., 1] * force[..., 0])


def remarks_of(problem: InverseProblem) -> list[str]:
    """Return sentences on how the bodies that follow the motion were computed."""
    if not problem.followers:
        return []
    names = listed([f"'{name}'" for name in problem.followers], "and")
    unmeasured = [name for name, one in problem.followers.items() if not one.worn]
    told = [f"the motion is assumed to be the same with and without {names}."]
    if unmeasured:
        plates = [name for name, load in problem.spec.loads.items() if load.is_plate]
        carries = f"whose weight and inertia change {listed(plates, 'and')}" if plates else "and no plate carries it"
        listed_names = listed([f"'{name}'" for name in unmeasured], "and")
        told.append(f"the loads were measured without {listed_names}, {carries}.")
    return told
