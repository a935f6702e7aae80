"""Switching functions of the forces of a run: where laws and expressions are not smooth."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.law_programs import run_program
from mbdkit.engine.kernels.table_rows import INPUT, LAW_ROW, LOAD_VALUE, MULTIPLIER, SPRING, STATE_ROW, STATE_USE
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.loop.steps_to_switches import (
    AT_ZERO,
    MOST_SAMPLES,
    Spell,
    SwitchBundle,
    first_place,
    look,
    next_place,
)

#: Number of ends of steps with which the values of switching functions are compared.
PREVIOUS = 3


def switching_laws(mechanism: CompiledMechanism) -> tuple[list[tuple[int, int, int, int, int]], int]:
    """Return the rows of ``SwitchBundle.laws``, and the number of all switching functions."""
    top = mechanism.topology
    segments = {int(x[SPRING.law]): k for k, x in enumerate(top.springs) if x[SPRING.segments] > 0}
    segments |= {int(x[STATE_ROW.rate]): int(x[STATE_ROW.segment]) for x in top.states}
    segments |= dict.fromkeys(top.load_values[:, LOAD_VALUE.law].tolist(), -1)
    if set(segments) <= {-1}:
        return [], 0
    from mbdkit.engine.law_compiler import switches_of  # many mechanisms have no such law

    columns = (top.inputs[:, INPUT.parameter], top.state_places[:, STATE_USE.parameter])
    varying = set(np.concatenate([*columns, top.reactions[:, MULTIPLIER.parameter]]).tolist())
    rows, count = [], 0
    for law in sorted(set(segments) - {-1}):
        compiled, begin = mechanism.laws[law][1], int(top.laws[law, LAW_ROW.parameters])
        switches = switches_of(compiled.law, compiled.parameters)
        if switches is not None and any(i < 3 or begin + i - 2 in varying for i in switches.inputs):
            rows.append((law, segments[law], count, run_program.address, switches.program.ctypes.data))
            count += switches.number
    return rows, count


def switch_bundle(workspace: Workspace, span: float) -> PinnedBundle | None:
    """Return the switching functions of a run of a duration [s]; None if its forces have none."""
    mechanism = workspace.mechanism
    rows, count = switching_laws(mechanism)
    if not rows:
        return None
    size = mechanism.size
    spell = Spell(
        np.full(1, np.nan), np.full(1, np.nan), np.zeros(1, dtype=np.int64), np.full(1, -np.inf), np.full(1, np.nan)
    )
    return PinnedBundle(
        SwitchBundle(
            laws=np.array(rows, dtype=np.int64), other_look=np.zeros(1, dtype=np.int64),
            dense=np.zeros(1, dtype=np.int64), span=np.array([span]), spell=spell, value=np.zeros((count, 1)),
            places=np.zeros(MOST_SAMPLES), samples=np.zeros((MOST_SAMPLES, count)),
            count=np.zeros(1, dtype=np.int64), limits=np.zeros(3), q=np.zeros(size), v=np.zeros(size),
            z=np.zeros(len(mechanism.states)),
        )
    )  # fmt: skip


def look_for_switches(dense: int, workspace: Workspace, span: float) -> PinnedBundle | None:
    """Let controlled steps end where forces switch; return the switching functions, if any.

    `dense`: address of the dense output of the method; 0 for the cubic through both ends.
    """
    pinned, looks = switch_bundle(workspace, span), workspace.scratch.reacting.add_forces
    if pinned is None:
        if looks[1] == look.address:  # of an earlier run in the same workspace
            looks[1:] = 0
        return None
    if looks[1] != look.address:
        pinned.bundle.other_look[0] = looks[1]
    pinned.bundle.dense[0] = dense
    looks[1:] = look.address, pinned.address
    return pinned


def switching_functions(
    workspace: Workspace, switches: PinnedBundle | None, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Return the switching functions (T, G) of the forces in T states."""
    if switches is None:
        return np.zeros((len(time), 0))
    bundle, values = switches.bundle, []
    for k, t in enumerate(time.tolist()):
        bundle.q[:], bundle.v[:], bundle.z[:] = q[k], v[k], z[k]
        next_place(workspace.engine, switches.address, t, 1.0, first_place(switches.address, t, 1.0))
        values.append(bundle.samples[0].copy())
    return np.array(values).reshape(-1, len(bundle.value))


def ends_at_switches(time: np.ndarray, values: np.ndarray, first: int, shortest: float) -> list[int]:
    """Return the ends of steps, from `first` on, that lie just behind a time at which a force switches.

    `time`, `values`: (T,) times and (T, G) switching functions at the ends of consecutive steps. A function is small
    compared with those of the `PREVIOUS` ends before, of which several may be close to the zero, or the step is below
    `shortest` [s], as steps are to which error control has led.
    """
    ends = list[int]()
    for k in range(first, len(values)):
        before = values[max(0, k - PREVIOUS) : k]
        is_small = np.abs(values[k]) < AT_ZERO * np.max(np.abs(before), axis=0)
        if np.any((is_small | (time[k] - time[k - 1] < shortest)) & (before[-1] * values[k] <= 0.0)):
            ends.append(k)
    return ends
