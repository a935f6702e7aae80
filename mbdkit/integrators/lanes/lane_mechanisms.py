"""Which mechanisms can be advanced in lanes, which of them together, and how their numbers get into a lane."""

from __future__ import annotations

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.native.machine_code import IN_PYTHON
from mbdkit.engine.native.number_arrays import Lanes
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.lanes.lane_run import BY_LANE
from mbdkit.integrators.loop.switches import switching_laws
from mbdkit.methods.kinds import Method
from mbdkit.quantities.names import archive_names


def topology_of(mechanism: CompiledMechanism) -> tuple[object, ...]:
    """Return a key that is equal for mechanisms with the same names that differ only in floating-point numbers.

    Runs of mechanisms with equal keys can be advanced together in lanes.
    """
    shapes = tuple((x.shape, x.tobytes() if x.dtype.kind == "i" else b"") for x in mechanism.topology)
    return shapes, mechanism.order, archive_names(mechanism), mechanism.friction, mechanism.has_power


def suits_lanes(method: Method, mechanism: CompiledMechanism, table: Timetable) -> bool:
    """Return whether a run of index-1 equations without stabilization can be advanced in lanes.

    First-order states are supported with explicit methods only, and `output.interval` with controlled step size only.
    Events, stops, sampled controllers, friction in joints, redundant directions within a pair of rows, and mechanisms
    that need the pivoted solver are not supported, nor are controlled steps that end where forces switch.
    """
    is_fixed = table.interval is None and table.step is not None and table.steps <= table.max_steps
    return (
        not IN_PYTHON
        and method.traits.lanes is not None
        and (method.traits.is_explicit or not mechanism.states)
        and (is_fixed or method.traits.tolerances is not None)
        and not table.single
        and not table.stops
        and not mechanism.controllers
        and not mechanism.friction
        and not mechanism.following
        and not mechanism.needs_pivots
        and not (method.traits.tolerances is not None and switching_laws(mechanism)[0])
        and len(mechanism.topology.spare) == 0
    )


def fill_lanes(top: Topology, lanes: slice, topology: Topology) -> None:
    """Copy the numbers of a mechanism into some lanes; integers are the same for all lanes."""
    for name, values, own in zip(Topology._fields, top, topology, strict=True):
        if name in BY_LANE:
            values[lanes] = own
        elif isinstance(values, Lanes):
            values[..., lanes] = own[..., None]
