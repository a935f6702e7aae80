"""What notebooks show of gradients."""

from __future__ import annotations

from mbdkit_gradients.gradient import Gradient
from mbdkit_report import Cell, Column, Table, View, columns_of
from mbdkit_report.notebook.result_views import object_view


@object_view
def gradient_view(found: Gradient) -> View:
    """Return the view of a gradient."""
    columns = [*columns_of("measure; unit; value"), *(Column(f"by {name}") for name in found.parameters)]
    rows: list[tuple[Cell, ...]] = [
        (name, unit, float(value), *found.texts(name, "\u00b1"))
        for name, unit, value in zip(found.measures, found.units, found.value, strict=True)
    ]
    check = () if found.check is None else (str(found.check),)
    note = "In the unit of the measure for each SI unit of the parameter."
    table = Table("gradient", "Derivatives", tuple(columns), tuple(rows), note)
    return View("Gradient", (*found.doubts, *found.remarks, *check), tables=(table,))
