"""Compares the equations of motion of a planar mechanism from MJCF or URDF with those of MuJoCo at drawn states."""

from __future__ import annotations

from typing import Any

import numpy as np

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion

SAME = 1e-6
"""Largest relative difference of masses and forces."""
U, W, NORMAL = np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, -1.0, 0])
"""The axes of the plane xz, and its normal."""


def mechanism(kind: str, file: str, **options: Any) -> mbdkit.Mechanism:
    """Return the mechanism of a file."""
    model = {"name": kind, "file": file, **options}
    return mbdkit.RunSpec(mbdkit=1, model=model, integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.1}).mechanism()


def differences(model: Any, kind: str, file: str, random: np.random.Generator) -> list[str]:
    """Return how the mechanism of a file differs from the model that MuJoCo made of it, with random coordinates and
    rates of joints. Constraints of MuJoCo are soft, so that motions are not compared.
    """
    import mujoco

    data = mujoco.MjData(model)
    joints = [model.joint(k) for k in range(model.njnt)]
    kinds = [int(kind) for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]
    scalar = [joint for joint in joints if int(joint.type[0]) in kinds]
    coordinates = mechanism(kind, file).coordinates
    labels = {}
    for joint in scalar:
        label = joint.name or f"{model.body(joint.bodyid[0]).name} joint"
        if label not in coordinates:
            return [f"MuJoCo has the joint '{label}', mbdkit has not"]
        labels[label] = joint
    if len(coordinates) != len(labels):
        return [f"mbdkit has the coordinates {list(coordinates)}, MuJoCo {list(labels)}"]
    if not model.nv:
        return []
    mujoco.mj_forward(model, data)
    is_closed = np.any(data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY))
    values = {label: 0.0 if is_closed else float(random.uniform(-1, 1)) for label in labels}
    rates = {label: float(random.choice([-1, 1]) * random.uniform(0.3, 2)) for label in labels}
    for label, joint in labels.items():
        data.qpos[joint.qposadr[0]] = values[label]
        data.qvel[joint.dofadr[0]] = rates[label]
    mujoco.mj_forward(model, data)
    return _at_state(model, data, kind, file, values, rates, labels)


def _at_state(
    model: Any,
    data: Any,
    kind: str,
    file: str,
    values: dict[str, float],
    rates: dict[str, float],
    labels: dict[str, Any],
) -> list[str]:
    import mujoco

    resting = mechanism(kind, file, initial=values)
    moving = mechanism(kind, file, initial=values, speeds=rates)
    inside, outside = _directions(model, data)
    rows, bias_rows, q, masses = [], [], [], []
    for name, body in resting.bodies.items():
        index = model.body(name).id
        along, about = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, along, about, index)
        along_rate, about_rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacDot(model, data, along_rate, about_rate, data.xipos[index], index)
        rows += [U @ along, W @ along, NORMAL @ about]
        bias_rows += [U @ along_rate, W @ along_rate, NORMAL @ about_rate]
        masses += [body.mass, body.mass, body.inertia or 0.0]
        q += [*body.position, body.angle]
        if not np.allclose(body.position, [U @ data.xipos[index], W @ data.xipos[index]], rtol=0, atol=1e-8):
            return [f"body '{name}' is at {body.position}, in MuJoCo at {data.xipos[index]}"]
    jacobian, bias = np.array(rows), np.array(bias_rows) @ data.qvel
    v = jacobian @ data.qvel
    given = np.concatenate([[*body.velocity, body.angular_velocity] for body in moving.bodies.values()])
    problems = []
    if not np.allclose(v, given, rtol=1e-7, atol=1e-7):
        problems.append(f"the velocities are {given}, in MuJoCo {v}")
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    planar = jacobian @ inside
    problems += _unequal("mass matrix", planar.T @ (np.array(masses)[:, None] * planar), inside.T @ full @ inside)
    equations = EquationsOfMotion.of(resting)
    forces = equations.forces(0.0, np.array(q), v)
    friction = np.zeros(model.nv)
    for joint in labels.values():
        dof = joint.dofadr[0]
        friction[dof] = -model.dof_frictionloss[dof] * np.sign(data.qvel[dof])
    expected = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias + friction
    problems += _unequal("forces", planar.T @ (forces - np.array(masses) * bias), inside.T @ expected)
    closing = data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    constraint_rows = data.efc_J.reshape(-1, model.nv)[: data.nefc][closing] if data.nefc else np.zeros((0, model.nv))
    ours = equations.constraint_jacobian(0.0, np.array(q))[:, : equations.n] @ planar
    problems += _unequal("closing constraints", _projector(ours), _projector(constraint_rows @ inside))
    return problems + _events(model, data, resting, outside, labels)


def _events(model: Any, data: Any, resting: mbdkit.Mechanism, outside: np.ndarray, labels: dict[str, Any]) -> list[str]:
    """Return effects of MuJoCo that do not show in the forces at one state."""
    import mujoco

    problems = []
    leaving = outside.T @ data.qacc
    if np.max(np.abs(leaving), initial=0.0) > SAME * (1.0 + np.max(np.abs(data.qacc))):
        problems.append(f"a free body leaves the plane with {leaving}")
    if data.ncon:
        problems.append("bodies touch")
    if np.any(data.act_dot):
        problems.append("an actuator changes its state without control")
    if np.any(model.jnt_springyield):
        problems.append("a spring yields")
    if model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        problems.append("bodies fall asleep")
    for label, joint in labels.items():
        table = getattr(resting.forces.get(f"{label} limits"), "table", [[]])[0]
        limits = joint.range.tolist() if model.jnt_limited[joint.id] else []
        if len(table) != len(limits) or not np.allclose(np.ptp(table or [0]), np.ptp(limits or [0])):
            problems.append(f"joint '{label}' has the limits {table}, in MuJoCo {limits}")
    return problems


def _directions(model: Any, data: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities (nv, k) that stay in the plane, and those of free joints that leave it."""
    import mujoco

    inside, outside = [], []
    for k in range(model.njnt):
        dof = model.jnt_dofadr[k]
        if model.jnt_type[k] == int(mujoco.mjtJoint.mjJNT_FREE):
            turn = data.xmat[model.jnt_bodyid[k]].reshape(3, 3)
            for axis in (U, W):
                inside.append(np.concatenate([np.zeros(dof), axis, np.zeros(model.nv - dof - 3)]))
                outside.append(np.concatenate([np.zeros(dof + 3), turn.T @ axis, np.zeros(model.nv - dof - 6)]))
            inside.append(np.concatenate([np.zeros(dof + 3), turn.T @ NORMAL, np.zeros(model.nv - dof - 6)]))
            outside.append(np.concatenate([np.zeros(dof), NORMAL, np.zeros(model.nv - dof - 3)]))
        else:
            inside.append(np.eye(model.nv)[dof])
    shape = (-1, model.nv)
    return np.array(inside).reshape(shape).T, np.array(outside).reshape(shape).T


def _projector(rows: np.ndarray) -> np.ndarray:
    """Return the orthogonal projector onto the space that rows span; those of joints of the tree are round-off."""
    _, sizes, directions = np.linalg.svd(rows, full_matrices=False)
    kept = directions[sizes > 1e-8]
    return np.asarray(kept.T @ kept)


def _unequal(what: str, ours: np.ndarray, theirs: np.ndarray) -> list[str]:
    size = np.max(np.abs(theirs), initial=1e-3)
    if np.max(np.abs(ours - theirs), initial=0.0) <= SAME * size:
        return []
    return [f"{what} {ours.round(6).tolist()}, in MuJoCo {theirs.round(6).tolist()}"]
