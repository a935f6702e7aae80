"""Archives: tables of results, and files of results that are no runs."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.archive import recorded_columns as recorded_columns
    from mbdkit.archive.result_file import ResultFile as ResultFile
    from mbdkit.archive.result_table import ResultTable as ResultTable, TableColumn as TableColumn
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
