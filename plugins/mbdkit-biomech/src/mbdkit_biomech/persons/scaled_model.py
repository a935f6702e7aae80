"""The model of a person: masses, lengths and muscles of a generic leg, scaled to measured segments.

Points of muscles keep their place relative to the joints: the points of a segment are stretched by the ratio of its
lengths, those of trunk and foot by the ratio of body heights. Optimal lengths of fibres and lengths of tendons are
multiplied by the ratio of the lengths of the path in the upright pose, as OpenSim scales them (S. L. Delp et al., IEEE
Trans. Biomed. Eng. 54 (2007) 1940-1950). Forces of muscles are multiplied by the strength of the person.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.models._one_leg import SUFFIX
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.models.leg import LegFourBarOptions, LegOptions, person_of
from mbdkit_biomech.muscles.muscle import Muscle
from mbdkit_biomech.muscles.muscle_path import MusclePath
from mbdkit_biomech.persons.landmarks import side_of
from mbdkit_biomech.persons.person_sections import Subject
from mbdkit_biomech.persons.strength import REPLACED, strength_of

if TYPE_CHECKING:
    from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

#: Options with the pose of a leg, which are left out for the upright pose.
POSE = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion", "trunk_angle", "left")


def leg_options(model: object) -> LegOptions:
    """Return the options of the model of a person; raise SpecError if it is not a leg with a free trunk."""
    if not isinstance(model, LegOptions) or isinstance(model, LegFourBarOptions):
        raise SpecError("should be `leg`, the model that `subject` scales", key="model.name")
    if model.root != "trunk":
        raise SpecError("should be `trunk` with `subject`: the markers give the motion of the trunk", key="model.root")
    for name in ("thigh_length", "shank_length"):
        if getattr(model, name) is not None:
            raise SpecError("is measured with `subject`; leave this out", key=f"model.{name}")
    return model


def scaled_model(spec: InverseSpec, subject: Subject, lengths: Mapping[str, float]) -> dict[str, Any]:
    """Return the section `model` of a spec, scaled to a person, as plain data.

    Parameters
    ----------
    lengths
        Measured lengths of `thigh` and `shank` [m].
    """
    data = json.loads(spec.canonical_json())["model"]
    changed = {**data, "body_mass": subject.mass, "height": subject.height, "table": subject.table}
    changed |= {f"{name}_length": length for name, length in lengths.items()}
    if not data.get("muscles"):
        return changed
    generic, person = (person_of(of_model(spec, one).model) for one in (data, changed))
    points = _points_of_segments(generic, person)
    muscles = {name: moved_muscle(muscle, points) for name, muscle in data["muscles"].items()}
    before, after = _path_lengths(spec, data), _path_lengths(spec, changed | {"muscles": muscles})
    strength = strength_of(subject, generic)
    for name, muscle in muscles.items():
        ratio = after[name] / before[name]
        factors = {"optimal_length": ratio, "tendon_length": ratio, "max_force": strength}
        muscles[name] = muscle | {key: _stretched(muscle[key], one, 0.0) for key, one in factors.items()}
    changed["muscles"] = muscles
    if legs := replaced_legs(spec, subject):
        every = of_model(spec, changed).mechanism().muscles
        muscles = {name: muscle.model_dump(mode="json", exclude_none=True) for name, muscle in every.items()}
        for name in (name for name, muscle in every.items() if any(moves_knee(muscle, leg) for leg in legs)):
            muscles[name]["max_force"] = _stretched(muscles[name]["max_force"], REPLACED, 0.0)
        changed |= {"muscles": muscles, "symmetric_muscles": False}
    return changed


def replaced_legs(spec: InverseSpec, subject: Subject) -> list[str]:
    """Return the suffixes of the legs whose knees have been replaced."""
    if leg_options(spec.model).legs == 2:
        sides = {"right": "", "left": SUFFIX}
    else:
        sides = {"left" if side_of((spec.motion.clusters or {}).get("thigh", ())) == "l" else "right": ""}
    return [leg for side, leg in sides.items() if side in subject.replaced_knees]


def moves_knee(muscle: Muscle, leg: str) -> bool:
    """Return whether a muscle extends or flexes the knee of a leg, and does not cross the ankle."""
    bodies = {item.on for item in muscle.path}
    extends = muscle.patella is not None and muscle.patella.joint == f"knee{leg}"
    return extends or (f"shank{leg}" in bodies and f"foot{leg}" not in bodies)


def _points_of_segments(generic: BodySegments, person: BodySegments) -> dict[str, tuple[float, float, float]]:
    """Return by body: the factor of its points, and what is added to x and y, as centres of mass move."""
    results = {}
    for body, size in {"trunk": "height", "thigh": "thigh_length", "shank": "shank_length", "foot": "height"}.items():
        factor = getattr(person, size) / getattr(generic, size)
        move = factor * getattr(generic, body).centre - getattr(person, body).centre
        results[body] = results[body + SUFFIX] = (factor, move.real, move.imag)
    return results


def moved_muscle(muscle: Mapping[str, Any], points: Mapping[str, tuple[float, float, float]]) -> dict[str, object]:
    """Return a muscle with scaled points and circles.

    Parameters
    ----------
    muscle
        The muscle as plain data.
    points
        By body, the factor of its points, and what is added to x and y.
    """
    path = []
    for item in muscle["path"]:
        wrap = item.get("wrap")
        factor, x, y = points.get((wrap or item)["body"], (1.0, 0.0, 0.0))
        place = (wrap or item)["center" if wrap else "point"]
        own = [_stretched(value, factor, move) for value, move in zip(place, (x, y, 0.0), strict=False)]
        if wrap:
            wrap = wrap | {"center": own, "radius": _stretched(wrap["radius"], factor, 0.0)}
        path.append(item | ({"wrap": wrap} if wrap else {"point": own}))
    if (patella := muscle.get("patella")) is not None:
        factor = points.get(path[-1]["body"], (1.0, 0.0, 0.0))[0]
        patella = {"patella": {**patella, "scale": patella.get("scale", 1.0) * factor}}
    return {**muscle, "path": path, **(patella or {})}


def _stretched(value: Any, factor: float, move: float) -> object:
    """Return ``factor * value + move`` of a number, an expression, or a table of a coordinate."""
    if isinstance(value, str):
        return f"{factor!r}*({value}) + {move!r}"
    if isinstance(value, Mapping):
        at, values = value["table"]
        return {**value, "table": [at, [factor * value + move for value in values]]}
    return factor * value + move


def of_model(spec: InverseSpec, data: Mapping[str, object]) -> Any:
    """Return a spec with the section `model` and the parameters of a spec, without a motion."""
    given = {"mbdkit": 1, "parameters": dict(spec.parameters), "motion": {"data": {"time": [0.0]}}}
    return type(spec)(**given, model=data, follows=spec.follows)


def _path_lengths(spec: InverseSpec, data: Mapping[str, Any]) -> dict[str, float]:
    """Return the lengths of the paths of the muscles in the upright pose [m]."""
    mechanism = of_model(spec, {key: value for key, value in data.items() if key not in POSE}).mechanism()
    names = QuantityNames(mechanism)
    q = np.concatenate([[*body.position, body.angle] for body in mechanism.bodies.values()])[None]
    paths = {name: MusclePath(name, mechanism.muscles[name], names) for name in data["muscles"]}
    return {name: float(path.at(np.zeros(1), q).length[0]) for name, path in paths.items()}
