"""Warnings (*doubts*) about gradients with respect to initial values that assembly changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.base.plain_data import Path, path_text
from mbdkit.spec import RunSpec
from mbdkit_gradients.gradient_parameters import Parameter
from mbdkit_gradients.parameter_differences import PreparedDerivatives

COORDINATES = {"position": ("q", 0), "angle": ("q", 2), "velocity": ("v", 0), "angular_velocity": ("v", 2)}
"""For each key of a body: array of the initial state, and index of the first number among the three of the body."""

KEPT = 0.01
"""Largest accepted deviation from 1 of the derivative of an assembled initial value with respect to the given one.

A larger deviation means that the joints determine the initial value together with values of other bodies.
"""


def start_doubts(spec: RunSpec, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> Iterator[str]:
    """Yield a warning for each initial coordinate or velocity of a body that is a parameter and that assembly changes.

    Parameters
    ----------
    prepared
        Derivatives of the initial state with respect to the parameters.
    """
    if spec.model_item.name != "mechanism":
        return  # the initial values of other models are coordinates that satisfy the joints
    bodies = list(spec.mechanism().bodies)
    for column, parameter in enumerate(parameters):
        for path in _initial_values(spec, parameter):
            array, place = COORDINATES[str(path[3])]
            slopes = prepared.seeds.get(array)
            row = 3 * bodies.index(str(path[2])) + place + (int(path[4]) if len(path) > 4 else 0)
            slope = 0.0 if slopes is None else float(slopes.reshape(-1, len(parameters))[row, column])
            if not np.abs(slope - 1.0) <= KEPT:
                yield (
                    f"the start after assembly changes by {slope:.3g} of a change of {path_text(path)}, because the "
                    f"joints connect it with other initial values; the gradient by {parameter.name} is that by the "
                    f"given value. Give all initial values that belong together as expressions of one parameter, or "
                    f"vary the start with `prepare(...).run(initial=...)`"
                )


def _initial_values(spec: RunSpec, parameter: Parameter) -> list[Path]:
    """Return the paths of the initial coordinates and velocities of bodies that a parameter sets directly.

    Such a value is the parameter itself, or is given as the name of the parameter alone.
    """
    paths = [parameter.path, *(path for path, text in spec.written.items() if text.strip() == parameter.name)]
    bodies = spec.mechanism().bodies
    return [
        path
        for path in paths
        if path[:2] == ("model", "bodies") and len(path) > 3 and path[2] in bodies and path[3] in COORDINATES
    ]
