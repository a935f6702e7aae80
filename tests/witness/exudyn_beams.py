"""Straight beams in Exudyn, which is imported when one is made."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Ends = tuple[Sequence[float], Sequence[float]]


def _exudyn(module: str = "") -> Any:
    return importlib.import_module(f"exudyn{module}")


@dataclass
class ExudynBeams:
    """A straight chain of elements in an Exudyn system of its own; `places` are the coordinates of the nodes."""

    places: list[list[float]]
    items: Any = field(default_factory=lambda: _exudyn(".itemInterface"))
    system: Any = field(default_factory=lambda: _exudyn().SystemContainer().AddSystem())
    nodes: list[int] = field(default_factory=list)
    elements: list[int] = field(default_factory=list)

    def fill(self, node: Callable[..., Any], element: Callable[..., Any], **section: float) -> None:
        """Add nodes and elements of these types."""
        self.nodes = [self.system.AddNode(node(referenceCoordinates=at)) for at in self.places]
        for pair in zip(self.nodes, self.nodes[1:], strict=False):
            self.elements.append(self.system.AddObject(element(nodeNumbers=list(pair), **section)))

    def start(self, places: Sequence[Sequence[float]], velocities: Sequence[Sequence[float]]) -> None:
        """Let the nodes start with these coordinates and velocities."""
        for node, at, place, velocity in zip(self.nodes, self.places, places, velocities, strict=True):
            self.system.SetNodeParameter(node, "initialCoordinates", (np.array(place) - at).tolist())
            self.system.SetNodeParameter(node, "initialVelocities", list(velocity))

    def hold(self, *coordinates: int) -> None:
        """Hold coordinates of the first node."""
        ground = self.system.AddNode(self.items.NodePointGround())
        fixed = self.system.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
        for i in coordinates:
            held = self.system.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=self.nodes[0], coordinate=i))
            self.system.AddObject(self.items.ObjectConnectorCoordinate(markerNumbers=[fixed, held]))

    def weigh(self, gravity: float) -> None:
        """Let gravity act, downwards."""
        for element in self.elements:
            whole = self.system.AddMarker(self.items.MarkerBodyMass(bodyNumber=element))
            self.system.AddLoad(self.items.LoadMassProportional(markerNumber=whole, loadVector=[0.0, -gravity, 0.0]))

    def push(self, node: int, force: Sequence[float], torque: float = 0.0) -> list[int]:
        """Let a force and a torque act on a node; return the numbers of these loads."""
        marker = self.system.AddMarker(self.items.MarkerNodeRigid(nodeNumber=self.nodes[node]))
        return [
            self.system.AddLoad(self.items.LoadForceVector(markerNumber=marker, loadVector=[*force, 0.0])),
            self.system.AddLoad(self.items.LoadTorqueVector(markerNumber=marker, loadVector=[0.0, 0.0, torque])),
        ]

    def settings(self) -> Any:
        """Return settings of both solvers that write no files and converge as far as rounding allows."""
        settings = _exudyn().SimulationSettings()
        settings.solution.file.write = False
        settings.linearSolver.solverType = _exudyn().LinearSolverType.EigenSparse
        settings.parallel.numberOfThreads = 1
        for solver in (settings.staticSolver, settings.timeIntegration):
            solver.verboseMode = 0
            solver.newton.relativeTolerance, solver.newton.absoluteTolerance = 1e-10, 1e-12
        return settings

    def rest(self, load_steps: int = 10) -> np.ndarray:
        """Return where the last node is in equilibrium, (2,)."""
        self.system.Assemble()
        settings = self.settings()
        settings.staticSolver.numberOfLoadSteps = load_steps
        self.system.SolveStatic(settings)
        return self.place(-1)

    def run(
        self,
        start: float,
        end: float,
        steps: int,
        *,
        clock: Callable[[], float] = time.perf_counter,
        loose: float = 1.0,
        sparse: bool = True,
    ) -> float:
        """Run Newmark's trapezoidal rule with index-2 constraints, and return the seconds it took.

        `loose` multiplies the tolerances of Newton's method, which is modified with sparse matrices and full with dense
        ones: the faster combinations. A further run goes on where this one ends.
        """
        settings = self.settings()
        times = settings.timeIntegration
        times.startTime, times.endTime, times.numberOfSteps = start, end, steps
        times.newton.relativeTolerance *= loose
        times.newton.absoluteTolerance *= loose
        times.newton.useModifiedNewton = sparse
        if not sparse:
            settings.linearSolver.solverType = _exudyn().LinearSolverType.EXUdense
        times.generalizedAlpha.spectralRadius = 1.0
        times.generalizedAlpha.useNewmark = True
        times.generalizedAlpha.useIndex2Constraints = True
        begin = clock()
        self.system.SolveDynamic(settings)
        taken = clock() - begin
        state = self.system.systemData.GetSystemState()
        self.system.systemData.SetSystemState(state, configuration=_exudyn().ConfigurationType.Initial)
        return taken

    def place(self, node: int) -> np.ndarray:
        """Return where a node is now, (2,)."""
        kind = _exudyn().OutputVariableType.Position
        return np.array(self.system.GetNodeOutput(self.nodes[node], kind)[:2])


def _between(ends: Ends, elements: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the nodes (n + 1, 2), and the vector from end to end."""
    a, b = (np.array(end) for end in ends)
    return a + np.linspace(0, 1, elements + 1)[:, None] * (b - a), b - a


def straight_beam(
    ends: Ends, elements: int, stiffness: tuple[float, float, float], inertia: tuple[float, float] = (1.0, 1.0)
) -> ExudynBeams:
    """Return a beam of `ObjectBeamGeometricallyExact2D`, of two nodes each.

    Stiffnesses are axial, shear and bending; inertias are mass and moment of inertia per length.
    """
    places, along = _between(ends, elements)
    angle = float(np.arctan2(along[1], along[0]))
    beam = ExudynBeams([[*place, angle] for place in places.tolist()])
    beam.fill(
        beam.items.NodeRigidBody2D,
        beam.items.ObjectBeamGeometricallyExact2D,
        length=float(np.linalg.norm(along)) / elements,
        massPerLength=inertia[0],
        crossSectionInertia=inertia[1],
        axialStiffness=stiffness[0],
        shearStiffness=stiffness[1],
        bendingStiffness=stiffness[2],
    )
    return beam


def cable(ends: Ends, elements: int, stiffness: tuple[float, float], mass: float) -> ExudynBeams:
    """Return a cable of `ObjectANCFCable2D`, with axial and bending stiffness and a mass per length."""
    places, along = _between(ends, elements)
    slope = (along / np.linalg.norm(along)).tolist()
    beam = ExudynBeams([[*place, *slope] for place in places.tolist()])
    beam.fill(
        beam.items.NodePoint2DSlope1,
        beam.items.ObjectANCFCable2D,
        length=float(np.linalg.norm(along)) / elements,
        massPerLength=mass,
        axialStiffness=stiffness[0],
        bendingStiffness=stiffness[1],
    )
    return beam
