"""The plot `forces`: forces of springs, dampers, force laws, loads and actuators over time. The plot `torques` shows
the elements that exert a torque.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from mbdkit.archive.run_views import Names
from mbdkit.base.errors import SpecError
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.plot.charts import Panel
from mbdkit_report.plot.element_quantity import MOST, draw_elements, element_chart, element_values, has_elements, picked

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def panels(run: Run) -> list[Panel]:
    """Return the panel of the forces."""
    force = element_values(run, "N", "force")
    return [Panel(partial(draw_elements, quantity=force, what="force elements"), height=2.7)]


def charts(run: Run) -> list[Figure]:
    """Return the chart of the forces, if there are any."""
    if not has_elements(run):
        return []
    return [chart(run)] if element_values(run, "N", "force").elements else []


def chart(run: Run, *, elements: Names = None, most: int = MOST) -> Figure:
    """Return the chart of the forces of some force elements.

    Parameters
    ----------
    elements
        Names of force elements and actuators; by default those with the largest forces.

    Raises
    ------
    SpecError
        If no element exerts a force.
    UnknownNameError
        If there is no such force element.
    """
    force = element_values(run, "N", "force")
    if not force.elements:
        raise SpecError("no force element of this run exerts a force; the plot of torques shows those with a torque")
    few = force.only(picked(force, elements, "force element with a force", most))
    caption = "Tension of springs, dampers and laws, positive where it pulls together; magnitude of forces at a point."
    return element_chart("forces", "Forces of elements", caption, Axis("force", "N"), few)
