"""Groups of the archive that muscles and inverse dynamics add: motion, actuators, muscles, loads and followers."""

from __future__ import annotations

from typing import Any

from mbdkit.quantities.array import MIXED, Array, Chart, Recorded
from mbdkit.quantities.entries import AXIS, JOINT, name_array, quantity_group, unit_array
from mbdkit_biomech.muscles.muscle_values import MuscleValues

_TIME = Array("time", ("time",), "s", "time of the recorded row")
_T, _TJ, _TJA, _TU = ("time",), ("time", "joint"), ("time", "joint", "axis"), ("time", "muscle")
_TK, _TA = ("time", "observed"), ("time", "actuator")
_TL, _TLA, _TN = ("time", "load"), ("time", "load", "axis"), ("time", "knee")

#: Groups of inverse dynamics; a group without elements is absent.
INVERSE_GROUPS = ("motion", "actuators", "muscles", "knees", "loads", "followers")

#: Paths of the arrays of muscles that inverse dynamics does not record.
MUSCLES_OF_RUNS = frozenset(("muscles/excitation",))


def _of_muscles(name: str, units: str, what: str, **more: Any) -> Recorded:
    return Recorded(name, _TU, units, what, take=lambda s: s.of(MuscleValues).array(name), **more)


def _of_knees(column: int, name: str, text: str, unknown: str) -> Recorded:
    chart = Chart(
        name.replace("_", "-"), f"Force {text}", "Positive where surfaces are pressed together.", "force", "N"
    )
    what = f"force {text}; nan {unknown}"
    return Recorded(name, _TN, "N", what, take=lambda s: s.handles["knees"][:, :, column], charts=(chart,))


def _bar_of_knees(column: int, side: str, way: str) -> Recorded:
    what = f"how far the true compression may lie {way}, with a probability of 97.5 %; nan where unknown"
    return Recorded(f"compression_{side}", _TN, "N", what, take=lambda s: s.handles["knees"][:, :, column])


# fmt: off
MOTION = quantity_group(
    "motion",
    _TIME,
    name_array("observed", "observed", "name of the observed quantity", lambda names: names.names_of("motion")),
    unit_array("row_units", "observed", "raw, fitted and residual", lambda names: names.bodies_of("motion", 0),
        label="units"),
    JOINT,
    Array("raw", _TK, MIXED, "measured value, nan in a gap", row_units="row_units"),
    Array("fitted", _TK, MIXED, "value of the fitted mechanism, before smoothing", row_units="row_units"),
    Array("residual", _TK, MIXED, "raw - fitted", row_units="row_units"),
    Array("raw_misalignment", _TJ, "m",
        "misalignment of the joint if the data alone place the bodies, nan where they do not"),
    optional=True, word="motion", one="observed quantity", axis="observed", may_be_unknown=True,
)

ACTUATORS = quantity_group(
    "actuators",
    _TIME,
    name_array("actuator", "actuator", "name of the actuator", lambda names: names.names_of("actuators")),
    unit_array("row_units", "actuator", "value", lambda names: names.bodies_of("actuators", 0), label="units"),
    name_array("kind", "actuator", "actuator, reserve of recruitment, or residual load from outside",
        lambda names: names.bodies_of("actuators", 1), label="kind"),
    Recorded("value", _TA, MIXED,
        "torque on the second body, positive counter-clockwise; force along a travel or a coordinate; tension "
        "between two points",
        take=lambda s: s.handles["actuators"][:, :, 0], row_units="row_units"),
    Recorded("power", _TA, "W", "power that the actuator supplies to the bodies",
        take=lambda s: s.handles["actuators"][:, :, 1]),
    Array("value_error", _TA, MIXED,
        "bound of the error of value that holds with a probability of 95 % at each time, nan where unknown",
        row_units="row_units"),
    optional=True, word="actuators", one="actuator", example="value", axis="actuator",
    is_optional=True, may_be_unknown=True,
)

MUSCLES = quantity_group(
    "muscles",
    _TIME,
    name_array("muscle", "muscle", "name of the muscle", lambda names: names.names_of("muscles")),
    JOINT, AXIS,
    _of_muscles("length", "m", "length of the path"),
    _of_muscles("rate", "m/s", "rate of length"),
    _of_muscles("fiber_length", "m", "length of the fibres; nan where recruitment does not need it"),
    _of_muscles("fiber_rate", "m/s", "rate of fiber_length"),
    _of_muscles("activation", "1", "activation, from 0 to 1",
        charts=(Chart("activations", "Activations of the muscles", "Active force over capacity.", "activation",
            "1"),)),
    _of_muscles("excitation", "1", "excitation, from 0 to 1; runs only"),
    _of_muscles("force", "N", "tension",
        charts=(Chart("tensions", "Tensions of the muscles", "Along the tendons.", "tension", "N"),)),
    _of_muscles("power", "W", "power that the muscle supplies to the bodies"),
    _of_muscles("fiber_power", "W", "power that the fibres supply; nan where fiber_length is"),
    _of_muscles("metabolic_power", "W", "power that the muscle consumes; nan without `metabolics`"),
    Array("force_error", _TU, "N",
        "bound of the error of force that holds with a probability of 95 % at each time, nan where unknown"),
    Array("certificate", _T, "1",
        "largest violation of the conditions of optimality by recruitment, relative to the size of each"),
    Array("reaction_force_without", _TJA, "N", "reaction_force if actuators produced the motion without muscles"),
    optional=True, word="muscles", one="muscle", example="force", axis="muscle", is_optional=True,
    may_be_unknown=True,
)

KNEES = quantity_group(
    "knees",
    _TIME,
    name_array("knee", "knee", "name of the joint", lambda names: names.names_of("knees")),
    _of_knees(0, "patellofemoral_force", "of the patella on the thigh", "without patella"),
    _of_knees(1, "medial_force", "in the medial compartment", "if frontal moments are not known"),
    _of_knees(2, "lateral_force", "in the lateral compartment", "if frontal moments are not known"),
    _of_knees(3, "compression", "along the shank, by recruitment", "if not computed"),
    _bar_of_knees(4, "lower", "below"),
    _bar_of_knees(5, "upper", "above"),
    optional=True, word="knees", one="knee", example="medial_force", axis="knee", is_optional=True,
    may_be_unknown=True,
)

LOADS = quantity_group(
    "loads",
    _TIME,
    name_array("load", "load", "name of the measured load", lambda names: names.names_of("loads")),
    AXIS,
    name_array("body", "load", "body that the load acts on", lambda names: names.bodies_of("loads", 0), label="body"),
    Array("force", _TLA, "N", "force on the body, global frame"),
    Array("point", _TLA, "m", "point of application, global frame"),
    Array("torque", _TL, "N m", "free torque on the body, positive counter-clockwise"),
    Array("power", _TL, "W", "power that the load supplies to the body"),
    optional=True, word="loads", one="load", axis="load", is_optional=True,
)

FOLLOWERS = quantity_group(
    "followers",
    _TIME,
    name_array("follower", "follower", "name of the bodies that follow the motion, such as a worn device",
        lambda names: names.names_of("followers")),
    JOINT, AXIS,
    Array("reaction_force_without", _TJA, "N", "reaction_force for the same motion without these bodies"),
    optional=True, is_optional=True,
)
# fmt: on
