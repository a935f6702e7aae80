"""Writes tables as the sheets of an Excel workbook."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.text import shown
from mbdkit_report.table_formats import ExportedTable, distinct, headings, rows_of, workbook_writer

#: Limits of Excel: rows and columns of a sheet, characters of its name and of a cell.
ROWS, COLUMNS, NAME, CELL = 1_048_576, 16_384, 31, 32_767
_CONTENTS = "contents"


@workbook_writer
def write_xlsx(tables: Mapping[str, ExportedTable], path: Path) -> None:
    """Write a workbook: a sheet for each table, whose first line has names and units, and a sheet of contents before
    them, with the tables whose names Excel does not allow for sheets.

    Numbers have the 15 to 16 digits that Excel keeps. Cells of nan are empty, and infinity is text. Text is never a
    formula.

    Raises
    ------
    SpecError
        If a table has more rows or columns than a sheet.
    MbdkitError
        If XlsxWriter is not installed.
    """
    for name, table in tables.items():
        for count, most, what in ((table.rows + 1, ROWS, "rows"), (1 + len(table.columns), COLUMNS, "columns")):
            if count > most:
                raise SpecError(
                    f"the sheet {name} would have {count:,} {what}, but Excel allows {most:,}; record less with "
                    "output.every or output.quantities, or export csv or parquet"
                )
    try:
        import xlsxwriter
    except ImportError as error:
        raise MbdkitError("Excel workbooks need the package XlsxWriter: pip install 'mbdkit[xlsx]'") from error
    # names without the characters that Excel does not allow
    given = (re.sub(r"[\[\]:*?/\\]|^'|'$", "_", shown(name)) or "_" for name in tables)
    names = distinct(given, NAME, taken=(_CONTENTS, "history"), cased=False)
    with xlsxwriter.Workbook(path, {"constant_memory": True}) as book:
        bold = book.add_format({"bold": True})
        contents = book.add_worksheet(_CONTENTS)
        contents.set_column(0, 1, 24)
        for row, line in enumerate((("sheet", "group", "rows", "columns"), *_contents(names, tables))):
            contents.write_row(row, 0, line, bold if row == 0 else None)
        for sheet_name, table in zip(names, tables.values(), strict=True):
            sheet = book.add_worksheet(sheet_name)
            sheet.freeze_panes(1, 1)
            sheet.set_column(0, len(table.columns), 16)
            for column, heading in enumerate(headings(table)):
                sheet.write_string(0, column, shown(heading), bold)
            for number, row_values in enumerate(rows_of(table), 1):
                for column, value in enumerate(row_values):
                    if isinstance(value, int | float) and math.isfinite(value):
                        sheet.write_number(number, column, value)
                    elif value is not None and value == value:
                        sheet.write_string(number, column, shown(str(value))[:CELL])


def _contents(names: list[str], tables: Mapping[str, ExportedTable]) -> list[tuple[str, str, int, int]]:
    pairs = zip(names, tables.items(), strict=True)
    return [(sheet, shown(name), table.rows, 1 + len(table.columns)) for sheet, (name, table) in pairs]
