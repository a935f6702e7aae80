"""Lobatto methods for mbdkit, given by tableaus.

All methods have s stages, nodes at both ends of the step, and order 2 s - 2. IIIA is a collocation method; the others
follow from it by conditions that `tableau` states (Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.4 and
VI.4; Hairer and Wanner, Solving ODEs II, IV.5; IIID after Chan 1990).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import mpmath
from pydantic import Field

import mbdkit
from mbdkit.plugin import ImplicitOptions, Method, collocation
from mbdkit.plugin.seams import integrator_claims, integrator_method

REFERENCES = tuple(Path(__file__).with_name("references.bib").read_text(encoding="utf-8").strip().split("\n\n"))
DIGITS = 75


class LobattoOptions(ImplicitOptions):
    """Options of a Lobatto method with any number of stages."""

    adaptive: Literal[False] = False
    """Steps are fixed."""
    stages: Annotated[int, Field(ge=2, le=6)] = 3
    """Number of stages s; the order is 2 s - 2."""


class LobattoIIIBOptions(LobattoOptions):
    """Options of Lobatto IIIB, which needs at least three stages: with two, its rows do not sum to its nodes."""

    stages: Annotated[int, Field(ge=3, le=6)] = 3
    """Number of stages s; the order is 2 s - 2."""


def tableau(kind: str, s: int) -> mbdkit.ButcherTableau:
    """Return Lobatto IIIA, IIIB, IIIC or IIID with `s` stages; `kind` is the last letter."""
    name, order = f"lobatto-iii{kind}-{s}", 2 * s - 2
    with mpmath.workdps(DIGITS):
        legendre = mpmath.taylor(lambda x: mpmath.legendre(s - 1, x), 0, s - 1)
        inner = mpmath.polyroots([k * c for k, c in enumerate(legendre)][:0:-1], maxsteps=200, extraprec=200)
        nodes = [mpmath.mpf(0), *sorted((1 + mpmath.re(x)) / 2 for x in inner), mpmath.mpf(1)]
        iiia = collocation(name, nodes, order, REFERENCES[0])
        if kind == "a":
            return iiia
        a, b = mpmath.matrix(iiia.a), iiia.b
        if kind != "b":  # IIIC: the first column is b_1, and condition C(s - 1) determines the other columns
            powers = mpmath.matrix([[node**k for node in nodes[1:]] for k in range(s - 1)])
            for i in range(s):
                right = [nodes[i] ** (k + 1) / (k + 1) - b[0] * nodes[0] ** k for k in range(s - 1)]
                a[i, 0], rest = b[0], mpmath.lu_solve(powers, mpmath.matrix(right))
                for j in range(1, s):
                    a[i, j] = rest[j - 1]
        if kind != "c":  # the method a' that forms a symplectic pair with a: b_i a'_ij + b_j a_ji = b_i b_j
            partner = mpmath.matrix([[b[j] * (1 - a[j, i] / b[i]) for j in range(s)] for i in range(s)])
            # IIIB is the partner of IIIA; IIID is the mean of IIIC and its partner
            a = partner if kind == "b" else (a + partner) / 2
        return mbdkit.ButcherTableau(name, a.tolist(), b, nodes, order, REFERENCES[int(kind == "d")])


def _create(kind: str) -> Callable[[LobattoOptions], Method]:
    @integrator_method
    def create(options: LobattoOptions) -> mbdkit.ImplicitRungeKutta:
        solver, tolerance = options.stage_solver, options.tolerance
        return mbdkit.ImplicitRungeKutta(tableau(kind, options.stages), solver, tolerance, options.max_iterations)

    return create


def _claims(
    *, l_stable: bool = False, symmetric: bool = False, symplectic: bool = False, quadratic_invariants: bool = False
) -> Callable[[LobattoOptions], mbdkit.Claims]:
    @integrator_claims
    def claims_of(options: LobattoOptions) -> mbdkit.Claims:
        return mbdkit.Claims(
            order=2 * options.stages - 2,
            stages=options.stages,
            drift="constraints hold at acceleration level only: drift of the method's order, growing with time",
            needs=("tangents",) if options.stage_solver == "newton" else ("accelerations",),
            states=True,
            conserves=("linear-momentum",),
            a_stable=options.stage_solver == "newton",
            l_stable=l_stable and options.stage_solver == "newton",
            symmetric=symmetric,
            symplectic=symplectic,
            quadratic_invariants=quadratic_invariants,
        )

    return claims_of


create_a, create_b, create_c, create_d = (_create(kind) for kind in "abcd")
claims_a, claims_b, claims_c = _claims(symmetric=True), _claims(symmetric=True), _claims(l_stable=True)
claims_d = _claims(symmetric=True, symplectic=True, quadratic_invariants=True)
