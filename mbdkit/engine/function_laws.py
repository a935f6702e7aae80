"""Laws of constraints that are functions of the pose: programs of the value and of all derivatives, for kernels."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from mbdkit.base.errors import PluginError, SpecError
from mbdkit.engine.force_laws import CompiledLaw, NativeLaw, native_law
from mbdkit.engine.function_program import block
from mbdkit.engine.kernels import law_programs
from mbdkit.engine.kernels.pose_functions import OF_TIME, THIRD, VALUES
from mbdkit.expressions.recorded_derivatives import derivatives
from mbdkit.mechanism.joint_base import Function, Pose, PoseFunction, record_function

VARIABLES = len(Pose._fields)


def laws_of_function(function: PoseFunction, name: str) -> tuple[CompiledLaw, CompiledLaw]:
    """Return the law of the value and the first two derivatives of a function, and that of its third derivatives.

    Raises
    ------
    SpecError
        If the function cannot be differentiated; `name` is the name of the joint.
    """
    return _laws(function.function, tuple(parameter for parameter, _ in function.parameters), name)


@lru_cache(maxsize=256)
def _laws(function: Function, parameters: tuple[str, ...], name: str) -> tuple[CompiledLaw, CompiledLaw]:
    try:
        value, pose, given = record_function(function, parameters, name)
        terms = derivatives(value, pose, order=3)
        inputs = (*pose[:-1], *given.values(), pose[-1])
        first = replace(_law(block(inputs, terms[:VALUES])), claims=0 if terms[VARIABLES].number == 0.0 else OF_TIME)
        return first, _law(block(inputs, terms[VALUES : VALUES + THIRD]))
    except (PluginError, SpecError) as error:
        raise SpecError(f"the constraint of joint '{name}': {error}") from None


def _law(program: np.ndarray) -> CompiledLaw:
    return native_law(NativeLaw(law_programs.run_function, tuple(program.tolist())))
