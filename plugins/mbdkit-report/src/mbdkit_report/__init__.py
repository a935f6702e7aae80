"""What people see of results: figures, plots, animations, reports and views in notebooks.

This module is a door: the names that authors of report sections, charts, verdicts, views and reports of their own
import, from `mbdkit_report`. Each is imported when it is first used.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit_report.analysis.energy import trend as trend, Trend as Trend, trends as trends
    from mbdkit_report.analysis.growth import growth_law as growth_law, worst_history as worst_history
    from mbdkit_report.analysis.order import observed_order as observed_order, ObservedOrder as ObservedOrder
    from mbdkit_report.analysis.verdict import (
        Answer as Answer, Claim as Claim, exceeds as exceeds, Range as Range, together as together, Verdict as Verdict,
    )
    from mbdkit_report.export import write_tables as write_tables
    from mbdkit_report.figures.curves import band_over_time as band_over_time, bands as bands, errors_at as errors_at
    from mbdkit_report.figures.drawing_geometry import (
        draw_mechanism as draw_mechanism, Drawing as Drawing, mechanism_of as mechanism_of,
    )
    from mbdkit_report.figures.mechanism_drawing import (
        draw_sketch as draw_sketch, NamedPose as NamedPose, short_name as short_name,
    )
    from mbdkit_report.figures.page_model import (
        Axis as Axis, Band as Band, bar_cells as bar_cells, bar_columns as bar_columns, Cell as Cell,
        Column as Column, columns_of as columns_of, Figure as Figure, Guide as Guide, Illustration as Illustration,
        Line as Line, Mark as Mark, Section as Section,
        Stated as Stated, Table as Table,
    )
    from mbdkit_report.figures.plane_geometry import view_box as view_box
    from mbdkit_report.figures.pose import draw_pose as draw_pose
    from mbdkit_report.figures.quantity_text import heading as heading, with_unit as with_unit
    from mbdkit_report.figures.svg_canvas import Canvas as Canvas, svg_of as svg_of
    from mbdkit_report.group_table import data_frame as data_frame, TableColumn as TableColumn
    from mbdkit_report.notebook.result_views import Picture as Picture, View as View
    from mbdkit_report.pages.methods_used import methods as methods
    from mbdkit_report.pages.model_section import drawing as drawing, glance as glance
    from mbdkit_report.pages.report import report as report, write_report as write_report
    from mbdkit_report.pages.report_page import chart_data as chart_data, ReportPage as ReportPage
    from mbdkit_report.pages.run_report import (
        environment as environment, film_of as film_of, run_report as run_report, TONES as TONES,
    )
    from mbdkit_report.pages.templating import render as render
    from mbdkit_report.pages.verdict_text import (
        json_values as json_values, table_text as table_text, terminal_text as terminal_text,
    )
    from mbdkit_report.plot.caption import Caption as Caption
    from mbdkit_report.plot.charts import draw_chart as draw_chart
    from mbdkit_report.plot.plot_kinds import plot_module as plot_module
    from mbdkit_report.plot.style import dress as dress, FORMATS as FORMATS, new_figure as new_figure, save as save
    from mbdkit_report.spec_words import (
        key_unit as key_unit, key_words as key_words, keys_ending_in as keys_ending_in, leaves as leaves,
        stated_units as stated_units,
    )
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
