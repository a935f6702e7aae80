"""Arrays of event-driven contacts on one mechanism."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from mbdkit.engine.kernels.bundle_types import (
    STATE,
    ComplexMatrix,
    ComplexVector,
    IntMatrix,
    IntVector,
    RealCube,
    RealMatrix,
    RealVector,
    example_of,
)
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit_contact.kernels.contact_forces import ClosedContacts
from mbdkit_contact.kernels.impacts import ImpactBundle

#: Kinds of event functions: gap or normal force, slip or how far the friction force is from its limit, and the place on
#: an edge of a polygon.
NORMAL, FRICTION, PLACE = range(3)
UNKNOWN = -2  #: Kind in place of that of an event if the search has given up; the step has to be shorter.
#: Why a step fails: a contact that its own friction presses together, no forces satisfy Coulomb's law, no impulses
#: satisfy the law of impact, too many events, no positions in which joints and contacts are closed, or a larger number
#: of contacts that act at once than the arrays have room for, which is no failure.
PAINLEVE, NO_MODES, NO_IMPULSES, ZENO, OPEN_JOINTS, MORE_ROOM = range(1, 7)
KEPT_STRIKES = 32  #: Number of impacts whose data are kept until Python takes them.


class Known(NamedTuple):
    """What one step passes to the next; C contacts, N = 3 (B + 1)."""

    modes: RealVector  #: (C,) modes: `OPEN`, `STICK`, or `SLIP` times the direction of the slip.
    features: RealVector  #: (C,) features at which closed contacts stay, or -1; see `Shapes.held`.
    #: (1 + 2 C,) number of independent equations of the forces in these modes, or 0, and the places of all equations,
    #: these first; see `mbdkit_contact.kernels.contact_forces.find_few_forces`.
    basis: IntVector
    shares: RealVector  #: How redundant forces are shared; see `mbdkit_contact.kernels.contact_forces.spread`.
    #: (2,) whether the modes are known, not at the start and after a discontinuity, and whether the forces in `shown`
    #: at the end of the last step are those of this state, and not of a stage before it.
    determined: IntVector
    #: (2,) event at which the last step has ended, and with which the next one begins: its kind plus 1, or 0 if there
    #: is none, and its contact.
    event: IntVector
    streak: IntVector  #: (1,) number of consecutive steps that ended at an event.
    normal: RealVector  #: (C,) forces at the end of the step [N].
    tangent: RealVector
    force: RealVector  #: (N,) generalized forces of all contacts.
    energy: RealVector  #: (1,) largest kinetic energy so far [J].
    #: (2,) first times at which a sequence of impacts was cut short, and at which several contacts that affect each
    #: other closed at once [s]; infinite without these.
    times: RealVector
    #: (4, C) contacts whose infinite sequence of impacts was cut short, with another law of impact than the chosen one,
    #: with normal forces that were not unique, and with simultaneous impacts whose order matters.
    flags: IntMatrix
    number: IntVector  #: (2,) numbers of rows in `rows` and of impacts in `strikes` that Python has not taken yet.
    #: (R, 6) impacts of contacts: time [s], contact, impulses [N s], lost energy [J], row of `strikes` or -1.
    rows: RealMatrix
    strikes: RealMatrix  #: (S, N + 2 P) positions, and multipliers of the impulses of joints.
    #: (2,) time at which `event` happens, and size of the last step that has resolved the forces [s].
    until: RealVector
    shown: RealMatrix  #: (2, H) forces and modes that rows show at the start and at the end of the last step.
    shift_q: RealVector  #: (N,) change of the end of the last step by closing joints and contacts.
    shift_v: RealVector


CUT, CHANGED, UNDETERMINED, ORDERED = range(4)  #: Rows of `Known.flags`.


class EventSearch(NamedTuple):
    """Search for the first event in a step; shares are those of the step, arrays (3, C) belong to event functions."""

    best: RealCube  #: (3, C, 2) share and value of the largest sample before the first negative one.
    #: (3, C, 4) shares and values of the last two samples, or after the first negative one, of the least one.
    last: RealCube
    high: RealMatrix  #: (3, C) share of the first sample that is negative or may be; infinite if there is none.
    limits: RealMatrix  #: (3, C) smallest absolute values that do not count as zero.
    #: (C,) gaps of open contacts at the start of the step that are negative, for example by rounding errors; else 0.
    level: RealVector
    #: (4,) phase, kind and contact of the function that is searched, and number of its evaluations in the phase.
    state: IntVector
    #: (7,) share and value at both ends of the bracket and at the point before, and the share to be evaluated.
    bracket: RealVector
    #: (1,) share of the first event found, and (2,) its kind and contact; the kind is -1, or `UNKNOWN`, if the step has
    #: to end there without an event.
    first: RealVector
    event: IntVector
    step: RealVector  #: (1,) size of the step [s].


class Touch(NamedTuple):
    """Search for the first touch of shapes within a step; see `mbdkit_contact.kernels.first_touch`."""

    near: IntVector  #: (C,) contacts that may touch.
    #: (C, 2) largest distances of the outlines that may touch from the origins of the frames of both bodies [m],
    #: infinite for lines.
    arms: Annotated[RealMatrix, 2]
    #: (4, N) coefficients of the cubic motion of a piece of the step, in ascending powers of its shares.
    piece: RealMatrix
    #: (B + 1, 7) bounds of the velocity, acceleration and jerk of the bodies, and of the first four derivatives of the
    #: components of a unit vector that turns with them, by shares of the piece.
    bounds: Annotated[RealMatrix, 7]
    #: (B + 1, 7) states of bodies at the start of a part of the piece; see `Shapes.states`.
    before: Annotated[RealMatrix, 7]
    hull: Annotated[RealMatrix, 2]  #: (4, 2) control points of the path of a point in this part.
    nodes: RealMatrix  #: (4, N) positions and velocities at both ends of the piece.


class Newton(NamedTuple):
    """Constraints of up to K closed contacts in the linear systems of implicit steps, U = 2 K."""

    answers: ComplexMatrix  #: (U, N + M) solutions of these systems for unit forces; M is the number of multipliers.
    right: ComplexVector  #: (N + M,) right side of a system.
    #: (U, 2) bodies of the constraints, and (U, 6) their derivatives; see `ClosedContacts`.
    sites: Annotated[IntMatrix, 2]
    held: Annotated[RealMatrix, 6]
    #: (U, U) equations of the forces with which solutions satisfy the constraints, and their inverse matrix.
    matrix: ComplexMatrix
    inverse: ComplexMatrix
    #: (3,) numbers of the Jacobian and of the eigenvalue to which these arrays belong, and number of forces.
    key: IntVector
    real: RealVector  #: (N + M,) right side and solution of a real system.
    solved: RealVector


class EventBundle(NamedTuple):
    """Event-driven contacts of a mechanism; U <= 2 K forces of contacts that act at once, L < 64 samples in a step."""

    #: (4,) addresses of the bundle and of the functions ``attempt``, ``dense`` and ``keep`` of the method between
    #: events.
    inner: IntVector
    engine: IntVector  #: (1,) address of the bundle of mechanism, working arrays and solver.
    still: Topology  #: The mechanism without gravity.
    coefficients: Annotated[RealMatrix, 3]  #: (C, 3) coefficients of restitution, and of static and kinetic friction.
    law: IntVector  #: (1,) number of the law of impact.
    #: (6,) share of the energy below which sequences of impacts are cut, length of the mechanism [m], mass [kg],
    #: relative and absolute tolerance of controlled steps, and the least value of the largest velocity [m/s].
    limits: RealVector
    #: (2,) index of the first of the states that hold forces and modes, and their number; (D,) coordinates whose sums
    #: of forces follow them.
    places: IntVector
    coordinates: IntVector
    known: Annotated[Known, STATE]
    #: (1,) time, and (N,) positions, velocities, and (Z,) first-order states of the point that is looked at.
    t: RealVector
    q: RealVector
    v: RealVector
    z: RealVector
    a: RealVector  #: (N,) accelerations at the point, those without contacts, and work arrays.
    free: RealVector
    x: RealVector
    y: RealVector
    rest: RealVector  #: (N,) zeros.
    gained: RealVector  #: (2,) work and dissipated energy of an event [J].
    lam: Annotated[RealMatrix, 2]  #: (P, 2) multipliers, and those of impulses.
    lam_x: Annotated[RealMatrix, 2]
    #: (C, 16) quantities of all contacts at the point; see `mbdkit_contact.contact_rows.QUANTITIES`.
    rows: Annotated[RealMatrix, 16]
    normal: RealVector  #: (C,) forces at the point [N].
    tangent: RealVector
    touching: IntVector  #: (C,) contacts that touch, or that act in another way.
    sliding: RealVector  #: (C,) directions of slip, 1 or -1; 0 for contacts that do not slip.
    struck: IntVector  #: (C,) contacts that take part in an impact, and the rates of their gaps before it.
    approach: RealVector
    #: (C,) sizes of the rate of the gap of open contacts, and of the slip of others, at the start of the step.
    pace: RealVector
    modes: RealVector  #: (C,) modes that are decided, and copies of modes and features.
    kept_modes: RealVector
    kept_features: RealVector
    #: (3, C) event functions at the point, negative after an event; nan where they are not evaluated.
    values: RealMatrix
    gaps: RealVector  #: (C,) gaps at the end of the step.
    #: (3,) number of samples of contact forces in the step; whether they are taken; 0 if they are unique, 1 if they are
    #: of nearly least norm, and 2 if those of some contacts are left out.
    samples: IntVector
    sample_times: RealVector  #: (L,) their times, and (L, 3, C) normal forces, friction forces and slips.
    sample_values: RealCube
    power: IntVector  #: (1,) whether forces other than those of contacts do work or dissipate energy.
    #: (2,) whether `rows` are those of the state between two steps; whether joints and contacts had to be closed at the
    #: end of the step.
    ended: IntVector
    begin: RealMatrix  #: (3, C) event functions at the start and at the end of the step.
    end: RealMatrix
    search: EventSearch
    touch: Touch
    closed: ClosedContacts
    basis: IntVector  #: Work arrays in place of ``known.basis`` and ``known.shares``.
    shares: RealVector
    newton: Newton
    impacts: ImpactBundle
    pauses: IntVector  #: (1,) whether attempts return `PAUSED` after an event at their start.
    reason: IntVector  #: (2,) why the last call failed, and the contact; 0 if not.


load_events = bundle_loader(lambda: example_of(EventBundle))
