"""Histories of the objects of inverse dynamics and of muscles, with the columns of `mbdkit_biomech.quantities`."""

from __future__ import annotations

from mbdkit.archive import recorded_columns as columns


class ObservedHistory(columns.Motion, of="motion"):
    """One observed quantity of a measured motion: measured value, and value of the fitted mechanism."""


class ActuatorHistory(columns.Actuators, of="actuators"):
    """Value [N or N m] of one actuator in inverse dynamics, the error of the value, and the power.

    Its `kind` is ``actuator``, ``reserve`` (of recruitment) or ``residual`` (a load from outside on a part that no
    joint connects to the ground).
    """


class MuscleHistory(columns.Muscles, of="muscles"):
    """Length, fibres, activation, tension [N] with its error, and power of one muscle."""


class KneeHistory(columns.Knees, of="knees"):
    """Forces [N] in one knee beside that of the joint: of the patella on the thigh, in both compartments, and the
    compression along the shank with its bar.
    """


class LoadHistory(columns.Loads, of="loads"):
    """One measured load, in inverse dynamics; force and point of application are in the global frame."""
