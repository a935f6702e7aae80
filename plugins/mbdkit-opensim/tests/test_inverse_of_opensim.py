"""Inverse dynamics compared with OpenSim, where its package is installed, and files converted in both directions."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import osim_texts as osim
import pytest

import mbdkit
from mbdkit_opensim.building import build_mechanism
from mbdkit_report.export import export

needs_opensim = pytest.mark.skipif(
    not importlib.util.find_spec("opensim"), reason="the package opensim is not installed"
)

T = np.linspace(0.0, 1.0, 101)
MOTION = {  # mean, amplitude, angular frequency and phase of each coordinate
    "pelvis_tilt": (0.1, 0.2, 3.0, 0.3), "pelvis_tx": (0.2, 0.4, 2.0, 0.0), "pelvis_ty": (0.9, 0.05, 7.0, 1.0),
    "hip_flexion": (0.3, 0.4, 4.0, 0.7), "knee_angle": (-1.0, 0.7, 5.0, 0.2), "ankle_angle": (0.0, 0.3, 6.0, 1.3),
    "rail_x": (0.0, 0.2, 5.0, 0.4), "swing": (0.5, 1.5, 3.0, 2.0),
}  # fmt: skip
ROTATIONS = ("pelvis_tilt", "hip_flexion", "knee_angle", "ankle_angle", "swing")


def derivatives(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return value, rate and acceleration of a coordinate at all times."""
    mean, size, omega, phase = MOTION[name]
    turn = omega * T + phase
    return mean + size * np.sin(turn), size * omega * np.cos(turn), -size * omega**2 * np.sin(turn)


