"""Moment arms of muscles about coordinates, at the recorded rows of a run."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from types import MethodType

import numpy as np

from mbdkit.archive.result_seams import run_attribute
from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError, UnknownNameError
from mbdkit.engine.linear_systems import least_norms, product, products
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.runs.assembled_mechanism import AssembledMechanism
from mbdkit_biomech.inverse_dynamics.motion.manifold import GivenMechanism, Manifold, Quantities
from mbdkit_biomech.muscles.muscle_path import MusclePath

#: A quantity is chosen if more than this share of its gradient is independent of the gradients chosen before it.
DEPENDENT = 1e-6


def moment_arms(run: Run, muscle: str, coordinate: str) -> np.ndarray:
    """Return the moment arm of a muscle about a coordinate, -dL/dq, at the recorded rows of a run.

    The coordinates of the other joints, on which actuators act by default, are held constant.

    Parameters
    ----------
    run
        The run.
    muscle
        Name of the muscle.
    coordinate
        ``JOINT.angle``, or the name of a coordinate of the model.

    Returns
    -------
    np.ndarray
        (T,) [m]; dimensionless if the coordinate is a length.

    Raises
    ------
    UnknownNameError
        If the model has no such muscle.
    SpecError
        If it has no such coordinate, or the coordinate cannot change.
    """
    if muscle not in run.mechanism.muscles:
        raise UnknownNameError("muscle", muscle, list(run.mechanism.muscles))
    names = QuantityNames(run.mechanism)
    own = names.find(coordinate, "coordinate")
    time = np.asarray(run.time)
    q = np.asarray(run.array("trajectory/position")).reshape(len(time), -1)
    path = MusclePath(muscle, names.mechanism.muscles[muscle], names).at(time, q)
    geometry = copy(run.mechanism)
    for forces in ("forces", "muscles", "states", "controllers"):  # moment arms do not depend on them
        setattr(geometry, forces, {})
    manifold = Manifold(AssembledMechanism.at(GivenMechanism(geometry), float(time[0]), float(time[-1])))
    free = manifold.directions_at(time, q).free * manifold.scale[:, None]
    joints = [names.joint(name, "coordinate") for name in names.mechanism.joints]
    rates = products(Quantities([own, *joints, *names.candidates().values()]).jacobian(q), free)
    rows = _independent(rates[len(time) // 2])
    if 0 not in rows:
        raise SpecError(f"'{coordinate}' cannot change, so muscles have no moment arms for it", key="coordinate")
    one = np.zeros((len(time), len(rows)))
    one[:, 0] = 1.0
    return -path.rate(products(free, least_norms(rates[:, rows], one, 0.0)))


def _independent(rates: np.ndarray) -> list[int]:
    """Return the indices of the first quantities that determine the motion.

    Parameters
    ----------
    rates
        (K, f) rates of the quantities along the free directions of the mechanism.
    """
    rows: list[int] = []
    basis = np.zeros((0, rates.shape[1]))
    for index, row in enumerate(rates):
        rest = row - product(basis.T, product(basis, row))
        if len(rows) < rates.shape[1] and np.sum(rest**2) > DEPENDENT**2 * np.sum(row**2):
            rows.append(index)
            basis = np.vstack([basis, rest / np.sqrt(np.sum(rest**2))])
    return rows


@run_attribute
def arms_of(run: Run) -> Callable[[str, str], np.ndarray]:
    """Return the function that computes moment arms of a run, of a muscle and about a coordinate."""
    return MethodType(moment_arms, run)
