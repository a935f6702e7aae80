"""The export of a mechanism, without an import of CasADi before it is needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import mechanism_attribute

if TYPE_CHECKING:
    from mbdkit_predict.casadi_system import CasadiSystem


@mechanism_attribute
def exported(mechanism: Mechanism) -> Callable[..., CasadiSystem]:
    """Return the method `to_casadi` of a mechanism."""

    def to_casadi(*, controls: Sequence[str] = (), parameters: Sequence[str] = (), t0: float = 0.0) -> CasadiSystem:
        """Return equations of motion, constraints and quantities as functions of CasADi, for optimal control.

        Parameters
        ----------
        controls
            Key paths of the values that become controls: of a load (``forces.motor.value``, and
            ``forces.push.value[0]`` of a component), the excitation of a muscle (``muscles.soleus.excitation``), or the
            rate of a first-order state (``states.current.rate``).
        parameters
            Key paths of numbers that become parameters, such as ``forces.spring.stiffness``, ``bodies.rod.mass`` and
            ``joints.A.points[1][0]``.
        t0
            Time [s] at which the initial state is made consistent.

        Raises
        ------
        MbdkitError
            If CasADi is not installed.
        SpecError
            For the first error of the mechanism, for an element that cannot be exported, or for a key that is wrong.
        """
        require_casadi("the export to CasADi needs")
        from mbdkit_predict.casadi_system import CasadiSystem
        from mbdkit_predict.chosen_numbers import ChosenNumbers

        return CasadiSystem(ChosenNumbers(mechanism, controls, parameters), t0)

    return to_casadi


def require_casadi(what: str) -> None:
    """Raise MbdkitError if CasADi is not installed; `what` are the first words of the message."""
    try:
        import casadi  # noqa: F401
    except ImportError:
        raise MbdkitError(f"{what} the package casadi: install it with `pip install mbdkit[predict]`") from None
