"""Mechanisms: bodies, joints, forces, beams, states, functions of time, and formulas of force laws."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.expressions.recorded import Recorder as Recorder
    from mbdkit.expressions.recorded_derivatives import root as root, with_slope_at as with_slope_at
    from mbdkit.mechanism.angle_function import (
        AngleFunction as AngleFunction, AngleTable as AngleTable, Center as Center, expression_of as expression_of,
        value_at as value_at,
    )
    from mbdkit.mechanism.beam_shape import places_with_ends as places_with_ends, with_ends as with_ends
    from mbdkit.mechanism.beams import Beam as Beam, beam_of as beam_of, named_body as named_body, parts_of as parts_of
    from mbdkit.mechanism.bodies import Attachment as Attachment, Marker as Marker
    from mbdkit.mechanism.coordinate_function import (
        CoordinateExpressionError as CoordinateExpressionError, CoordinateTable as CoordinateTable,
    )
    from mbdkit.mechanism.element_kinds import element_kinds as element_kinds
    from mbdkit.mechanism.force_law import ARGUMENTS as ARGUMENTS
    from mbdkit.mechanism.forces import (
        AppliedLoad as AppliedLoad, Force as Force, PointForce as PointForce, SpringDamper as SpringDamper,
        Torque as Torque, TorsionSpring as TorsionSpring,
    )
    from mbdkit.mechanism.joint_friction import PinFriction as PinFriction
    from mbdkit.mechanism.joint_base import Constraint as Constraint
    from mbdkit.mechanism.joints import (
        SlidingJoint as SlidingJoint, Weld as Weld,
        force_of_reaction as force_of_reaction,
    )
    from mbdkit.mechanism.law_element import Law as Law
    from mbdkit.mechanism.mechanism import gravity_text as gravity_text
    from mbdkit.mechanism.mechanism_data import (
        Assembly as Assembly, MechanismData as MechanismData, NamedCoordinate as NamedCoordinate,
    )
    from mbdkit.mechanism.mechanism_quantities import (
        AXES as AXES, Affine as Affine, Coordinate as Coordinate, MarkerCoordinate as MarkerCoordinate,
        Quantity as Quantity, RelativeAngle as RelativeAngle, Travel as Travel,
    )
    from mbdkit.mechanism.motion_corners import corners_of as corners_of, jet_of as jet_of
    from mbdkit.mechanism.pathways import (
        AnglePathway as AnglePathway, JointAngles as JointAngles, TwoPoints as TwoPoints, path_ends as path_ends,
    )
    from mbdkit.mechanism.size import mechanism_size as mechanism_size, mechanism_sizes as mechanism_sizes
    from mbdkit.mechanism.state_values import (
        Controller as Controller, FirstOrderState as FirstOrderState, Input as Input, Value as Value,
        is_of_state as is_of_state, of_state as of_state, of_time as of_time,
    )
    from mbdkit.mechanism.switching_times import switching_times as switching_times
    from mbdkit.mechanism.values import (
        BodyPair as BodyPair, Motion as Motion, Points as Points, curve_of as curve_of,
        columns_of as columns_of, number_or_table as number_or_table, pair as pair, sequence as sequence,
    )
    from mbdkit.mechanism.variable_functions import (
        function_of as function_of, value_of_program as value_of_program, value_of_table as value_of_table,
        value_of_text as value_of_text, with_numbers as with_numbers,
    )
    from mbdkit.symbolic.symbolic_function import symbolic_function as symbolic_function
    from mbdkit.symbolic.symbolic_law import LENGTH as LENGTH, RATE as RATE, T as T, law_expressions as law_expressions
    from mbdkit.mechanism.extent import points_of_elements as points_of_elements
    from mbdkit.mechanism.mechanism_seams import lines_of as lines_of
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
