"""RATTLE (Andersen 1983), the Lobatto IIIA-IIIB pair with two stages; see `mbdkit.methods.lobatto_pair`."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from mbdkit.methods.common_claims import JAY, lobatto_pair_claims
from mbdkit.methods.kinds import LobattoPair
from mbdkit.methods.method_options import Options
from mbdkit.registry.items import IntegratorPlugin

ANDERSEN = """@article{andersen1983,
  author = {Andersen, Hans C.},
  title = {{RATTLE}: a ``velocity'' version of the {SHAKE} algorithm for molecular dynamics calculations},
  journal = {Journal of Computational Physics}, volume = {52}, number = {1}, pages = {24--34}, year = {1983},
  doi = {10.1016/0021-9991(83)90014-1}}"""


class RattleOptions(Options):
    """Options of the iteration that solves for positions on the constraints."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("max_iterations",)

    tolerance: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None = None
    """Stop when the expected relative change of positions is below this value; by default, at stagnation."""
    max_iterations: Annotated[int, Field(ge=2, le=10_000)] | None = None
    """Largest number of iterations in one step, after which the step fails; by default 50, or up to 500 for a fixed
    step that would fail otherwise, as long as the iteration contracts steadily."""


FAMILY = "partitioned"
INTEGRATORS = (
    IntegratorPlugin(
        name="rattle",
        summary="RATTLE: order 2, symmetric, symplectic, holds positions and velocities on the joints, fixed steps.",
        options=RattleOptions,
        create=lambda options: LobattoPair(2, options.tolerance, options.max_iterations),
        claims=lambda options: lobatto_pair_claims(2),
        references=(ANDERSEN, JAY),
    ),
)
