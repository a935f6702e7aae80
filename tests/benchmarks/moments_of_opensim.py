"""`python -m tests.benchmarks.moments_of_opensim FOLDER`: moments of joints in two walks, beside those of OpenSim 4.6.

Needs `pip install opensim`, which mbdkit does not use. FOLDER has published files, which are not part of mbdkit; from
https://github.com/opensim-org/opensim-models, subject01_walk1.trc, subject01_walk1_grf.mot, subject01_static.trc and
subject01_Setup_IK.xml (Pipelines/Gait2354_Simbody), subject01_simbody.osim (Models/Gait2354_Simbody) and
static_walk_1.trc (Pipelines/Rajagopal/ExpData); from https://github.com/opensim-org/opensim-core, markers_walk.trc,
grf_walk.mot, ik_tasks_walk.xml and subject_walk_scaled.osim (OpenSim/Examples/Moco/example3DWalking).

OpenSim fits a model that its authors scaled to the person to all markers, and computes moments in three dimensions;
mbdkit gets the markers of pelvis and legs. Motion and loads are filtered alike.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import opensim

import mbdkit
from mbdkit.plugin import show
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.smoothing import low_passed
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Butterworth
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec

FILTER = Butterworth(name="butterworth", cutoff=6.0)
SIDES = {"": "r", "_left": "l"}
JOINTS = {"hip": ("hip_flexion", "femur", "hip_flexion", 1.0), "knee": ("knee_angle", "tibia", "knee_flexion", -1.0),
          "ankle": ("ankle_angle", "talus", "ankle_dorsiflexion", 1.0)}  # fmt: skip
"""By joint: coordinate and distal body in OpenSim, coordinate in mbdkit, its sign as a rotation counter-clockwise."""


KINDS = {"force": ("force", "v"), "point": ("force", "p"), "torque": ("torque", "")}  # parts of headings of plates


class Walk(NamedTuple):
    """A published walk: its files, headings of plates under the right and the left foot, parts of the spec, the sign of
    flexion in the angle of the knee of OpenSim, and times between which all forces on the left foot are measured.
    """

    title: str
    files: tuple[str, str, str, str, str]
    plates: tuple[str, str]
    subject: Mapping[str, Any]
    motion: Mapping[str, Any]
    knee: float
    left: tuple[float, float] = (0.0, np.inf)


def clusters(trunk: str, **legs: str) -> dict[str, list[str]]:
    """Return the clusters of both legs from names of markers that R. and L. precede, and that of the trunk."""
    own = {body + leg: [f"{side.upper()}.{name}" for name in names.split()]
           for leg, side in SIDES.items() for body, names in legs.items()}  # fmt: skip
    return {"trunk": trunk.split(), **own}


WALKS = (
    Walk("gait2354, on a treadmill",
         ("subject01_walk1.trc", "subject01_static.trc", "subject01_walk1_grf.mot", "subject01_Setup_IK.xml",
          "subject01_simbody.osim"),
         ("ground_{}_{}", "1_ground_{}_{}"), {"mass": 72.6, "height": 1.8034, "sex": "male"},  # the sex is assumed
         {"belt": 1.134,  # median velocity of the markers of feet that stand flat
          "clusters": clusters("R.ASIS L.ASIS V.Sacral", thigh="Thigh.Upper Thigh.Front Thigh.Rear",
                               shank="Shank.Upper Shank.Front Shank.Rear",
                               foot="Heel Midfoot.Sup Midfoot.Lat Toe.Tip Toe.Lat Toe.Med")}, -1.0),
    Walk("example3DWalking, over ground",
         ("markers_walk.trc", "static_walk_1.trc", "grf_walk.mot", "ik_tasks_walk.xml", "subject_walk_scaled.osim"),
         ("ground_{}_r_{}", "ground_{}_l_{}"), {"mass": 85.0668, "height": 1.829, "sex": "male"},
         {"clusters": clusters("R.ASIS L.ASIS R.PSIS L.PSIS S2", thigh="TH1 TH2 TH3", shank="SH1 SH2 SH3",
                               foot="Heel MT5 Toe"),
          "centers": {f"{name.lower()}{leg}": {"midpoint": [f"{side.upper()}.{name}", f"{side.upper()}.M{name}"]}
                      for name in ("Knee", "Ankle") for leg, side in SIDES.items()}}, 1.0, (0.51, 1.91)),
)  # fmt: skip


def plates_of(walk: Walk, folder: Path, time: np.ndarray) -> Iterator[dict[str, np.ndarray]]:
    """Yield force [N], point [m], nan without force, and torque [N m] of each plate, (T, 3) each."""
    table = read_table(folder / walk.files[2], "")
    rows = np.argmin(np.abs(table.column("time", "")[:, None] - time), axis=0)
    for heading in walk.plates:
        own = {kind: np.stack([table.column(heading.format(*at) + axis, "")[rows] for axis in "xyz"], axis=1)
               for kind, at in KINDS.items()}  # fmt: skip
        yield own | {"point": np.where(np.any(own["force"] != 0, axis=1)[:, None], own["point"], np.nan)}


def spec_of(walk: Walk, folder: Path, **motion: Any) -> dict[str, Any]:
    """Return the spec of a walk; `motion` has further keys of this section."""
    table = read_table(folder / walk.files[0], "")
    data = {name: table.column(name, "") / 1000 for name in table.headings if name[-2:] in (".x", ".y", ".z")}
    data |= {"time": table.column("time", "")}
    for number, plate in enumerate(plates_of(walk, folder, data["time"]), 1):
        data |= {f"plate{number}.{kind}.{axis}": plate[kind][:, k] for kind in KINDS for k, axis in enumerate("xyz")}
    own = {"data": data, "static": str((folder / walk.files[1]).resolve()), "smooth": FILTER.model_dump()}
    return {"mbdkit": 1, "title": walk.title, "subject": dict(walk.subject), "motion": own | {**walk.motion, **motion},
            "model": {"name": "leg", "legs": 2, "root": "trunk"}}  # fmt: skip


def write_table(file: Path, time: np.ndarray, columns: Mapping[str, np.ndarray]) -> str:
    """Write columns (T,) as a .mot file, with rotations in degrees, and return its name."""
    rows = np.column_stack([time, *columns.values()])
    head = f"{file.stem}\nversion=1\nnRows={len(rows)}\nnColumns={rows.shape[1]}\ninDegrees=yes\nendheader\n"
    np.savetxt(file, rows, "%.12g", "\t", header=head + "\t".join(["time", *columns]), comments="")
    return str(file)


def reference_of(walk: Walk, folder: Path, work: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Compute a walk with OpenSim by way of files in a folder `work`, and return by joint: flexion moment (T,) [N m],
    and the point (T, 3) nearest to the origin of the distal body about which this body turns [m].
    """
    markers, _, _, tasks, osim = (str(folder / name) for name in walk.files)
    time, model = read_table(Path(markers), "").column("time", ""), opensim.Model(osim)
    model.initSystem()
    span = {"Model": model, "StartTime": float(time[0]), "EndTime": float(time[-1]), "ResultsDir": str(work)}
    fit = opensim.InverseKinematicsTool(*([tasks, False] if "Setup_IK" in tasks else []))
    if "Setup_IK" not in tasks:
        fit.set_IKTaskSet(opensim.IKTaskSet(tasks))
    run(fit, **span, MarkerDataFileName=markers, OutputMotionFileName=str(work / "fitted.mot"))
    fitted = read_table(work / "fitted.mot", "")
    columns = {name: low_passed(time, fitted.column(name, "")[:, None], FILTER)[:, 0] for name in fitted.headings[1:]}
    motion, loads = write_table(work / "motion.mot", time, columns), opensim.ExternalLoads()
    forces: dict[str, np.ndarray] = {}
    for side, plate in zip("rl", plates_of(walk, folder, time), strict=True):
        force, one = plate["force"], opensim.ExternalForce()
        moment = np.nan_to_num(np.cross(plate["point"], force)) + plate["torque"]  # about the origin, the point below
        values = low_passed(time, np.hstack([force, 0 * force, moment]), FILTER).T
        forces |= dict(zip([f"{side}_{kind}_{axis}" for kind in KINDS for axis in "xyz"], values, strict=True))
        one.setName(side)
        one.set_applied_to_body(f"calcn_{side}")
        for kind in KINDS:
            getattr(one, f"set_{kind}_identifier")(f"{side}_{kind}_")
        loads.cloneAndAppend(one)
    loads.setDataFileName(write_table(work / "loads.mot", time, forces))
    loads.printToXML(file := str(work / "loads.xml"))
    files = {"CoordinatesFileName": motion, "ExternalLoadsFileName": file, "OutputGenForceFileName": "moments.sto"}
    run(opensim.InverseDynamicsTool(), **span, **files, ExcludedForces=opensim.ArrayStr("Muscles", 1))
    table, found = read_table(work / "moments.sto", ""), {}
    for joint, (coordinate, body, _, _) in JOINTS.items():
        for leg, side in SIDES.items():
            moment = (walk.knee if joint == "knee" else 1.0) * table.column(f"{coordinate}_{side}_moment", "")
            found[joint + leg] = moment, points_of(model, columns, f"{coordinate}_{side}", f"{body}_{side}")
    return found


