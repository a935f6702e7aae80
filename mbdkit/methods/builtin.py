"""The integrators that mbdkit ships, as the plugin items that the registry takes; light to import."""

from __future__ import annotations

from typing import Any

from mbdkit.methods import dop853, dopri5, gauss, lobatto, radau_iia, rk4, rk_gill
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, LobattoPair, SciPySolver
from mbdkit.methods.method_options import (
    AdaptiveOptions,
    ControlledOptions,
    ExplicitOptions,
    GaussOptions,
    PairOptions,
    RadauOptions,
    RattleOptions,
)
from mbdkit.registry.items import Claims, IntegratorPlugin, Orders

_POLYNOMIAL_DRIFT = "constraints hold at acceleration level only: drift of the method's order, growing with time"
_TOLERANCE_DRIFT = "constraints hold at acceleration level only: drift follows the tolerance and grows with time"

_SCIPY = """@article{scipy2020,
  author = {Virtanen, Pauli and others},
  title = {{SciPy} 1.0: fundamental algorithms for scientific computing in {P}ython},
  journal = {Nature Methods}, volume = {17}, pages = {261--272}, year = {2020}, doi = {10.1038/s41592-019-0686-2}}"""
_HAIRER_NORSETT = """@book{hairer1993,
  author = {Hairer, Ernst and N{\\o}rsett, Syvert P. and Wanner, Gerhard},
  title = {Solving Ordinary Differential Equations {I}: Nonstiff Problems},
  edition = {2}, publisher = {Springer}, year = {1993}, doi = {10.1007/978-3-540-78862-1}}"""
_PETZOLD = """@article{petzold1983,
  author = {Petzold, Linda},
  title = {Automatic selection of methods for solving stiff and nonstiff systems of ordinary differential equations},
  journal = {SIAM Journal on Scientific and Statistical Computing},
  volume = {4}, number = {1}, pages = {136--148}, year = {1983}, doi = {10.1137/0904010}}"""


_HELD = "positions and velocities meet the joints to round-off at the end of every step"
_BY_FORMULATION = (
    "index-1 drifts with the method's order, growing with time; index-3 meets the joints in positions to round-off, "
    "index-2 in velocities, ggl in both; what index-2 misses in positions grows with time, "
    "what index-3 misses in velocities does not"
)
_GEAR = """@article{gear1985,
  author = {Gear, C. W. and Leimkuhler, B. and Gupta, G. K.},
  title = {Automatic integration of {E}uler-{L}agrange equations with constraints},
  journal = {Journal of Computational and Applied Mathematics},
  volume = {12--13}, pages = {77--90}, year = {1985}, doi = {10.1016/0377-0427(85)90008-1}}"""


def _radau_claims(options: RadauOptions) -> Claims:
    """Hairer, Lubich and Roche (1989) prove the orders of index 2, and those of index 3 for three stages at least."""
    s, order = options.stages, 2 * options.stages - 1
    fixed = not options.adaptive
    newton = options.stage_solver == "newton"
    orders = {"index-2": Orders(order, order, s), "index-3": Orders(order, s, s - 1), "ggl": Orders(order, order, s)}
    index_1 = _POLYNOMIAL_DRIFT if fixed else _TOLERANCE_DRIFT
    return Claims(
        order=order if fixed else None,
        stages=s,
        adaptive=options.adaptive,
        drift=_BY_FORMULATION if newton else index_1,
        needs=("tangents",) if newton else ("accelerations",),
        formulations=("index-1", *orders) if newton else ("index-1",),
        orders=orders if newton and fixed else {},
    )


def _pair_claims(stages: int) -> Claims:
    return Claims(
        order=2 * stages - 2,
        multiplier_order=stages - 1,
        symmetric=True,
        symplectic=True,
        stages=stages,
        drift=_HELD,
        needs=("accelerations",),
        formulations=("index-3",),
    )


def _explicit(name: str, summary: str, module: Any) -> IntegratorPlugin:
    return IntegratorPlugin(
        name=name,
        summary=summary,
        options=ExplicitOptions,
        create=lambda options: ExplicitRungeKutta(module.tableau()),
        claims=lambda options: Claims(order=4, stages=4, drift=_POLYNOMIAL_DRIFT, needs=("accelerations",)),
        references=(module.REFERENCE,),
    )


def _embedded(name: str, summary: str, module: Any, order: int, stages: int) -> IntegratorPlugin:
    def claims(options: ControlledOptions) -> Claims:
        return Claims(
            order=None if options.adaptive else order,
            stages=stages,
            adaptive=options.adaptive,
            drift=_TOLERANCE_DRIFT if options.adaptive else _POLYNOMIAL_DRIFT,
            needs=("accelerations",),
        )

    return IntegratorPlugin(
        name=name,
        summary=summary,
        options=ControlledOptions,
        create=lambda options: ExplicitRungeKutta(module.tableau(), module.pair(), options.tolerances()),
        claims=claims,
        references=(module.REFERENCE,),
        dense_output=True,
    )


