"""Integration methods as data: coefficients, options, claims and references, one method in a file.

The algorithms are in `mbdkit.integrators`. The hash of kernel sources excludes this folder, so that an edit does not
cause recompilation. A new method is a file of this folder and an entry of `INTEGRATORS`.
"""

from __future__ import annotations

from typing import Any

from mbdkit.registry.items import IntegratorPlugin
from mbdkit.registry.target import Target


def _target(module: str, name: str, kind: Any = None) -> Any:
    return Target(f"{__name__}.{module}:{name}", kind)


def _integrator(
    order: int,
    name: str,
    summary: str,
    module: str,
    options: str,
    create: str = "create",
    claims: str = "claims",
    references: str = "REFERENCES",
    *,
    dense_output: bool = True,
) -> IntegratorPlugin:
    home, _, _ = options.rpartition(".")
    return IntegratorPlugin(
        name=name,
        summary=summary,
        options=_target(home or module, options.removeprefix(f"{home}."), type),
        create=_target(module, create),
        claims=_target(module, claims),
        references=_target(module, references, tuple),
        dense_output=dense_output,
        order=order,
    )


INTEGRATORS = (
    _integrator(
        10,
        "rk-gill",
        "Runge-Kutta-Gill: explicit, 4 stages, order 4, fixed steps.",
        "rk_gill",
        "method_options.ExplicitOptions",
        dense_output=False,
    ),
    _integrator(
        20,
        "rk4",
        "Classical Runge-Kutta: explicit, 4 stages, order 4, fixed steps.",
        "rk4",
        "method_options.ExplicitOptions",
        dense_output=False,
    ),
    _integrator(
        30,
        "dopri5",
        "Dormand-Prince: explicit, 7 stages, order 5, fixed or adaptive steps.",
        "dopri5",
        "method_options.ControlledOptions",
    ),
    _integrator(
        40,
        "dop853",
        "Dormand-Prince: explicit, 12 stages, order 8, fixed or adaptive steps.",
        "dop853",
        "method_options.ControlledOptions",
    ),
    _integrator(
        60,
        "gauss",
        "Gauss-Legendre collocation: implicit, 1 to 6 stages, order 2 s, symmetric, symplectic; or adaptive.",
        "gauss",
        "GaussOptions",
    ),
    _integrator(
        70,
        "radau-iia",
        "Radau IIA collocation: implicit, 2, 3 or 5 stages, order 2 s - 1, L-stable; or adaptive steps.",
        "radau_iia",
        "RadauOptions",
    ),
    _integrator(
        80,
        "rattle",
        "RATTLE: order 2, symmetric, symplectic, no drift of positions and velocities, fixed steps.",
        "lobatto_pair",
        "RattleOptions",
        "create_rattle",
        "claims_of_rattle",
        "REFERENCES_OF_RATTLE",
        dense_output=False,
    ),
    _integrator(
        90,
        "lobatto-pair",
        "Lobatto IIIA-IIIB: 2 or 3 stages, order 2 s - 2, symmetric, symplectic, no drift, fixed steps.",
        "lobatto_pair",
        "PairOptions",
        dense_output=False,
    ),
    _integrator(
        100,
        "scipy-radau",
        "SciPy's Radau IIA: implicit, order 5, adaptive steps.",
        "scipy_methods",
        "AdaptiveOptions",
        "create_radau",
        "claims_of_radau",
        "REFERENCES_OF_RADAU",
    ),
    _integrator(
        110,
        "scipy-dop853",
        "SciPy's DOP853: explicit, order 8, adaptive steps.",
        "scipy_methods",
        "AdaptiveOptions",
        "create_dop853",
        "claims_of_dop853",
        "REFERENCES_OF_DOP853",
    ),
    _integrator(
        120,
        "scipy-lsoda",
        "SciPy's LSODA: Adams and BDF with automatic switching, adaptive steps.",
        "scipy_methods",
        "AdaptiveOptions",
        "create_lsoda",
        "claims_of_lsoda",
        "REFERENCES_OF_LSODA",
    ),
)
"""The built-in integrators: explicit methods, collocation, partitioned methods and SciPy's solvers;
within a family by order of convergence, then by name.
"""
