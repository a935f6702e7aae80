"""The plot `reactions`: forces in the joints over time, as magnitudes or components, and torques in a second panel."""

from __future__ import annotations

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.archive.run_views import Components, Names
from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed
from mbdkit_report.figures.curves import bands
from mbdkit_report.figures.page_model import Axis, Figure
from mbdkit_report.plot.charts import Panel, chart_panel
from mbdkit_report.plot.element_quantity import (
    MOST,
    ElementQuantity,
    element_chart,
    picked,
    reaction_force,
    with_errors,
)
from mbdkit_report.plot.torques_plot import carried_torque, torque_chart

#: Components to draw, by the value of the option `components`; none for the magnitude.
COMPONENTS: dict[str, tuple[str, ...]] = {"magnitude": (), "global": ("x", "y"), "body": ("axial", "shear")}
COMPONENTS |= {component: (component,) for component in ("x", "y", "axial", "shear")}

_AXIS = {"x": "joint force, x component", "y": "joint force, y component"}
_AXIS |= {"axial": "axial joint force", "shear": "shear joint force"}


def panels(run: Run) -> list[Panel]:
    """Return the panel of the forces and, if joints transmit torques, a panel of the torques of these joints."""
    torque = carried_torque(run, reaction_force(run))
    torques = [] if torque is None else [torque_chart(torque.only(picked(torque, None, "joint")))]
    return [chart_panel(one) for one in (chart(run), *torques)]


def charts(run: Run) -> list[Figure]:
    """Return the chart of the magnitudes of the forces."""
    return [chart(run)] if run.records("joints/reaction_force") and run.joint_names else []


def chart(run: Run, *, joints: Names = None, components: Components | str = "magnitude", most: int = MOST) -> Figure:
    """Return the chart of the forces in some joints; the options are those of `RunPlots.reactions`.

    Raises
    ------
    SpecError, UnknownNameError
        If there are no such components or joints, or the mechanism has no joints.
    """
    if components not in COMPONENTS:
        hint = did_you_mean(components, COMPONENTS)
        raise SpecError(f"components should be {listed(COMPONENTS, 'or')}, not {components!r}{hint}")
    if not (force := reaction_force(run)).elements:
        raise SpecError("the mechanism of this run has no joints, so that there are no joint forces to draw")
    shown = COMPONENTS[components]
    columns = picked(force, joints, "joint", max(1, most // max(1, len(shown))))
    caption = "Force that the first body of each joint exerts on the second"
    if not shown:
        axis = Axis("joint force", "N")
        return element_chart("reactions", "Joint forces", f"{caption}: magnitude.", axis, force.only(columns))
    parts = _components(run, columns, shown)
    groups = [run.joint_names[column] for column in columns for _ in shown]
    axis = Axis(_AXIS.get(components, "joint force"), "N")
    frame = "the frame of the second body, or of the first if it is ground"
    frame = "the global frame" if shown[0] in ("x", "y") else frame
    caption = f"{caption}: {listed(shown, 'and')} in {frame}."
    return element_chart("reactions", "Joint forces", caption, axis, parts, groups=groups)


def _components(run: Run, columns: list[int], shown: tuple[str, ...]) -> ElementQuantity:
    """Return components of the forces in some joints: first all components in the first joint, and so on."""
    values, labels = [], []
    for column in columns:
        name = run.joint_names[column]
        path = "joints/reaction_force"
        if shown[0] not in ("x", "y"):
            path += "_first" if run.joints[name].bodies[1] == "ground" else "_second"
        force = run.column(path, column, None)
        values += [force[:, int(component in ("y", "shear"))] for component in shown]
        labels += [name if len(shown) == 1 else f"{name}, {component}" for component in shown]
    quantity = ElementQuantity("joint force", "N", labels, bands(np.asarray(run.time), np.stack(values, axis=1)))
    # The estimate bounds the norm of the error of the vector, and therefore the error of every component.
    return with_errors(run, quantity, "reaction_error", [column for column in columns for _ in shown])
