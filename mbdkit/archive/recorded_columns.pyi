"""Columns and labels of histories by group, written by ``python -m tests.history_columns``."""

import numpy as np

from mbdkit.archive.named_columns import Histories, View
from mbdkit.archive.history import BeamHistory
from mbdkit.archive.history import ConstraintHistory
from mbdkit.archive.history import ForceHistory
from mbdkit.archive.history import InputHistory
from mbdkit.archive.history import MarkerHistory
from mbdkit.archive.history import StateHistory
from mbdkit_biomech.histories import ActuatorHistory
from mbdkit_biomech.histories import KneeHistory
from mbdkit_biomech.histories import LoadHistory
from mbdkit_biomech.histories import MuscleHistory
from mbdkit_biomech.histories import ObservedHistory
from mbdkit_contact.histories import ContactHistory
from mbdkit_contact.histories import GroundReactionHistory
from mbdkit_wearable.histories import CuffHistory

class Trajectory(View, of="trajectory"):
    position: np.ndarray
    """position of the centre of mass, (T, 2), m"""
    angle: np.ndarray
    """angle from the global x axis, never wrapped, (T,), rad"""
    velocity: np.ndarray
    """velocity of the centre of mass, (T, 2), m/s"""
    angular_velocity: np.ndarray
    """angular velocity, (T,), rad/s"""
    acceleration: np.ndarray
    """acceleration of the centre of mass, (T, 2), m/s^2"""
    angular_acceleration: np.ndarray
    """angular acceleration, (T,), rad/s^2"""

class Joints(View, of="joints"):
    misalignment: np.ndarray
    """distance by which the joint fails to meet, (T,), m"""
    velocity_misalignment: np.ndarray
    """relative point velocity in the constrained directions, (T,), m/s"""
    angle_misalignment: np.ndarray
    """angle by which the joint fails to meet, (T,), rad"""
    reaction_force: np.ndarray
    """force of the first body on the second, global frame, (T, 2), N"""
    reaction_torque: np.ndarray
    """torque of the first body on the second, at the second's joint point, (T,), N m"""
    reaction_force_first: np.ndarray
    """reaction_force in the frame of the first body, (T, 2), N"""
    reaction_force_second: np.ndarray
    """reaction_force in the frame of the second body, (T, 2), N"""
    angle: np.ndarray
    """angle of the second body relative to the first, not wrapped; of a slide, its travel, (T,), units by row"""
    driver_power: np.ndarray
    """power that a driver supplies; 0 for other joints, (T,), W"""
    friction: np.ndarray
    """friction torque on the second body, positive counter-clockwise; of a slide, friction force on the second body along the travel; 0 for joints without friction, (T,), units by row"""
    bodies: tuple[str, str]
    angle_units: str

class Forces(View, of="forces"):
    length: np.ndarray
    """length or angle of the force element; 0 for a force at a point, (T,), units by row"""
    rate: np.ndarray
    """rate of length; of a force at a point, the velocity of the point along the force, (T,), units by row"""
    value: np.ndarray
    """tension, positive where it pulls together; torque on the second body, positive counter-clockwise; magnitude of a force at a point, (T,), units by row"""
    power: np.ndarray
    """power that the force element supplies to the bodies, (T,), W"""
    potential: np.ndarray
    """potential energy of the force element; 0 for loads and laws without a potential, (T,), J"""
    bodies: tuple[str, str]
    units: str

class Markers(View, of="markers"):
    position: np.ndarray
    """position of the marker, global frame, (T, 2), m"""
    velocity: np.ndarray
    """velocity of the marker, global frame, (T, 2), m/s"""
    body: str

class Beams(View, of="beams"):
    axial: np.ndarray
    """axial force in the middle of the element, positive in tension, (T, elements), N"""
    shear: np.ndarray
    """shear force in the middle of the element, (T, elements), N"""
    moment: np.ndarray
    """bending moment in the middle of the element, (T, elements), N m"""
    strain_energy: np.ndarray
    """strain energy of the element, (T,), summed over the elements, J"""

class States(View, of="states"):
    value: np.ndarray
    """value of the state, (T,), units by row"""
    rate: np.ndarray
    """derivative of the state by time, (T,), units by row"""
    units: str

class Inputs(View, of="inputs"):
    value: np.ndarray
    """value of the input, (T,), units by row"""
    units: str

