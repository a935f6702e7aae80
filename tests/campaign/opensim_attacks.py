"""Models of OpenSim, drawn over all types and properties of its registry: read as OpenSim reads them, or not silently.

The mass matrix and the accelerations at drawn states are compared with those of the package `opensim`, so that gravity,
Coriolis forces, springs and muscles are compared as well.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .attack import LONGEST_MESSAGE, Attack, in_child
from .osim_models import ModelText

CLOSE = 1e-6
"""Largest difference, relative to the largest value or 1."""


@cache
def is_missing(attack: str, *packages: str) -> bool:
    """Return whether a package is not installed, and say so once."""
    missing = [name for name in packages if not importlib.util.find_spec(name)]
    for name in {*packages} - {*missing}:  # once, and not in each fork
        importlib.import_module(name)
    if missing:
        print(f"{attack}: nothing is compared, because {' and '.join(missing)} is not installed", file=sys.stderr)
    return bool(missing)


Readings = dict[str, Any]
"""Coordinates, speeds, mass matrix by pairs of coordinates, and by body the position (2,), velocity (3,), angular
velocity (3,), acceleration (3,) and angular acceleration (3,).
"""


def witness(path: str, states: list[dict[str, tuple[float, float]]]) -> list[Readings]:
    """Return what OpenSim computes at states, each of which has values and speeds of some coordinates."""
    import opensim

    opensim.Logger.setLevelString("off")
    model = opensim.Model(path)
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    held = [coordinate for coordinate in coordinates if coordinate.getLocked(state) or coordinate.isPrescribed(state)]
    free = {
        coordinate.getName(): coordinate
        for coordinate in coordinates
        if all(coordinate.getName() != other.getName() for other in held)
    }
    for number, coordinate in enumerate(free.values(), 1):
        coordinate.setSpeedValue(state, float(number))
    speeds = state.getU()
    places = {round(speeds.get(i)): i for i in range(state.getNU())}
    index = {name: places[number] for number, name in enumerate(free, 1)}
    answers = []
    for given in states:
        for name, coordinate in free.items():
            value, speed = given.get(name, (coordinate.getDefaultValue(), coordinate.getDefaultSpeedValue()))
            coordinate.setValue(state, value, False)
            coordinate.setSpeedValue(state, speed)
        if model.getConstraintSet().getSize():
            model.assemble(state)
        model.realizeAcceleration(state)
        matrix = opensim.Matrix()
        model.getMatterSubsystem().calcM(state, matrix)
        answers.append(
            {
                "values": {name: coordinate.getValue(state) for name, coordinate in free.items()},
                "speeds": {name: coordinate.getSpeedValue(state) for name, coordinate in free.items()},
                "matrix": {(a, b): matrix.get(i, j) for a, i in index.items() for b, j in index.items()},
                "lengths": {muscle.getName(): muscle.getLength(state) for muscle in model.getMuscles()},
                "bodies": {body.getName(): _body(body, state) for body in model.getBodyList()},
            }
        )
    return answers


def _body(body: Any, state: Any) -> list[list[float]]:
    centre = body.getMassCenter()
    vectors = (
        body.findStationLocationInGround(state, centre),
        body.findStationVelocityInGround(state, centre),
        body.getAngularVelocityInGround(state),
        body.findStationAccelerationInGround(state, centre),
        body.getAngularAccelerationInGround(state),
    )
    return [[vector.get(k) for k in range(3)] for vector in vectors]


def reading(path: str, values: dict[str, float], speeds: dict[str, float], *, muscles: bool) -> Readings:
    """Return what mbdkit computes at a state, and the sentences about what it leaves out."""
    import mbdkit
    from mbdkit.mechanism.quantity_names import QuantityNames
    from mbdkit_biomech.muscles.muscle_path import MusclePath
    from mbdkit_opensim.building import build_mechanism

    mechanism = build_mechanism(path, values, speeds, muscles=muscles)
    names = [name for name in mechanism.coordinates if name in values]
    units = []
    for name in names:
        zero = dict.fromkeys(speeds, 0.0) | dict.fromkeys(mechanism.coordinates, 0.0)
        bodies = build_mechanism(path, values, zero | {name: 1.0}).bodies.values()
        units.append([[*body.velocity, body.angular_velocity] for body in bodies])
    weights = np.array([[body.mass, body.mass, body.inertia or 0.0] for body in mechanism.bodies.values()])
    unit = np.array(units).reshape(len(names), *weights.shape)
    matrix = np.einsum("abc,bc,dbc->ad", unit, weights, unit)
    pairs = {(a, b): matrix[i, j] for i, a in enumerate(names) for j, b in enumerate(names)}
    model = {"name": "opensim", "file": path, "initial": values, "speeds": speeds} | (
        {"muscles": True} if muscles else {}
    )
    if mechanism.muscles:  # runs need excitations, which the file lacks
        q = np.array([x for body in mechanism.bodies.values() for x in (*body.position, body.angle)])[None]
        names_of = QuantityNames(mechanism)
        lengths = {
            name: float(MusclePath(name, muscle, names_of).at(np.zeros(1), q).length[0])
            for name, muscle in mechanism.muscles.items()
        }
        return {"matrix": pairs, "bodies": {}, "lengths": lengths, "said": mechanism.left_out}
    method, time = {"name": "rk4"}, {"steps": 1, "step": 1e-9}
    run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": method, "time": time})
    bodies_read = {}
    for name, body in run.bodies.items():
        turn = [0.0, 0.0]
        bodies_read[name] = [
            [*body.position[0], 0.0],
            [*body.velocity[0], 0.0],
            [*turn, body.angular_velocity[0]],
            [*body.acceleration[0], 0.0],
            [*turn, body.angular_acceleration[0]],
        ]
    return {
        "matrix": pairs,
        "bodies": bodies_read,
        "lengths": {},
        "said": (*mechanism.left_out, *mechanism.left_out_of_runs),
    }


def _differences(ours: Readings, theirs: Readings) -> list[str]:
    """Return what differs between the two, as clauses."""
    differences = []
    true = np.array([theirs["matrix"][pair] for pair in ours["matrix"]])
    given = np.array([*ours["matrix"].values()])
    if true.size and not np.max(np.abs(true - given)) <= CLOSE * max(1.0, np.max(np.abs(true))):
        differences.append(f"the mass matrix: {given.tolist()} instead of {true.tolist()}")
    for name, length in ours["lengths"].items():
        if not abs(length - theirs["lengths"][name]) <= CLOSE:
            differences.append(f"the length of muscle {name}: {length} instead of {theirs['lengths'][name]}")
    if not ours["bodies"]:
        return differences
    if {*ours["bodies"]} != {*theirs["bodies"]}:
        return [*differences, f"the bodies: {[*ours['bodies']]} instead of {[*theirs['bodies']]}"]
    for row, quantity in enumerate(
        ("position", "velocity", "angular velocity", "acceleration", "angular acceleration")
    ):
        true = np.array([of[row] for of in theirs["bodies"].values()])
        given = np.array([ours["bodies"][name][row] for name in theirs["bodies"]])
        if not row:
            true[:, 2] = 0.0  # offsets along z do not matter
        if not np.max(np.abs(true - given)) <= CLOSE * max(1.0, np.max(np.abs(true))):
            differences.append(f"the {quantity}: {given.tolist()} instead of {true.tolist()}")
    return differences


def _opensim(random: np.random.Generator, folder: Path) -> list[str]:
    """Compare one model at two states."""
    if is_missing("opensim", "opensim", "mbdkit_opensim"):
        return []
    from mbdkit.base.errors import MbdkitError

    drawn = ModelText(random)
    path = folder / "model.osim"
    path.write_text(drawn.text, encoding="utf-8")
    muscles = bool(random.random() < 0.5)
    states = [{name: tuple(random.uniform(-1, 1, 2).tolist()) for name in drawn.free} for _ in range(2)]
    ending = in_child(witness, str(path), states)
    answers = ending.value or []
    for answer in answers or [{"values": {}, "speeds": {}}]:
        try:
            with contextlib.redirect_stderr(io.StringIO()):  # warnings
                ours = reading(str(path), answer["values"], answer["speeds"], muscles=muscles)
        except MbdkitError as error:
            message = str(error)
            return [f"the message has {len(message)} characters"] if len(message) > LONGEST_MESSAGE else []
        if not answers:
            return []  # OpenSim refuses what mbdkit reads
        named = any(word in sentence for word in drawn.planted for sentence in ours["said"])
        if not named and (problems := _differences(ours, answer)):
            return [f"{problem}; said: {ours['said']}; planted: {drawn.planted}" for problem in problems]
    return []


ATTACKS = (
    Attack(
        "opensim", "models over all types of OpenSim: read as by OpenSim, refused, or doubtful by name", 700, _opensim
    ),
)
