"""`Run.plot` and `Run.animate`: methods of a run that higher packages implement."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from mbdkit.registry.manager import registry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mbdkit.archive.largest_values import LargestValues


Names = str | Sequence[str] | None  #: Names of the elements to draw; None for those with the largest values.
Gap = Literal["position", "velocity", "angle"]
Components = Literal["magnitude", "global", "body", "x", "y", "axial", "shear"]
BeamForce = Literal["moment", "shear", "axial"]


class Animation(Protocol):
    """An animation of a run, which notebooks show with its controls; see
    `mbdkit_report.notebook.animation.Animation`.
    """

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the animation to a file ending in .gif, .html or .mp4, and return its path."""

    def _repr_html_(self) -> str: ...


class StatedErrors(Protocol):
    """What is known of the errors of a run, and how it is stated; see `mbdkit.archive.accuracy_summary.RunErrors`."""

    @property
    def are_estimated(self) -> bool:
        """Whether the errors of the results were estimated."""

    @property
    def unknown_times(self) -> str:
        """Phrase with the times at which errors are unknown although they were estimated; empty if there are none."""

    @property
    def excluded(self) -> str:
        """Error that the estimates do not include; empty if there is none."""

    force_in: str
    """Words for the force of a joint, before its name."""

    never_good: str
    """Why such runs never have the verdict ``good``, and what would say more; empty if they may have it."""

    @property
    def without_suspicion(self) -> str:
        """Clause for a run whose verdict has no reasons."""

    def of_largest(
        self, quantity: str, names: Sequence[str], size: np.ndarray, errors: np.ndarray | None = None
    ) -> LargestValues:
        """Return the largest values of elements with their bars."""

    def missed(self, quantity: str, names: Sequence[str], size: np.ndarray) -> np.ndarray | None:
        """Return by how much the largest values (E,) exceed those of the rows; None if nothing happens between rows."""

    def sentence(self, *, with_force: bool = True) -> str:
        """Return a sentence on the errors."""


class RunPlots:
    """Plots of a run. Each method draws on the Matplotlib axes `ax`, by default those of a new figure, and returns the
    axes.

    Fonts, colours and line widths are those of Matplotlib's current settings (`rcParams`). Labels have SI units. Every
    line is named in the legend. Unless joints or force elements are named, the six with the largest values are drawn.
    Estimated errors (``check: true`` in the spec) are drawn as bands. If there are more than 2000 rows, consecutive
    rows are combined and their extremes are drawn. `mbdkit.plot.compare` draws several runs.

    All methods raise SpecError if the run has no rows or there is nothing to draw, UnknownNameError for an unknown
    name, and NotRecordedError if the run did not record the quantity.

    Examples
    --------
    >>> import mbdkit
    >>> run = mbdkit.run("pendulum")
    >>> axes = run.plot.reactions(joints=["J1"], components="global")
    >>> axes.get_ylabel()
    'joint force [N]'
    """

    def __init__(self, draw: Callable[..., Axes]):
        self._draw = draw  # called with the kind of plot, the axes, and the options of the method
        for kind in registry().names("plot-kind"):
            if not hasattr(self, kind):  # a kind that a plugin adds
                setattr(self, kind, partial(draw, kind))

    def trajectory(self, ax: Axes | None = None, *, points: Names = None) -> Axes:
        """Draw paths of points in the plane [m].

        Parameters
        ----------
        points
            Names of markers, of bodies (their centres of mass), of joints that move, and of free ends such as
            ``rod2 end``; by default all markers or, if the run has none, free ends and moving joints.
        """
        return self._draw("trajectory", ax, points=points)

    def drift(self, ax: Axes | None = None, *, joints: Names = None, gap: Gap = "position") -> Axes:
        """Draw the misalignment of joints over time on a logarithmic axis.

        Parameters
        ----------
        gap
            Misalignment of the ``position`` [m], of the ``velocity`` [m/s] or of a prescribed ``angle`` [rad].
        """
        return self._draw("drift", ax, joints=joints, gap=gap)

    def energy(self, ax: Axes | None = None, *, terms: Names = None) -> Axes:
        """Draw energies over time [J].

        Parameters
        ----------
        terms
            Some of ``kinetic``, ``potential``, ``total``, ``dissipated``, ``work`` and ``balance``; by default all but
            the balance, without those that are zero. Potential and total energy are relative to the potential energy at
            the start.
        """
        return self._draw("energy", ax, terms=terms)

    def reactions(self, ax: Axes | None = None, *, joints: Names = None, components: Components = "magnitude") -> Axes:
        """Draw the forces in joints over time [N], which the first body of each joint exerts on the second.

        Parameters
        ----------
        joints
            Names of joints; by default those with the largest forces.
        components
            ``magnitude``; ``x``, ``y`` or both (``global``), in the global frame; ``axial``, ``shear`` or both
            (``body``), along the x and the y axis of the second body of the joint, or of the first body if the second
            is the ground.
        """
        return self._draw("reactions", ax, joints=joints, components=components)

    def torques(self, ax: Axes | None = None, *, joints: Names = None, elements: Names = None) -> Axes:
        """Draw torques over time [N m], positive counter-clockwise on the second body.

        Parameters
        ----------
        joints, elements
            Names of joints and drivers, and of force elements; by default those with the largest torques.
        """
        return self._draw("torques", ax, joints=joints, elements=elements)

    def forces(self, ax: Axes | None = None, *, elements: Names = None) -> Axes:
        """Draw the forces of springs, dampers, force laws and loads over time [N]; attraction is positive.

        Parameters
        ----------
        elements
            Names of force elements; by default those with the largest forces.
        """
        return self._draw("forces", ax, elements=elements)

    def beams(
        self,
        ax: Axes | None = None,
        *,
        beams: Names = None,
        components: BeamForce = "moment",
        times: float | Sequence[float] | None = None,
    ) -> Axes:
        """Draw an internal force of beams: its largest magnitude over time, or its values along beams at some times.

        Parameters
        ----------
        beams
            Names of beams; by default those with the largest values.
        components
            ``moment`` [N m]; ``shear`` or ``axial`` [N], in the frame of the cross-section.
        times
            Times [s] for which values along the beams are drawn; the nearest recorded rows are used.
        """
        return self._draw("beams", ax, beams=beams, components=components, times=times)
