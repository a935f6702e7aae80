"""What is doubted: criteria, limits, watchers of states and of ranges."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.mechanism.improbable_bodies import (
        improbable_bodies as improbable_bodies, improbable_people as improbable_people,
    )
    from mbdkit.mechanism.improbable_values import (
        improbable_beams as improbable_beams, improbable_lengths as improbable_lengths,
    )
    from mbdkit.runs.angles_in_degrees import (
        angles_in_degrees as angles_in_degrees, looks_like_degrees as looks_like_degrees,
    )
    from mbdkit.runs.coarse_beams import CoarseBeams as CoarseBeams
    from mbdkit.runs.evidence import evidence_of_run as evidence_of_run
    from mbdkit.runs.law_ranges import (
        LawRanges as LawRanges, has_ranges as has_ranges, steps_are_rows as steps_are_rows,
    )
    from mbdkit.runs.notes import zero_reactions_in as zero_reactions_in
    from mbdkit.runs.slow_friction import (
        FrictionElement as FrictionElement, SHARE as SHARE, SlowFriction as SlowFriction,
    )
    from mbdkit.runs.state_watchers import StateWatchers as StateWatchers
    from mbdkit.trust.criteria import (
        LEVELS as LEVELS, MISALIGNMENT as MISALIGNMENT, ROUND_OFF as ROUND_OFF, rounding as rounding,
    )
    from mbdkit.trust.energy_record import EnergyRecord as EnergyRecord, gravity_level as gravity_level
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
