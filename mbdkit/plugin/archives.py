"""Archives and the table of quantities: writing, reading, hashing, summaries."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive import recorded_columns as recorded_columns
    from mbdkit.archive.fingerprint import StoredHashes as StoredHashes, seal as seal
    from mbdkit.archive.hdf5 import set_text as set_text
    from mbdkit.archive.hdf5_errors import reading as reading
    from mbdkit.archive.part_file import check_target as check_target
    from mbdkit.archive.result_table import ResultTable as ResultTable, TableColumn as TableColumn
    from mbdkit.archive.run_writer import utc_now as utc_now
    from mbdkit.archive.untrusted_file import open_hdf5 as open_hdf5
    from mbdkit.base.distributions import own_version as own_version
    from mbdkit.quantities.array import MIXED as MIXED
    from mbdkit.quantities.entries import TIME as TIME, computed as computed
    from mbdkit.runs.finish import finish_states as finish_states
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