def _implicit(options: GaussOptions | RadauOptions, module: Any) -> ImplicitRungeKutta:
    return ImplicitRungeKutta(
        module.tableau(options.stages),
        options.stage_solver,
        options.tolerance,
        options.max_iterations,
        options.tolerances(),
    )


def _gauss_claims(options: GaussOptions) -> Claims:
    """Steps that are chosen by what went before undo no others: adaptive, it is neither symmetric nor symplectic."""
    fixed = not options.adaptive
    return Claims(
        order=2 * options.stages if fixed else None,
        symmetric=fixed,
        symplectic=fixed,
        quadratic_invariants=True,
        stages=options.stages,
        adaptive=options.adaptive,
        drift=_POLYNOMIAL_DRIFT if fixed else _TOLERANCE_DRIFT,
        needs=("tangents",) if options.stage_solver == "newton" else ("accelerations",),
    )


def _scipy(name: str, solver: str, summary: str, source: str, *, jacobian: bool = False) -> IntegratorPlugin:
    needs = ("accelerations", "tangents") if jacobian else ("accelerations",)
    return IntegratorPlugin(
        name=name,
        summary=summary,
        options=AdaptiveOptions,
        create=lambda options: SciPySolver(solver, options.rtol, options.atol, needs_jacobian=jacobian),
        claims=lambda options: Claims(
            adaptive=True, drift=_TOLERANCE_DRIFT, needs=needs, stabilizations=("none", "baumgarte")
        ),
        references=(_SCIPY, source),
        dense_output=True,
    )


INTEGRATORS: list[IntegratorPlugin] = [
    _explicit("rk-gill", "Runge-Kutta-Gill: explicit, 4 stages, order 4, fixed steps.", rk_gill),
    _explicit("rk4", "Classical Runge-Kutta: explicit, 4 stages, order 4, fixed steps.", rk4),
    _embedded("dopri5", "Dormand-Prince: explicit, 7 stages, order 5, fixed or adaptive steps.", dopri5, 5, 7),
    _embedded("dop853", "Dormand-Prince: explicit, 12 stages, order 8, fixed or adaptive steps.", dop853, 8, 12),
    IntegratorPlugin(
        name="gauss",
        summary="Gauss-Legendre collocation: implicit, 1 to 6 stages, order 2 s, symmetric, symplectic; or adaptive.",
        options=GaussOptions,
        create=lambda options: _implicit(options, gauss),
        claims=_gauss_claims,
        dense_output=True,
        references=(gauss.REFERENCE,),
    ),
    IntegratorPlugin(
        name="radau-iia",
        summary="Radau IIA collocation: implicit, 2, 3 or 5 stages, order 2 s - 1, L-stable; or adaptive steps.",
        options=RadauOptions,
        create=lambda options: _implicit(options, radau_iia),
        dense_output=True,
        claims=_radau_claims,
        references=(radau_iia.REFERENCE, _GEAR),
    ),
    IntegratorPlugin(
        name="rattle",
        summary="RATTLE: order 2, symmetric, symplectic, holds positions and velocities on the joints, fixed steps.",
        options=RattleOptions,
        create=lambda options: LobattoPair(2, options.tolerance, options.max_iterations),
        claims=lambda options: _pair_claims(2),
        references=(lobatto.ANDERSEN, lobatto.JAY),
    ),
    IntegratorPlugin(
        name="lobatto-pair",
        summary="Lobatto IIIA-IIIB: 2 or 3 stages, order 2 s - 2, symmetric, symplectic, holds joints, fixed steps.",
        options=PairOptions,
        create=lambda options: LobattoPair(options.stages, options.tolerance, options.max_iterations),
        claims=lambda options: _pair_claims(options.stages),
        references=(lobatto.JAY,),
    ),
    _scipy(
        "scipy-radau",
        "Radau",
        "SciPy's Radau IIA: implicit, order 5, adaptive steps.",
        radau_iia.REFERENCE,
        jacobian=True,
    ),
    _scipy("scipy-dop853", "DOP853", "SciPy's DOP853: explicit, order 8, adaptive steps.", _HAIRER_NORSETT),
    _scipy(
        "scipy-lsoda",
        "LSODA",
        "SciPy's LSODA: Adams and BDF with automatic switching, adaptive steps.",
        _PETZOLD,
        jacobian=True,
    ),
]
