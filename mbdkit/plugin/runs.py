"""Runs in lanes, and inverse dynamics: its data, errors and criteria, and bodies that follow others."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.runs.assembled_mechanism import AssembledMechanism as AssembledMechanism
    from mbdkit.runs.followers import AddedForces as AddedForces, Follower as Follower
    from mbdkit.runs.given_start import GivenStart as GivenStart
    from mbdkit.runs.simulation_batch import SimulationBatch as SimulationBatch
    from mbdkit_biomech.inverse_dynamics.compute import Inverse as Inverse
    from mbdkit_biomech.inverse_dynamics.criteria.doubt import data_criterion as data_criterion
    from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars as ResultBars
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
