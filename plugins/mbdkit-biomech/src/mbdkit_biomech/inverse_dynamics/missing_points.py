"""Criterion of the verdict on measured forces without a point of application, which act at a centre of mass."""

from __future__ import annotations

from collections.abc import Iterator

from mbdkit.base.text import listed, shown
from mbdkit.plugin import Finding
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem
from mbdkit_biomech.inverse_dynamics.doubt import doubt


def missing_points(problem: InverseProblem) -> Iterator[Finding]:
    """Yield a doubt for each load without a point that is that of a plate, or whose table seems to have its point."""
    for name, told, columns in _without_point(problem):
        if columns:
            look = "looks like its" if len(columns) == 1 else "look like columns of its"
            example = f", as in `point: [{', '.join(map(shown, columns))}]`" if len(columns) == 2 else ""
            yield doubt(
                "load-point",
                f"{told}, but {listed([shown(column) for column in columns], 'and')} {look} point of application: give "
                f"`point`{example}, or write `kind: other` if the force does act at the centre of mass.",
            )
        elif problem.spec.loads[name].kind == "plate":
            yield doubt("load-point", f"{told}, although it is the load of a force plate: give `point`.")


def forces_at_centres(problem: InverseProblem) -> Iterator[str]:
    """Yield a remark on each other load whose measured force acts at a centre of mass because it has no point."""
    for name, told, columns in _without_point(problem):
        if not columns and problem.spec.loads[name].kind is None:
            yield f"{told}. Give `point` if it acts elsewhere, or write `kind: other`."


def _without_point(problem: InverseProblem) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield the name of each load with a measured force and no point, unless it has `kind: other`; a clause that says
    where it acts; and the columns that look like its point.
    """
    for name, load in problem.spec.loads.items():
        measured = any(not isinstance(one, float) for one in load.force or ())
        if measured and load.point is None and load.kind != "other":
            told = f"load '{shown(name)}' has no `point`, so that its force acts at the centre of mass of {load.body}"
            yield name, told, problem.loads[name].like_point
