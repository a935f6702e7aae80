"""``python -m tests.benchmarks.muscles_of_opensim FILE.json``: muscles of a planar leg by OpenSim 4.6, as reference
numbers of `tests.muscles`.

Needs ``pip install opensim==4.6``, which mbdkit does not use. The leg is that of `tests.muscles.leg`: two bodies whose
frames have their origins at their centres of mass, hip and knee turn about z. Lengths, moment arms and forces are those
of OpenSim at given angles and angular velocities; `recruitment` is the result of its tool for static optimization.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import opensim as osim
from tests.muscles.leg import ANGLES, BODIES, HIP, HOLDING, KNEE, MUSCLES, POSTURES, RECRUITED, motion

osim.Logger.setLevelString("Error")
V = osim.Vec3
KEPT = []
"""Objects that belong to the model, which Python would delete."""


def model(muscles=MUSCLES):
    """Return the leg."""
    leg = osim.Model()
    leg.setGravity(V(0, -9.81, 0))
    frames = {"ground": leg.getGround()}
    for name, (mass, inertia) in BODIES.items():
        frames[name] = osim.Body(name, mass, V(0), osim.Inertia(inertia, inertia, inertia))
        leg.addBody(frames[name])
    for name, (a, at_a), (b, at_b) in (("hip", *HIP), ("knee", *KNEE)):
        joint = osim.PinJoint(name, frames[a], V(*at_a, 0), V(0), frames[b], V(*at_b, 0), V(0))
        joint.updCoordinate().setName(name)
        leg.addJoint(joint)
    for name, data in muscles.items():
        leg.addForce(muscle(leg, name, data, frames))
    leg.finalizeConnections()
    return leg


def muscle(leg, name, data, frames):
    """Return a muscle of the leg."""
    kind = osim.Millard2012EquilibriumMuscle if data.get("curves") == "millard" else osim.DeGrooteFregly2016Muscle
    one = kind()
    one.setName(name)
    one.setMaxIsometricForce(data["max_force"])
    one.setOptimalFiberLength(data["optimal_length"])
    one.setTendonSlackLength(data["tendon_length"])
    one.setPennationAngleAtOptimalFiberLength(data.get("pennation", 0.0))
    one.setMaxContractionVelocity(10.0)
    one.set_ignore_tendon_compliance(True)
    one.set_fiber_damping(0.0)
    path, points = one.updGeometryPath(), KEPT
    for index, item in enumerate(data["path"]):
        if "wrap" in item:
            circle = item["wrap"]
            cylinder = osim.WrapCylinder()
            cylinder.setName(f"{name}_{index}")
            cylinder.set_radius(circle["radius"])
            cylinder.set_length(1.0)
            cylinder.set_translation(V(*circle["center"], 0))
            cylinder.set_quadrant(data["quadrant"])
            cylinder.setFrame(frames[circle["body"]])
            frames[circle["body"]].addWrapObject(cylinder)
            path.addPathWrap(cylinder)
            continue
        x, y, z = (*item["point"], 0.0)[:3]
        if "when" in item:
            ((coordinate, (low, high)),) = item["when"].items()
            point = osim.ConditionalPathPoint()
            point.setRangeMin(low)
            point.setRangeMax(high)
            point.setCoordinate(leg.getJointSet().get(coordinate.partition(".")[0]).getCoordinate())
        elif isinstance(x, str):
            point = osim.MovingPathPoint()
            numbers = data["polynomial"]
            for axis in "xyz":
                getattr(point, f"set_{axis}_location")(osim.PolynomialFunction(osim.Vector(numbers[axis])))
                getattr(point, f"set{axis.upper()}Coordinate")(leg.getJointSet().get("knee").getCoordinate())
        else:
            point = osim.PathPoint()
        point.setName(f"{name}-{index}")
        point.setParentFrame(frames[item["body"]])
        if not isinstance(x, str):
            point.setLocation(V(x, y, z))
        points.append(point)
        path.updPathPointSet().adoptAndAppend(point)
    return one


def geometry(leg):
    """Return lengths, rates, moment arms and largest active forces of all muscles in all poses."""
    state = leg.initSystem()
    coordinates = [leg.getCoordinateSet().get(name) for name in ("hip", "knee")]
    found = {name: {"length": [], "rate": [], "arms": [], "capacity": [], "passive": []} for name in MUSCLES}
    for hip, knee, hip_rate, knee_rate in ANGLES:
        for coordinate, value, rate in zip(coordinates, (hip, knee), (hip_rate, knee_rate), strict=True):
            coordinate.setValue(state, value, False)
            coordinate.setSpeedValue(state, rate)
        leg.realizeVelocity(state)
        for name, one in found.items():
            force = osim.Muscle.safeDownCast(leg.getMuscles().get(name))
            one["length"].append(force.getLength(state))
            one["rate"].append(force.getLengtheningSpeed(state))
            one["arms"].append([force.computeMomentArm(state, coordinate) for coordinate in coordinates])
            force.setActivation(state, 1.0)
            leg.realizeDynamics(state)
            one["capacity"].append(force.getActiveFiberForceAlongTendon(state))
            share = force.getPassiveForceMultiplier(state) * force.getCosPennationAngle(state)
            one["passive"].append(force.getMaxIsometricForce() * share)
    return found


def recruitment():
    """Return activations by OpenSim's static optimization of the motion of `leg.motion`, without pennation.

    The largest forces of its tool have no cosine of the pennation angle, unlike the forces of its muscles.
    """
    leg = model({name: MUSCLES[name] | {"pennation": 0.0, "curves": "millard"} for name in RECRUITED})
    time, q = motion()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        leg.printToXML(str(path / "leg.osim"))
        lines = [
            "motion",
            "version=1",
            f"nRows={len(time)}",
            "nColumns=3",
            "inDegrees=no",
            "endheader",
            "time\thip\tknee",
        ]
        lines += ["\t".join(f"{x:.17g}" for x in (t, *row)) for t, row in zip(time, q, strict=True)]
        (path / "leg.mot").write_text("\n".join(lines) + "\n")
        tool = osim.AnalyzeTool()
        tool.setName("so")
        tool.setModelFilename(str(path / "leg.osim"))
        tool.setCoordinatesFileName(str(path / "leg.mot"))
        tool.setLowpassCutoffFrequency(-1)
        tool.setStartTime(time[0])
        tool.setFinalTime(time[-1])
        tool.setResultsDir(str(path))
        own = osim.StaticOptimization()
        own.setStartTime(time[0])
        own.setEndTime(time[-1])
        own.setUseMusclePhysiology(True)
        own.setActivationExponent(2)
        own.setConvergenceCriterion(1e-8)
        own.setMaxIterations(1000)
        tool.updAnalysisSet().cloneAndAppend(own)
        tool.printToXML(str(path / "setup.xml"))
        osim.AnalyzeTool(str(path / "setup.xml")).run()
        table = osim.TimeSeriesTable(str(path / "so_StaticOptimization_activation.sto"))
        found = {name: list(table.getDependentColumn(name).to_numpy()) for name in RECRUITED}
        return {"time": list(table.getIndependentColumn()), "activation": found}


def postures():
    """Return the forces of two muscles that hold the leg at rest, and the forces in its joints.

    Accelerations are linear in the forces, so that three of them give the forces at which there are none.
    """
    leg = model({name: MUSCLES[name] for name in HOLDING})
    state = leg.initSystem()
    muscles = [leg.getMuscles().get(name) for name in HOLDING]
    found = []

    def accelerations(forces):
        for muscle, force in zip(muscles, forces, strict=True):
            muscle.overrideActuation(state, True)
            muscle.setOverrideActuation(state, float(force))
        leg.realizeAcceleration(state)
        return np.array([leg.getCoordinateSet().get(name).getAccelerationValue(state) for name in ("hip", "knee")])

    for angles in POSTURES:
        for name, value in zip(("hip", "knee"), angles, strict=True):
            leg.getCoordinateSet().get(name).setValue(state, value, False)
            leg.getCoordinateSet().get(name).setSpeedValue(state, 0.0)
        none = accelerations([0, 0])
        slopes = np.column_stack([accelerations(one) - none for one in np.eye(2)])
        forces = np.linalg.solve(slopes, -none)
        accelerations(forces)
        joints = {}
        for name in ("hip", "knee"):
            force = leg.getJointSet().get(name).calcReactionOnChildExpressedInGround(state).get(1)
            joints[name] = [force.get(0), force.get(1)]
        found.append({"muscles": dict(zip(HOLDING, forces.tolist(), strict=True)), "joints": joints})
    return found


ENERGETIC = [(0.3, 0.7), (0.6, 0.2), (0.05, 0.05), (0.9, 1.0)]
"""Activations and excitations whose energetics are compared."""


def energetics():
    """Return the power that muscles consume by OpenSim's models of Umberger (2010) and of Bhargava (2004), with 40 % of
    slow fibres.

    Work of lengthening fibres costs nothing in Umberger's published model; OpenSim has an option for it.
    """
    leg = model()
    other = osim.Bhargava2004SmoothedMuscleMetabolics()
    other.setName("bhargava")
    other.set_use_smoothing(False)
    other.set_use_force_dependent_shortening_prop_constant(True)
    for name in MUSCLES:
        other.addMuscle(name, leg.getMuscles().get(name), 0.4, 250000.0)
    leg.addComponent(other)
    probe = osim.Umberger2010MuscleMetabolicsProbe(True, True, False, True)
    probe.setName("power")
    probe.set_report_total_metabolics_only(False)
    probe.set_use_Bhargava_recruitment_model(False)
    probe.set_include_negative_mechanical_work(False)
    probe.set_forbid_negative_total_power(False)
    leg.addProbe(probe)
    for name in MUSCLES:
        probe.addMuscle(name, 0.4)
    state = leg.initSystem()
    coordinates = [leg.getCoordinateSet().get(name) for name in ("hip", "knee")]
    found = {name: {"length": [], "rate": [], "power": [], "bhargava": []} for name in MUSCLES}
    for k, (hip, knee, hip_rate, knee_rate) in enumerate(ANGLES):
        for coordinate, value, rate in zip(coordinates, (hip, knee), (hip_rate, knee_rate), strict=True):
            coordinate.setValue(state, value, False)
            coordinate.setSpeedValue(state, rate)
        activation, excitation = ENERGETIC[k % len(ENERGETIC)]
        for name in MUSCLES:
            osim.Muscle.safeDownCast(leg.getMuscles().get(name)).setActivation(state, activation)
        leg.realizeVelocity(state)
        leg.setControls(state, osim.Vector(len(MUSCLES), excitation))
        leg.realizeDynamics(state)
        values = probe.computeProbeInputs(state)
        for index, (name, one) in enumerate(found.items()):
            force = osim.Muscle.safeDownCast(leg.getMuscles().get(name))
            one["length"].append(force.getFiberLength(state))
            one["rate"].append(force.getFiberVelocity(state))
            one["power"].append(values.get(2 + index))
            one["bhargava"].append(other.getMuscleMetabolicRate(state, f"/forceset/{name}"))
    return found


if __name__ == "__main__":
    leg = model()
    numbers = {"opensim": osim.GetVersion(), "geometry": geometry(leg)}
    numbers["recruitment"] = recruitment()
    numbers["postures"] = postures()
    numbers["energetics"] = energetics()
    Path(sys.argv[1]).write_text(json.dumps(numbers) + "\n")
