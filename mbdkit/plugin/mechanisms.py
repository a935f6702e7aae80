"""Mechanisms: bodies, joints, forces, beams, states, functions of time, and formulas of force laws."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.mechanism.bodies import Attachment as Attachment
    from mbdkit.mechanism.forces import (
        PointForce as PointForce, SpringDamper as SpringDamper, Torque as Torque, TorsionSpring as TorsionSpring,
    )
    from mbdkit.mechanism.joints import SlidingJoint as SlidingJoint
    from mbdkit.mechanism.pathways import AnglePathway as AnglePathway
    from mbdkit.mechanism.size import mechanism_size as mechanism_size
    from mbdkit.mechanism.values import BodyPair as BodyPair, Motion as Motion, pair as pair
    from mbdkit.mechanism.variable_functions import Profile as Profile
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
