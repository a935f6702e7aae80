"""Quantities of the joints over time: misalignments and reactions, with their estimated errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.figures.curves import Array, bands, errors_at
from mbdkit.plot.element_quantity import ElementQuantity

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def joint_quantity(
    run: Run, name: str, path: str, unit: str, values: Callable[[Array], Array] = np.asarray
) -> ElementQuantity:
    """Read an array of the archive group /joints.

    Parameters
    ----------
    path
        Path of the array, of shape (T, J, ...).
    values
        Maps a block of rows to one value for each row and joint, such as the norm over the last axis.
    """
    return ElementQuantity(name, unit, run.joint_names, bands(np.asarray(run.time), run.dataset(path), values))


def joint_misalignment(run: Run) -> ElementQuantity:
    """Return the misalignment of every joint [m]."""
    return joint_quantity(run, "misalignment", "joints/misalignment", "m")


def velocity_misalignment(run: Run) -> ElementQuantity:
    """Return the velocity misalignment of every joint [m/s]."""
    return joint_quantity(run, "velocity misalignment", "joints/velocity_misalignment", "m/s")


def angle_misalignment(run: Run) -> ElementQuantity:
    """Return the angle misalignment of every joint [rad]; zero for joints that do not constrain an angle."""
    return joint_quantity(run, "angle misalignment", "joints/angle_misalignment", "rad")


def reaction_force(run: Run) -> ElementQuantity:
    """Return the magnitude of the reaction force of every joint [N], with its estimated error."""
    force = joint_quantity(
        run, "reaction force", "joints/reaction_force", "N", lambda force: np.hypot(force[..., 0], force[..., 1])
    )
    return with_errors(run, force, "reaction_error")


def reaction_torque(run: Run) -> ElementQuantity:
    """Return the reaction torque of every joint [N m], with its estimated error."""
    return with_errors(run, joint_quantity(run, "reaction torque", "joints/reaction_torque", "N m"), "torque_error")


def with_errors(
    run: Run, quantity: ElementQuantity, name: str, joints: Sequence[int] | slice = slice(None)
) -> ElementQuantity:
    """Add the estimated errors of joints to a quantity, if they were estimated.

    Parameters
    ----------
    name
        Attribute of `Accuracy`: ``reaction_error`` or ``torque_error``.
    joints
        Index of the joint of each element; by default the elements are all joints.
    """
    accuracy = run.accuracy
    if accuracy is None:
        return quantity
    errors = errors_at(accuracy, getattr(accuracy, name)[:, joints], quantity.data.time)
    until = math.nan if accuracy.is_complete else accuracy.known_until
    return replace(quantity, errors=errors, known_until=until)
