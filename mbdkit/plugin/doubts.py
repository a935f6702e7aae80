"""What is doubted: criteria, limits, watchers of states and of ranges."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.trust.energy_record import EnergyRecord as EnergyRecord
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
