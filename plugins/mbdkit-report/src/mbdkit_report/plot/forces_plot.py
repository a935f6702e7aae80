"""The plot `forces`: forces of springs, dampers, force laws, loads and actuators over time. The plot `torques` shows
the elements that exert a torque.
"""

from __future__ import annotations

from mbdkit.archive.run import Run
from mbdkit.archive.run_views import Names
from mbdkit.base.errors import SpecError
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.plot.element_quantity import MOST, element_chart, element_values, has_elements, picked


def charts(run: Run) -> list[Figure]:
    """Return the chart of the forces, if there are any."""
    return [chart(run)] if has_elements(run) and element_values(run, "N", "force").elements else []


def chart(run: Run, *, elements: Names = None, most: int = MOST) -> Figure:
    """Return the chart of the forces of some force elements; the options are those of `RunPlots.forces`.

    Raises
    ------
    SpecError, UnknownNameError
        If no element exerts a force, or there is no such force element.
    """
    if not (force := element_values(run, "N", "force")).elements:
        raise SpecError("no force element of this run exerts a force; the plot of torques shows those with a torque")
    few = force.only(picked(force, elements, "force element with a force", most))
    caption = "Tension of springs, dampers and laws, positive where it pulls together; magnitude of forces at a point."
    return element_chart("forces", "Forces of elements", caption, Axis("force", "N"), few)