class Constraints(View, of="constraints"):
    position_residual: np.ndarray
    """constraint function Phi(q, t), (T,), units by row"""
    velocity_residual: np.ndarray
    """time derivative of the constraint function, Phi_q v + Phi_t, (T,), units by row"""
    multiplier: np.ndarray
    """Lagrange multiplier, index-1, at the recorded state, (T,), units by row"""
    method_multiplier: np.ndarray
    """Lagrange multiplier as the integrator carries it; index-1 at the start, (T,), units by row"""
    units: str

class Energy(View, of="energy"):
    kinetic: np.ndarray
    """kinetic energy, (T,), J"""
    potential: np.ndarray
    """potential energy of gravity and springs, (T,), J"""
    total: np.ndarray
    """kinetic + potential energy, (T,), J"""
    dissipated: np.ndarray
    """energy dissipated since the start, (T,), J"""
    work: np.ndarray
    """work of applied loads and drivers since the start, (T,), J"""
    balance: np.ndarray
    """total + dissipated - work - total at the start: zero but for numerical error, (T,), J"""

class Steps(View, of="steps"):
    time: np.ndarray
    """time at the end of the interval, (N,), s"""
    steps: np.ndarray
    """steps taken in the interval, (N,), 1"""
    size: np.ndarray
    """size of the last step of the interval, (N,), s"""
    iterations: np.ndarray
    """stage iterations in the interval, summed over its steps, (N,), 1"""
    iterations_max: np.ndarray
    """most stage iterations of a step of the interval, (N,), 1"""
    rejected: np.ndarray
    """steps rejected in the interval, (N,), 1"""
    projections: np.ndarray
    """projections of positions and velocities onto the constraints in the interval, (N,), 1"""
    position_correction: np.ndarray
    """largest change of positions by a projection in the interval: sqrt(dq^T M dq / total mass), (N,), m"""
    velocity_correction: np.ndarray
    """largest change of velocities by a projection in the interval: sqrt(dv^T M dv / total mass), (N,), m/s"""
    acceleration_correction: np.ndarray
    """largest of Baumgarte's terms 2 alpha Phi' + beta^2 Phi at a step of the interval (rows of angles: rad/s^2), (N,), m/s^2"""

class Contacts(View, of="contacts"):
    gap: np.ndarray
    """distance of the two shapes, negative where they overlap, (T,), m"""
    normal_force: np.ndarray
    """force that pushes the bodies apart, (T,), N"""
    friction_force: np.ndarray
    """friction force on the second body, along the normal turned by -90 degrees, (T,), N"""
    slip: np.ndarray
    """velocity of the second body relative to the first, in that direction, (T,), m/s"""
    mode: np.ndarray
    """0: open, 1: sticks, 2: slips, (T,), 1"""
    bodies: tuple[str, str]

class GroundReactions(View, of="ground_reactions"):
    force: np.ndarray
    """force of all contacts with the ground on the body, global frame, (T, 2), N"""
    normal_force: np.ndarray
    """sum of the normal forces of these contacts, (T,), N"""
    center_of_pressure: np.ndarray
    """point about which the contacts with the ground have no moment, global frame; nan where none is closed, (T, 2), m"""

class Motion(View, of="motion"):
    raw: np.ndarray
    """measured value, nan in a gap, (T,), units by row"""
    fitted: np.ndarray
    """value of the fitted mechanism, before smoothing, (T,), units by row"""
    residual: np.ndarray
    """raw - fitted, (T,), units by row"""
    units: str

class Actuators(View, of="actuators"):
    value: np.ndarray
    """torque on the second body, positive counter-clockwise; force along a travel or a coordinate; tension between two points, (T,), units by row"""
    power: np.ndarray
    """power that the actuator supplies to the bodies, (T,), W"""
    value_error: np.ndarray
    """bound of the error of value that holds with a probability of 95 % at each time, nan where unknown, (T,), units by row"""
    units: str
    kind: str

