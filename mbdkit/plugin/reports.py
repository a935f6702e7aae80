"""Reports: sections, tables, charts and their marks, verdicts, views of notebooks, formats of exported tables."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit_report.analysis.verdict import Answer as Answer, Claim as Claim, Verdict as Verdict
    from mbdkit_report.export import export as export
    from mbdkit_report.figures.curves import band_over_time as band_over_time, bands as bands
    from mbdkit_report.figures.page_model import (
        Axis as Axis, Band as Band, columns_of as columns_of, Figure as Figure,
        Guide as Guide, Line as Line, Mark as Mark, Section as Section, Table as Table,
    )
    from mbdkit_report.notebook.result_views import object_view as object_view, View as View
    from mbdkit_report.pages.methods_used import methods as methods
    from mbdkit_report.pages.model_section import glance as glance
    from mbdkit_report.pages.report import report as report
    from mbdkit_report.pages.report_page import ReportPage as ReportPage
    from mbdkit_report.pages.run_report import environment as environment, run_report as run_report, TONES as TONES
    from mbdkit_report.plot.pose_pictures import PosePictures as PosePictures
    from mbdkit_report.seams import (
        report_charts as report_charts, report_of_folder as report_of_folder, report_sections as report_sections,
    )
    from mbdkit_report.spec_words import key_unit as key_unit
    from mbdkit_report.table_formats import ExportedTable as ExportedTable, table_writer as table_writer
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
