"""Criterion of the verdict on columns that are used for several quantities; a remark on columns with equal values."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from mbdkit.base.text import listed
from mbdkit.engine.linear_systems import product
from mbdkit.trust.finding import Finding
from mbdkit_biomech.cited_text import cited
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Load

#: The mechanism ties two quantities if, along its free directions, the part of the gradient of one that is independent
#: of the gradient of the other is below this share.
TIED = 1e-6


def shared_columns(problem: InverseProblem) -> Iterator[Finding]:
    """Yield a doubt for each column that is used for several quantities or components of loads.

    Quantities that the mechanism ties to each other, such as the angles of two welded bodies, may share a column.
    """
    motion, names = problem.spec.motion, problem.measured.names
    used: dict[tuple[str, str], list[str]] = {}
    for name, one in (motion.columns or {}).items():
        used.setdefault((motion.file or "", one.column), []).append(name)
    for key, sharing in used.items():
        places = [names.index(name) for name in sharing]
        if len(places) > 1 and all(_tied(problem, *pair) for pair in combinations(places, 2)):
            used[key] = sharing[:1]
    for name, load in problem.spec.loads.items():
        table = f"loads.{name}" if load.data is not None else load.file or motion.file or ""
        for heading, place in _columns(load):
            used.setdefault((table, heading), []).append(f"loads.{name}.{place}")
    for (_, heading), sharing in used.items():
        if len(sharing) > 1:
            yield doubt(
                "shared-column",
                f"column '{cited(heading)}' is used for {listed(sharing, 'and')}: is another column meant? If not, as "
                "in symmetric motions, write `accept: [shared-column]`.",
            )


def _columns(load: Load) -> Iterator[tuple[str, str]]:
    """Yield the heading and the place of each column of a load with forces or torques.

    Columns with a scale are left out, because several loads may share the force of one plate.
    """
    places = {f"force[{axis}]": one for axis, one in enumerate(load.force or ())} | {"torque": load.torque}
    for place, column in places.items():
        if column is not None and not isinstance(column, float) and abs(column.scale) == 1.0:
            yield column.column, place


def equal_columns(problem: InverseProblem) -> Iterator[str]:
    """Yield a remark on columns of the motion with other headings but equal values that are not constant."""
    measured, motion = problem.measured, problem.spec.motion
    if motion.is_run:
        return
    heading = {name: name if motion.columns is None else motion.columns[name].column for name in measured.names}
    equal = [
        f"{a} and {b}"
        for (i, a), (j, b) in combinations(enumerate(measured.names), 2)
        if heading[a] != heading[b]
        and np.array_equal(measured.given[:, i], measured.given[:, j], equal_nan=True)
        and np.nanmin(measured.given[:, i]) < np.nanmax(measured.given[:, i])
        and not _tied(problem, i, j)
    ]
    if equal:
        yield f"columns have exactly the same values: {listed(equal)}. Is one a copy of the other?"


def _tied(problem: InverseProblem, first: int, second: int) -> bool:
    manifold, pose = problem.fitter.manifold, problem.prepared.equations.q0[None]
    free = manifold.directions_at(problem.measured.time[:1], pose).free[0]
    slopes = product(problem.measured.quantities.jacobian(pose)[0] * manifold.scale, free)
    a, b = slopes[first], slopes[second]
    off = b - a * np.sum(a * b) / max(float(np.sum(a * a)), np.finfo(float).tiny)
    return bool(np.sum(off**2) <= TIED**2 * np.sum(b**2))