def columns() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the motion with its exact derivatives, as data and as the `columns` of a spec."""
    data, named = {"time": T}, {}
    for name in MOTION:
        keys = (name, f"{name}_u", f"{name}_a")
        data |= dict(zip(keys, derivatives(name), strict=True))
        named[name] = {"column": name, "rate": keys[1], "acceleration": keys[2]}
    return data, named


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    path = tmp_path / "leg.osim"
    path.write_text(osim.leg())
    return path


@pytest.fixture
def run(leg: Path) -> mbdkit.Run:
    data, named = columns()
    model = {"name": "opensim", "file": str(leg), "initial": {name: float(derivatives(name)[0][0]) for name in MOTION}}
    return mbdkit.inverse({"mbdkit": 1, "model": model, "motion": {"data": data, "columns": named}})


class Witness:
    """The leg in OpenSim under the prescribed motion: generalized forces, and the reactions under these forces."""

    def __init__(self, path: Path):
        import opensim

        opensim.Logger.setLevelString("error")
        self.opensim, self.model = opensim, opensim.Model(str(path))
        for name in MOTION:
            actuator = opensim.CoordinateActuator(name)
            actuator.setName(f"act_{name}")
            actuator.setOptimalForce(1.0)
            self.model.addForce(actuator)
        self.state = self.model.initSystem()
        self.solver = opensim.InverseDynamicsSolver(self.model)
        for place, name in enumerate(MOTION):
            self.model.updCoordinateSet().get(name).setSpeedValue(self.state, place + 1.0)
        speeds = self.state.getU()
        self.order = [list(MOTION)[round(speeds.get(place)) - 1] for place in range(len(MOTION))]

    def actuate(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            actuator = self.opensim.ScalarActuator.safeDownCast(self.model.updForceSet().get(f"act_{name}"))
            actuator.overrideActuation(self.state, True)
            actuator.setOverrideActuation(self.state, value)

    def forces(self, row: int) -> dict[str, float]:
        """Return the generalized force of each coordinate."""
        self.actuate(dict.fromkeys(MOTION, 0.0))
        coordinates = self.model.updCoordinateSet()
        for name in MOTION:
            value, rate, _ = derivatives(name)
            coordinates.get(name).setValue(self.state, float(value[row]), False)
            coordinates.get(name).setSpeedValue(self.state, float(rate[row]))
        udot = self.opensim.Vector(len(self.order), 0.0)
        for place, name in enumerate(self.order):
            udot.set(place, float(derivatives(name)[2][row]))
        found = self.solver.solve(self.state, udot)
        return {name: found.get(place) for place, name in enumerate(self.order)}

    def reactions(self, row: int, joints: list[str]) -> dict[str, list[float]]:
        """Return the force and torque that each joint, together with its actuator, exerts on the child body, at the
        child frame.
        """
        self.actuate(self.forces(row))
        self.model.realizeAcceleration(self.state)
        found = {}
        for name in joints:
            both = self.model.getJointSet().get(name).calcReactionOnChildExpressedInGround(self.state)
            found[name] = [both.get(1).get(0), both.get(1).get(1), both.get(0).get(2)]
        return found


@needs_opensim
def test_generalized_forces_are_those_of_opensim(run: mbdkit.Run, leg: Path) -> None:
    assert set(run.actuators) == set(MOTION)
    witness = Witness(leg)
    rows = range(0, len(T), 5)
    expected = [witness.forces(row) for row in rows]
    for name in MOTION:
        exact = np.array([one[name] for one in expected])
        peak = np.max(np.abs(exact))
        np.testing.assert_allclose(run.actuators[name].value[::5], exact, rtol=0, atol=1e-6 * peak, err_msg=name)


DRIVEN = {"hip": "hip_flexion", "knee": "knee_angle", "ankle": "ankle_angle", "shoulder": "swing"}


@needs_opensim
def test_joint_reactions_are_those_of_opensim(run: mbdkit.Run, leg: Path) -> None:
    # In OpenSim, the reaction of a joint includes the generalized force of its coordinate.
    witness, rows = Witness(leg), range(0, len(T), 5)
    names = list(run.joints)
    expected = [witness.reactions(row, names) for row in rows]
    mechanism = build_mechanism(str(leg), {}, {})
    along = np.arctan2(*mechanism.joints["rail"].axis[::-1]) + run.bodies["pelvis"].angle
    for name in names:
        exact = np.array([one[name] for one in expected])
        force, torque = run.joints[name].reaction_force, run.joints[name].reaction_torque
        if name in DRIVEN:
            torque = torque + run.actuators[DRIVEN[name]].value * mechanism.coordinates[DRIVEN[name]].scale
        elif name == "rail":
            push = run.actuators["rail_x"].value * mechanism.coordinates["rail_x"].scale
            force = force + push[:, None] * np.stack([np.cos(along), np.sin(along)], axis=1)
        for found, true in ((force[::5], exact[:, :2]), (torque[::5], exact[:, 2])):
            np.testing.assert_allclose(found, true, rtol=0, atol=1e-6 * np.max(np.abs(true)), err_msg=name)


@needs_opensim
def test_a_table_of_opensim_is_read_and_one_of_mbdkit_is_read_by_opensim(leg: Path, tmp_path: Path) -> None:
    import opensim

    table = opensim.TimeSeriesTable()
    table.setColumnLabels(list(MOTION))
    values = np.column_stack([derivatives(name)[0] for name in MOTION])
    degrees = values * [180 / np.pi if name in ROTATIONS else 1.0 for name in MOTION]
    for time, row in zip(T, degrees, strict=True):
        table.appendRow(float(time), opensim.RowVector(row.tolist()))
    table.addTableMetaDataString("inDegrees", "yes")
    opensim.STOFileAdapter.write(table, str(tmp_path / "motion.sto"))

    model = {"name": "opensim", "file": str(leg)}
    motion = {"file": str(tmp_path / "motion.sto"), "smooth": "quintic"}
    run = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": motion}, archive=tmp_path / "load.h5")
    for name in MOTION:
        np.testing.assert_allclose(run.motion[name].raw, derivatives(name)[0], rtol=0, atol=1e-12, err_msg=name)
    export(run, tmp_path / "tables", "sto")
    back = opensim.TimeSeriesTable(str(tmp_path / "tables" / "actuators.sto"))
    np.testing.assert_allclose(np.array(back.getIndependentColumn()), T, rtol=0, atol=1e-15)
    for name in MOTION:
        label = next(one for one in back.getColumnLabels() if one.startswith(name) and "power" not in one)
        np.testing.assert_allclose(back.getDependentColumn(label).to_numpy(), run.actuators[name].value, rtol=1e-14)