class Muscles(View, of="muscles"):
    length: np.ndarray
    """length of the path, (T,), m"""
    rate: np.ndarray
    """rate of length, (T,), m/s"""
    fiber_length: np.ndarray
    """length of the fibres; nan where recruitment does not need it, (T,), m"""
    fiber_rate: np.ndarray
    """rate of fiber_length, (T,), m/s"""
    activation: np.ndarray
    """activation, from 0 to 1, (T,), 1"""
    excitation: np.ndarray
    """excitation, from 0 to 1; runs only, (T,), 1"""
    force: np.ndarray
    """tension, (T,), N"""
    power: np.ndarray
    """power that the muscle supplies to the bodies, (T,), W"""
    fiber_power: np.ndarray
    """power that the fibres supply; nan where fiber_length is, (T,), W"""
    metabolic_power: np.ndarray
    """power that the muscle consumes; nan without `metabolics`, (T,), W"""
    force_error: np.ndarray
    """bound of the error of force that holds with a probability of 95 % at each time, nan where unknown, (T,), N"""

class Knees(View, of="knees"):
    patellofemoral_force: np.ndarray
    """force of the patella on the thigh; nan without patella, (T,), N"""
    medial_force: np.ndarray
    """force in the medial compartment; nan if frontal moments are not known, (T,), N"""
    lateral_force: np.ndarray
    """force in the lateral compartment; nan if frontal moments are not known, (T,), N"""
    compression: np.ndarray
    """force along the shank, by recruitment; nan if not computed, (T,), N"""
    compression_lower: np.ndarray
    """how far the true compression may lie below, with a probability of 97.5 %; nan where unknown, (T,), N"""
    compression_upper: np.ndarray
    """how far the true compression may lie above, with a probability of 97.5 %; nan where unknown, (T,), N"""

class Loads(View, of="loads"):
    force: np.ndarray
    """force on the body, global frame, (T, 2), N"""
    point: np.ndarray
    """point of application, global frame, (T, 2), m"""
    torque: np.ndarray
    """free torque on the body, positive counter-clockwise, (T,), N m"""
    power: np.ndarray
    """power that the load supplies to the body, (T,), W"""
    body: str

class Cuffs(View, of="cuffs"):
    displacement: np.ndarray
    """displacement of the device's point in the frame of the limb, (T, 2), m"""
    rotation: np.ndarray
    """rotation of the device in the limb, (T,), rad"""
    normal_force: np.ndarray
    """force of the device on the limb, along the axis of the cuff, (T,), N"""
    shear_force: np.ndarray
    """force of the device on the limb, along the axis turned by 90 degrees, (T,), N"""
    moment: np.ndarray
    """moment of the device on the limb about the device's point, counter-clockwise, (T,), N m"""
    power: np.ndarray
    """power that the cuff supplies to both bodies, (T,), W"""
    bodies: tuple[str, str]

class FurtherKinds:
    @property
    def forces(self) -> Histories[ForceHistory]:
        """Length, force and energy of one force element."""
    @property
    def markers(self) -> Histories[MarkerHistory]:
        """Position and velocity of one marker in the global frame."""
    @property
    def beams(self) -> Histories[BeamHistory]:
        """Shape, internal forces and strain energy of one beam."""
    @property
    def states(self) -> Histories[StateHistory]:
        """Value and rate of one first-order state."""
    @property
    def inputs(self) -> Histories[InputHistory]:
        """Value of one input, in `units`. A row at a time at which the input was set shows the value before it."""
    @property
    def constraints(self) -> Histories[ConstraintHistory]:
        """Residuals and multipliers of one constraint row, whose constraint function is in `units`: ``m`` or ``rad``."""
    @property
    def contacts(self) -> Histories[ContactHistory]:
        """Gap, forces, slip and mode of one contact."""
    @property
    def ground_reactions(self) -> Histories[GroundReactionHistory]:
        """Force of the ground on one body [N], and its centre of pressure [m], nan where the body is in the air."""
    @property
    def motion(self) -> Histories[ObservedHistory]:
        """One observed quantity of a measured motion: measured value, and value of the fitted mechanism."""
    @property
    def actuators(self) -> Histories[ActuatorHistory]:
        """Value [N or N m] of one actuator in inverse dynamics, the error of the value, and the power."""
    @property
    def muscles(self) -> Histories[MuscleHistory]:
        """Length, fibres, activation, tension [N] with its error, and power of one muscle."""
    @property
    def knees(self) -> Histories[KneeHistory]:
        """Forces [N] in one knee beside that of the joint: of the patella on the thigh, in both compartments, and the"""
    @property
    def loads(self) -> Histories[LoadHistory]:
        """One measured load, in inverse dynamics; force and point of application are in the global frame."""
    @property
    def cuffs(self) -> Histories[CuffHistory]:
        """One cuff: displacement and rotation in the frame of the limb, and the forces of the device on the limb."""
