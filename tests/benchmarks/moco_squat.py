"""A squat-to-stand of Moco: reads the leg from standard input, prints the optimum; for a Python that has `opensim`.

Defaults of Moco hold except for tolerances and one process: Hermite-Simpson collocation, central differences, IPOPT.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import opensim as osim


def leg(data: dict[str, Any]) -> osim.Model:
    """Return a chain of bodies with pins and a torque actuator at each pin."""
    model = osim.Model()
    model.set_gravity(osim.Vec3(0, -data["gravity"], 0))
    bodies = {"ground": model.getGround()}
    for name, (mass, inertia) in data["bodies"].items():
        bodies[name] = osim.Body(name, mass, osim.Vec3(0), osim.Inertia(0.1 * inertia, 0.1 * inertia, inertia))
        model.addBody(bodies[name])
    for name, (first, at, second, point, largest) in data["joints"].items():
        ends = bodies[first], osim.Vec3(*at, 0), osim.Vec3(0), bodies[second], osim.Vec3(*point, 0), osim.Vec3(0)
        pin = osim.PinJoint(name, *ends)
        pin.updCoordinate().setName(name)
        model.addJoint(pin)
        motor = osim.CoordinateActuator()
        motor.setName(f"{name}_motor")
        motor.setCoordinate(pin.updCoordinate())
        motor.setOptimalForce(largest)
        motor.setMinControl(-1)
        motor.setMaxControl(1)
        model.addForce(motor)
    model.finalizeConnections()
    return model


def main() -> None:
    """Solve on the mesh of the first argument, and print objective, iterations and times."""
    osim.Logger.setLevelString("Error")
    data = json.load(sys.stdin)
    study = osim.MocoStudy()
    problem = study.updProblem()
    problem.setModel(leg(data))
    problem.setTimeBounds(osim.MocoInitialBounds(0.0), osim.MocoFinalBounds(data["duration"]))
    for name, (start, end) in data["ends"].items():
        problem.setStateInfo(f"/jointset/{name}/{name}/value", [-3, 3], start, end)
        problem.setStateInfo(f"/jointset/{name}/{name}/speed", [-50, 50], 0, 0)
    problem.addGoal(osim.MocoControlGoal("effort", 1))
    solver = study.initCasADiSolver()
    solver.set_num_mesh_intervals(int(sys.argv[1]))
    solver.set_optim_convergence_tolerance(1e-6)
    solver.set_optim_constraint_tolerance(1e-6)
    solver.set_verbosity(0)
    solver.set_parallel(0)
    wall, cpu = time.perf_counter(), time.process_time()
    solution = study.solve()
    result = {
        "objective": solution.getObjective(), "success": solution.success(), "iterations": solution.getNumIterations(),
        "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu,
    }  # fmt: skip
    print(json.dumps(result))


if __name__ == "__main__":
    main()
