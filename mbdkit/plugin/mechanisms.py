"""Mechanisms: bodies, joints, forces, beams, states, functions of time, and formulas of force laws."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.expressions.recorded_derivatives import root as root, with_slope_at as with_slope_at
    from mbdkit.mechanism.bodies import Attachment as Attachment
    from mbdkit.mechanism.forces import (
        PointForce as PointForce, SpringDamper as SpringDamper, Torque as Torque, TorsionSpring as TorsionSpring,
    )
    from mbdkit.mechanism.joints import SlidingJoint as SlidingJoint
    from mbdkit.mechanism.pathways import AnglePathway as AnglePathway
    from mbdkit.mechanism.size import mechanism_size as mechanism_size
    from mbdkit.mechanism.values import (
        BodyPair as BodyPair, Motion as Motion, columns_of as columns_of, curve_of as curve_of,
        number_or_table as number_or_table, pair as pair,
    )
    from mbdkit.mechanism.variable_functions import (
        function_of as function_of, value_of_program as value_of_program, value_of_table as value_of_table,
        value_of_text as value_of_text, with_numbers as with_numbers,
    )
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
