"""What notebooks show of workloads."""

from __future__ import annotations

from mbdkit_biomech.inverse_dynamics.results.workload import Workload
from mbdkit_report import Cell, Table, View, bar_cells, columns_of
from mbdkit_report.notebook.result_views import object_view


@object_view
def workload_view(found: Workload) -> View:
    """Return the view of a workload."""
    rows: list[tuple[Cell, ...]] = [
        (
            element.name,
            element.kind,
            load.units,
            *bar_cells(load.peak, load.peak_error, load.id),
            load.peak_time,
            load.impulse,
        )
        for element in found.elements
        for load in (element.load, element.torque)
        if load is not None
    ]
    columns = columns_of("element; kind; unit; peak; \u00b1 error; time of the peak [s]; impulse [unit s]")
    table = Table("workload", "Loads", columns, tuple(rows))
    return View("Workload", (f"From {found.start:g} s to {found.end:g} s.", found.note), tables=(table,))
