"""A flexible rod that hangs from a pin, stretched by its weight, and is let go of at 5 rad/s; also in Exudyn.

It starts in the state of a rod that turns at this speed forever, so that its motion is smooth from the start.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

import mbdkit

AXIAL, SHEAR, BENDING = 1e4, 5e3, 2.0
MASS, INERTIA = 1.0, 2e-4
GRAVITY, OMEGA = 9.81, 5.0


def depth(s: np.ndarray) -> np.ndarray:
    """Return how far below the pin the cross-sections start: EA x'' = -rho A (omega^2 x + g), x(0) = 0, x'(1) = 1."""
    k = OMEGA * np.sqrt(MASS / AXIAL)
    fall = GRAVITY / OMEGA**2
    return np.asarray(fall * (np.cos(k * s) - 1) + (1 / k + fall * np.sin(k)) / np.cos(k) * np.sin(k * s))


def rod(elements: int, nodes: Literal[2, 3]) -> mbdkit.Mechanism:
    """Return the rod."""
    m = mbdkit.Mechanism(gravity=(0.0, -GRAVITY))
    below = depth(np.linspace(0.0, 1.0, elements * (nodes - 1) + 1))
    m.beam(
        "rod", a=(0, 0), b=(0, -1), elements=elements, nodes=nodes, mass_per_length=MASS, rotary_inertia=INERTIA,
        stiffness={"axial": AXIAL, "shear": SHEAR, "bending": BENDING}, angular_velocity=OMEGA,
        start=[(0.0, -y, -np.pi / 2) for y in below.tolist()],
    )  # fmt: skip
    m.revolute("pin", m.ground, "rod.0", at=(0, 0))
    return m


class ExudynBeam:
    """A straight beam of `ObjectBeamGeometricallyExact2D`, of two nodes each, in a system of its own."""

    def __init__(
        self,
        ends: tuple[Sequence[float], Sequence[float]],
        elements: int,
        stiffness: tuple[float, float, float],
        inertia: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """Make nodes and elements; stiffnesses are axial, shear and bending, inertias those per length."""
        self.items: Any = importlib.import_module("exudyn.itemInterface")
        self.exudyn: Any = importlib.import_module("exudyn")
        self.system = self.exudyn.SystemContainer().AddSystem()
        a, b = (np.array(end) for end in ends)
        angle = float(np.arctan2(*(b - a)[::-1]))
        self.places = [[*(a + (b - a) * i / elements).tolist(), angle] for i in range(elements + 1)]
        self.nodes = [self.system.AddNode(self.items.NodeRigidBody2D(referenceCoordinates=at)) for at in self.places]
        axial, shear, bending = stiffness
        self.elements = [
            self.system.AddObject(
                self.items.ObjectBeamGeometricallyExact2D(
                    nodeNumbers=list(pair), length=float(np.linalg.norm(b - a)) / elements,
                    massPerLength=inertia[0], crossSectionInertia=inertia[1],
                    axialStiffness=axial, shearStiffness=shear, bendingStiffness=bending,
                )
            )
            for pair in zip(self.nodes, self.nodes[1:], strict=False)
        ]  # fmt: skip

    def start(self, places: Sequence[Sequence[float]], velocities: Sequence[Sequence[float]]) -> None:
        """Let the nodes start at these places (x, y, angle) with these velocities."""
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
        settings = self.exudyn.SimulationSettings()
        settings.solution.file.write = False
        settings.linearSolver.solverType = self.exudyn.LinearSolverType.EigenSparse
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
            settings.linearSolver.solverType = self.exudyn.LinearSolverType.EXUdense
        times.generalizedAlpha.spectralRadius = 1.0
        times.generalizedAlpha.useNewmark = True
        times.generalizedAlpha.useIndex2Constraints = True
        begin = clock()
        self.system.SolveDynamic(settings)
        taken = clock() - begin
        state = self.system.systemData.GetSystemState()
        self.system.systemData.SetSystemState(state, configuration=self.exudyn.ConfigurationType.Initial)
        return taken

    def place(self, node: int) -> np.ndarray:
        """Return where a node is now, (2,)."""
        kind = self.exudyn.OutputVariableType.Position
        return np.array(self.system.GetNodeOutput(self.nodes[node], kind)[:2])


def exudyn_rod(elements: int) -> ExudynBeam:
    """Return the rod in Exudyn."""
    beam = ExudynBeam(((0.0, 0.0), (0.0, -1.0)), elements, (AXIAL, SHEAR, BENDING), (MASS, INERTIA))
    below = depth(np.linspace(0.0, 1.0, elements + 1)).tolist()
    beam.start([(0.0, -y, -np.pi / 2) for y in below], [(OMEGA * y, 0.0, OMEGA) for y in below])
    beam.hold(0, 1)
    beam.weigh(GRAVITY)
    beam.system.Assemble()
    return beam