def run(tool: Any, **settings: Any) -> None:
    """Run a tool of OpenSim with settings."""
    for name, value in settings.items():
        getattr(tool, f"set{name}")(value)
    tool.run()


def points_of(model: Any, columns: Mapping[str, np.ndarray], name: str, body: str) -> np.ndarray:
    """Return the points (T, 3) nearest to the origin of a body about which it turns with a coordinate [m]."""
    state, coordinates, moving, found = model.initSystem(), model.getCoordinateSet(), model.getBodySet().get(body), []
    coordinates.get(name).setSpeedValue(state, 1.0)  # all others rest
    for row in zip(*columns.values(), strict=True):
        for key, value in zip(columns, row, strict=True):
            one = coordinates.get(key)
            is_angle = one.getMotionType() == opensim.Coordinate.Rotational
            one.setValue(state, float(np.radians(value) if is_angle else value), False)
        model.realizeVelocity(state)
        values = ("Position", "LinearVelocity", "AngularVelocity")
        place, speed, turn = (getattr(moving, f"get{what}InGround")(state).to_numpy() for what in values)
        found.append(place + np.cross(turn, speed) / (turn @ turn))
    return np.array(found)


def lines_of(walk: Walk, folder: Path, **motion: Any) -> Iterator[str]:
    """Yield the lines of the table of a walk; one period of the cutoff is left out at both ends of the record."""
    spec, end = spec_of(walk, folder, **motion), 1 / FILTER.cutoff
    with tempfile.TemporaryDirectory() as work:
        reference = reference_of(walk, folder, Path(work))
    yield f"\n{walk.title}: difference [N m], share of the largest, instants in bars, half width of bars [N m];"
    yield f"{'':12}our centre less theirs, forward and up [mm]; difference about their centre, share, in bars"
    with mbdkit.inverse(spec) as ours:
        for name, (moment, point) in reference.items():
            joint, time = name.removesuffix("_left"), ours.time
            *_, flexion, sign = JOINTS[joint]
            actuator, force = ours.actuators[flexion + name.removeprefix(joint)], ours.joints[name].reaction_force
            first, last = walk.left if name.endswith("_left") else (0.0, np.inf)
            own = (time > max(first, time[0] + end)) & (time < min(last, time[-1] - end))
            center = [ours.motion[f"markers.{'hip' if joint == 'hip' else name}.{axis}"].fitted for axis in "xy"]
            gap = np.stack(center, axis=1) - load_inverse_spec(spec).person.plane.coordinates(point)[:, :2]
            moved = sign * (gap[:, 0] * force[:, 1] - gap[:, 1] * force[:, 0])
            bar, peak, (x, y) = actuator.value_error[own], np.max(np.abs(moment[own])), 1000 * np.mean(gap[own], axis=0)
            errors = [(actuator.value + change - moment)[own] for change in (0.0, moved)]
            sizes = [(one, np.sqrt(np.mean(one * one))) for one in errors]
            parts = [f"{rms:7.1f}{rms / peak:5.0%}{np.mean(np.abs(one) <= bar):5.0%}" for one, rms in sizes]
            yield f"{name:12}{parts[0]}{np.median(bar):6.1f}{x:7.0f}{y:5.0f}{parts[1]}"


if __name__ == "__main__":
    opensim.Logger.setLevelString("Error")
    opensim.Logger.removeFileSink()
    show("\n".join([line for walk in WALKS for line in lines_of(walk, Path(sys.argv[1]))]))
