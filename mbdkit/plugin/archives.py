"""Archives and the table of quantities: writing, reading, hashing, summaries."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive import layout as layout, recorded_columns as recorded_columns
    from mbdkit.archive.accuracy_summary import RunErrors as RunErrors
    from mbdkit.archive.archive_check import blaming_damage as blaming_damage
    from mbdkit.archive.fingerprint import (
        StoredHashes as StoredHashes, datasets as datasets, is_text as is_text, seal as seal,
    )
    from mbdkit.archive.finished_run import FinishedRun as FinishedRun
    from mbdkit.archive.hdf5 import create as create, dims as dims, set_text as set_text
    from mbdkit.archive.hdf5_errors import DAMAGE as DAMAGE, reading as reading
    from mbdkit.archive.headlines import (
        EXACT as EXACT, JOINTS_NAMED as JOINTS_NAMED, MESH_ERROR as MESH_ERROR, ROUND_OFF as ROUND_OFF,
        excluded_error as excluded_error, largest_loads as largest_loads, largest_of as largest_of,
    )
    from mbdkit.archive.history import JointHistories as JointHistories
    from mbdkit.archive.layout import (
        COUNTERS as COUNTERS, SOME_COUNTERS as SOME_COUNTERS,
        SOME_TIMINGS as SOME_TIMINGS, TIMINGS as TIMINGS, name_texts as name_texts,
    )
    from mbdkit.archive.measured_values import Integrals as Integrals, MeasuredValues as MeasuredValues
    from mbdkit.archive.named_columns import (
        NotRecordedError as NotRecordedError, columns_of as columns_of, view_of as view_of,
    )
    from mbdkit.archive.part_file import (
        check_target as check_target, checkpoint_path as checkpoint_path, part_path as part_path,
    )
    from mbdkit.archive.peak_errors import (
        errors_of_measures as errors_of_measures, expression_of_largest as expression_of_largest,
        missed_between_rows as missed_between_rows, peak_errors as peak_errors,
    )
    from mbdkit.archive.plain_spec import PlainSpec as PlainSpec
    from mbdkit.archive.recorded_data import RecordedData as RecordedData
    from mbdkit.archive.result_table import ResultTable as ResultTable, TableColumn as TableColumn
    from mbdkit.archive.run_contents import ArrayContents as ArrayContents
    from mbdkit.archive.run_summary import few as few, ranked as ranked
    from mbdkit.archive.run_writer import (
        Ending as Ending, Origin as Origin, SharedForces as SharedForces, utc_now as utc_now,
    )
    from mbdkit.archive.stored_mechanism import (
        StoredMechanism as StoredMechanism, mechanism_json as mechanism_json, read_mechanism as read_mechanism,
    )
    from mbdkit.archive.untrusted_file import open_hdf5 as open_hdf5
    from mbdkit.archive.writer import ArchiveWriter as ArchiveWriter
    from mbdkit.base.distributions import own_version as own_version
    from mbdkit.quantities.array import FLOAT as FLOAT, INTEGER as INTEGER, TEXT as TEXT
    from mbdkit.quantities.entries import (
        AXIS as AXIS, JOINT as JOINT, TIME as TIME, computed as computed, unit_array as unit_array,
    )
    from mbdkit.quantities.names import (
        ArchiveNames as ArchiveNames, archive_names as archive_names, with_members as with_members,
    )
    from mbdkit.quantities.quantity import Quantity as Quantity
    from mbdkit.quantities.registered_kinds import (
        added_kinds as added_kinds, groups as groups, kind_of_group as kind_of_group, kinds as kinds,
        sizes_of as sizes_of,
    )
    from mbdkit.quantities.states import NONE as NONE
    from mbdkit.quantities.table import KINDS as KINDS
    from mbdkit.archive.run_contents import NotStoredError as NotStoredError
    from mbdkit.quantities.array import MIXED as MIXED
    from mbdkit.runs.finish import finish_states as finish_states
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
