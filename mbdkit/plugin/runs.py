"""Runs: preparation, simulation, continuous motion, provenance."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.runs.assembled_mechanism import AssembledMechanism as AssembledMechanism
    from mbdkit.runs.followers import AddedForces as AddedForces, Follower as Follower
    from mbdkit.runs.given_start import GivenStart as GivenStart
    from mbdkit.runs.simulation_batch import SimulationBatch as SimulationBatch, why_not_batched as why_not_batched
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
