"""Bundles of a mechanism for its kernels: what is constant, scratch, solvers, and all of them together."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from mbdkit.engine.kernels import table_rows as columns
from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealMatrix, RealVector, example_of
from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.kernels.schur import Schur
from mbdkit.engine.native.bundle import bundle_loader


class Topology(NamedTuple):
    """A compiled mechanism: all data that do not change during a run.

    B is the number of bodies without ground, P of pairs of constraint rows, S of segments of springs, X of pairs of
    segments of the same spring, L of loads, C of interactions, G of cross-sections of beams,
    E of their elements, J of joints, K of markers. All force elements on a pathway are called springs, whatever their
    law. Most have one segment; the length of one with several is the sum over its segments. The columns of tables have
    names; see `mbdkit.engine.kernels.table_rows`.
    """

    mass: Annotated[RealMatrix, 3]  #: (B + 1, 3) diagonal of the mass matrix; ground has ones.
    #: (B + 1, 3) inverse of `mass`; ground has zeros, so that no force accelerates it.
    weight: Annotated[RealMatrix, 3]
    gravity: RealVector  #: (2,) gravity [m/s^2].
    pairs: Annotated[IntMatrix, len(columns.PAIR)]  #: (P,) pairs of constraint rows.
    rows: IntVector  #: (P,) number of rows that are solved for, 0, 1 or 2.
    #: (1,) length [m] that is compared with an angle of 1 rad: the characteristic length of the mechanism, at most 1 m.
    length: RealVector
    row_units: Annotated[RealMatrix, 2]  #: (P, 2) `length` for rows whose Phi is a length, 1 for angles.
    #: (P, 6) parameters of each pair, the two points first; see `mbdkit.engine.kernels.element_kernels`.
    pair_parameters: Annotated[RealMatrix, 6]
    spare: Annotated[IntMatrix, len(columns.SPARE)]  #: (D,) redundant directions, which are not solved for.
    #: (D, 2) unit vectors of the redundant directions in that frame, as coefficients of the pair's two rows; (1, 0) for
    #: a pair with a single row.
    spare_axes: Annotated[RealMatrix, 2]
    springs: Annotated[IntMatrix, len(columns.SPRING)]  #: (S,) segments of springs.
    #: (S, 6) parameters of the segments: the points in the frames of both bodies, and further ones.
    spring_points: Annotated[RealMatrix, 6]
    #: (X,) ordered pairs of different segments of the same spring.
    couplings: Annotated[IntMatrix, len(columns.COUPLING)]
    linear: Annotated[RealMatrix, len(columns.LINEAR)]  #: (S,) linear springs.
    laws: Annotated[IntMatrix, len(columns.LAW_ROW)]  #: (W,) laws of all other springs.
    #: (N,) for each law its number of parameters, followed by their values; a parameter that is a state has its initial
    #: value.
    law_parameters: RealVector
    #: (Z,) first-order states; the states of an element follow one another.
    states: Annotated[IntMatrix, len(columns.STATE_ROW)]
    #: (Y,) all elements of `law_parameters` that hold the value of a state.
    state_places: Annotated[IntMatrix, len(columns.STATE_USE)]
    inputs: Annotated[IntMatrix, len(columns.INPUT)]  #: (N,) inputs of expressions of the state.
    #: (V,) components of loads that are expressions of the state, whose values replace those of motions.
    load_values: Annotated[IntMatrix, len(columns.LOAD_VALUE)]
    #: (D,) derivatives of these components with respect to their inputs.
    slopes: Annotated[IntMatrix, len(columns.SLOPE)]
    frictions: IntVector  #: (F,) segment of the force element of each joint with friction.
    reactions: Annotated[IntMatrix, len(columns.MULTIPLIER)]  #: (N,) multipliers on which these frictions depend.
    loads: Annotated[IntMatrix, len(columns.LOAD)]  #: (L,) forces and torques on bodies.
    load_points: Annotated[RealMatrix, 2]  #: (L, 2) point of application of each load in the frame of its body [m].
    #: (C,) interactions, which are forces and torques on two bodies that depend on their poses and velocities.
    interactions: Annotated[IntMatrix, len(columns.INTERACTION)]
    #: (G,) cross-sections at which the elements of beams are integrated.
    sections: Annotated[IntMatrix, len(columns.SECTION)]
    #: (G, 16) values and derivatives with respect to the arc length of the shape functions of three nodes, then the
    #: parameters of the cross-section; see `mbdkit_statics.element_definitions.derive_section`.
    section_parameters: Annotated[RealMatrix, 16]
    force_place: IntVector  #: (S + L,) index of the force element of each segment and of each load.
    pair_joint: IntVector  #: (P,) number of the joint of each pair.
    joints: Annotated[IntMatrix, len(columns.JOINT)]  #: (J,) joints whose angle or travel is recorded.
    #: (J, 6) line of a travel: the points in the frames of both bodies and the unit vector in the first; else zeros.
    joint_lines: Annotated[RealMatrix, 6]
    markers: IntVector  #: (K,) body of each marker.
    marker_points: Annotated[RealMatrix, 2]  #: (K, 2) marker in the frame of its body [m].
    #: (C, 2) first and second body of each center that moves with their relative angle; see
    #: `mbdkit.engine.kernels.motions`.
    centers: Annotated[IntMatrix, 2]
    functions: Annotated[IntMatrix, len(columns.FUNCTION)]  #: (F,) constraints that are functions of the pose.
    #: Start of the program of each motion; see `mbdkit.engine.kernels.motions.evaluate_motions`.
    motion_start: IntVector
    motion_ops: IntVector
    motion_values: RealVector
    #: (2,) alpha, beta [1/s] of Baumgarte stabilization, which modifies gamma; zeros without stabilization.
    baumgarte: RealVector


class Reacting(NamedTuple):
    """Elements whose reactions the steps determine, such as rigid contacts: what core and their part exchange.

    Addresses are those of entries (`mbdkit.engine.native.kernel`) and of bundles; all are 0 without such elements.
    """

    acts: IntVector  #: (1,) whether their forces are added to solutions of the equations of motion.
    #: (1,) address of the function that adds them: it changes `acc`, `lam` and `power` and returns a status.
    add_forces: IntVector
    engine: IntVector  #: (1,) its first argument: the engine in whose equations the elements react.
    elements: IntVector  #: (1,) its second argument: the bundle of the elements.
    constrain: IntVector  #: (1,) address of the function that constrains the solutions of implicit steps.
    run: IntVector  #: (1,) its first argument: the bundle of the run.
    stages: IntVector  #: (1,) its second argument: the bundle of the constrained stages.
    shows: IntVector  #: (1,) whether forces at the end of the next step, or within it, are recorded.
    q: RealVector  #: (3 (B + 1),) positions for which accelerations were solved.
    v: RealVector  #: (3 (B + 1),) velocities.
    #: (3 (B + 1),) accelerations, without and then with the reactions; this and the last two are empty without such
    #: elements.
    acc: RealVector
    lam: Annotated[RealMatrix, 2]  #: (P, 2) multipliers, without and then with the reactions.
    power: RealVector  #: (1,) power that the elements dissipate [W].


class Scratch(NamedTuple):
    """Working arrays of one run.

    `source` holds all terms of the stage matrix; `jac`, `stiff` and the other arrays of terms are views of it.
    """

    time: RealVector  #: (1,) time of the last `prepare` [s].
    #: (2,) earliest and latest time at which motions are evaluated [s]; see `Workspace.clamp_motions`.
    sides: RealVector
    cs: Annotated[RealMatrix, 2]  #: (B + 1, 2) cosine and sine of every angle.
    #: (motions + 19 F, 3) value, first and second derivative of each motion with respect to time, then of the functions
    #: of each moving center with respect to the angle; then, for each function of the pose, its value and its
    #: derivatives with respect to x, y, the relative angle, the angle of the first body, and time, in lexicographic
    #: order: 5 first and 15 second ones in 7 rows, 35 third ones in 12 rows.
    u: Annotated[RealMatrix, 3]
    stack: RealMatrix  #: Stack of `evaluate_motions`.
    force: RealVector  #: (3 (B + 1),) generalized applied forces without gravity.
    phi: Annotated[RealMatrix, 2]  #: (P, 2) constraint residuals Phi.
    phi_t: Annotated[RealMatrix, 2]  #: (P, 2) partial derivatives of Phi with respect to time.
    gamma: Annotated[RealMatrix, 2]  #: (P, 2) right-hand side of ``Phi_q a = gamma``.
    refinement: Annotated[RealMatrix, 2]  #: (P, 2) residual and correction of the iterative refinement.
    s: Annotated[RealMatrix, 1]  #: (S, 1) length of the pathway of each segment, the sum over its segments.
    grad: Annotated[RealMatrix, 6]  #: (S, 6) gradients s_q of the segments.
    hess: Annotated[RealMatrix, 36]  #: (S, 36) second derivatives s_qq of the segments.
    guide: Annotated[RealMatrix, 9]  #: `mbdkit_statics.element_definitions.GUIDE` of each guided segment.
    #: (S + 1, 4) force, its derivatives and potential of the spring of each segment; the last row is a work array.
    tension: Annotated[RealMatrix, len(columns.TENSION)]
    #: (C, 6) forces and torques of the interactions on their first and second bodies.
    interaction: Annotated[RealMatrix, 6]
    #: (1, 72) work array: the derivatives of these with respect to positions and velocities of both bodies.
    interaction_slopes: Annotated[RealMatrix, 72]
    #: (G, 10) state of each cross-section of a beam, its rates, cosine and sine of its angle.
    section: Annotated[RealMatrix, 10]
    section_force: Annotated[RealMatrix, 4]  #: (G, 4) forces conjugate to these states.
    section_stress: Annotated[RealMatrix, 3]  #: (G, 3) axial force, shear force and bending moment.
    #: (G, 2) strain energy and dissipated power of the part of the beam that the cross-section represents.
    section_energy: Annotated[RealMatrix, 2]
    section_stiff: Annotated[RealMatrix, 16]  #: (G, 16) derivatives of the forces with respect to the states.
    section_damp: Annotated[RealMatrix, 16]  #: (G, 16) derivatives of the forces with respect to the rates.
    #: (N,) parameters of laws as in `Topology.law_parameters`, but with the present values of states and inputs.
    #: Without states, inputs and interactions, it is that array itself.
    law_values: RealVector
    #: (F, F + 3) matrix and right side of Newton's method for the friction in joints, the frictions, and their scales.
    friction: RealMatrix
    #: (N, F + 1) change of each multiplier in ``Topology.reactions`` by a unit of each friction; the value of the
    #: multiplier in the last column.
    response: RealMatrix
    reacting: Reacting
    faulty: IntVector  #: (1,) row of the last law whose force or required derivatives were not finite; -1 for none.
    source: RealVector  #: All terms of the stage matrix, one after another; the constant masses are stored there once.
    jac: Annotated[RealMatrix, 12]  #: (P, 12) Jacobian Phi_q, two rows of six columns for each pair.
    stiff: Annotated[RealMatrix, 36]  #: (P, 36) d(Phi_q^T lam)/dq.
    gamma_v: Annotated[RealMatrix, 12]  #: (P, 12) d gamma/dv.
    res_q: Annotated[RealMatrix, 12]  #: (P, 12) d(Phi_q a - gamma)/dq.
    spring_stiff: Annotated[RealMatrix, 36]  #: (S, 36) -dQ/dq of the springs.
    spring_damp: Annotated[RealMatrix, 36]  #: (S, 36) -dQ/dv of the springs.
    #: (X, 36) -dQ/dq of springs with several segments: Q on the first segment of a coupling, q of the second.
    coupled_stiff: Annotated[RealMatrix, 36]
    coupled_damp: Annotated[RealMatrix, 36]  #: (X, 36) -dQ/dv of the same springs.
    #: (D, 36) -dQ/dq of loads whose value is an expression of the state, due to one of its inputs.
    slope_stiff: Annotated[RealMatrix, 36]
    slope_damp: Annotated[RealMatrix, 36]  #: (D, 36) -dQ/dv of the same loads.
    interaction_stiff: Annotated[RealMatrix, 36]  #: (C, 36) -dQ/dq of the interactions.
    interaction_damp: Annotated[RealMatrix, 36]  #: (C, 36) -dQ/dv of the interactions.
    #: (L, 3) -dQ/dq of the loads; see `mbdkit.engine.kernels.applied_forces.force_tangents`.
    load_stiff: Annotated[RealMatrix, 3]
    beam_stiff: Annotated[RealMatrix, 81]  #: (G, 81) -dQ/dq of the cross-sections of beams, for three nodes.
    beam_damp: Annotated[RealMatrix, 81]  #: (G, 81) -dQ/dv of the cross-sections of beams, for three nodes.
    loose: Annotated[RealMatrix, 6]  #: (D, 6) Jacobian of the redundant directions.
    push: RealVector  #: (3 (B + 1),) accelerations caused by a single multiplier.
    right: RealVector  #: (n,) right-hand side of the pivoted system.
    solution: RealVector  #: (n,) solution of the pivoted system.
    correction: RealVector  #: (n,) correction of that solution by iterative refinement, later the residual.


class Scatter(NamedTuple):
    """Index pairs that add the entries of `Scratch.source` to the values of a sparse matrix, grouped by factor.

    The factors contain the step h and the eigenvalue mu of the stage matrix.
    """

    one: Annotated[IntMatrix, 2]  #: (n1, 2) source, target; factor 1 (masses, Jacobian).
    rate: Annotated[IntMatrix, 2]  #: (n2, 2) source, target; factor h mu (damping).
    minus_rate: Annotated[IntMatrix, 2]  #: (n3, 2) source, target; factor -h mu (gamma_v).
    level: Annotated[IntMatrix, 2]  #: (n4, 2) source, target; factor h^2 mu^2 (stiffness, residual_q).


class Solver(NamedTuple):
    """Solver for accelerations: the Schur complement, or pivoted LU of the whole system."""

    pivoted: IntVector  #: (1,) whether the pivoted solver is in use.
    schur: Schur
    pattern: Pattern
    factors: Factors
    scatter: Scatter
    #: (P, 2) number of the unknown of each multiplier in the pivoted system; -1 for an empty row.
    row_index: Annotated[IntMatrix, 2]
    failed: IntVector  #: (1,) pair or pivot position at which the last factorization failed.


class LaneSolver(NamedTuple):
    """Solver for accelerations in lanes, where every run uses the Schur complement; see `Solver`."""

    schur: Schur
    row_index: Annotated[IntMatrix, 2]
    failed: IntVector


class Engine(NamedTuple):
    """Mechanism, working arrays and solver; kernels called from Python take the address of a pinned engine."""

    top: Topology
    w: Scratch
    solver: Solver


load_engine = bundle_loader(lambda: example_of(Engine))
