"""The export of a mechanism, without an import of CasADi before it is needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mbdkit.plugin import MbdkitError, Mechanism

if TYPE_CHECKING:
    from mbdkit_predict.casadi_system import CasadiSystem


def exported(mechanism: Mechanism) -> Callable[..., CasadiSystem]:
    """Return the function of controls and parameters that exports a mechanism; see `Mechanism.to_casadi`.

    Raises
    ------
    MbdkitError
        If CasADi is not installed.
    """
    require_casadi("the export to CasADi needs")
    from mbdkit_predict.casadi_system import CasadiSystem
    from mbdkit_predict.chosen_numbers import ChosenNumbers

    def system(controls: Sequence[str], parameters: Sequence[str], t0: float) -> CasadiSystem:
        return CasadiSystem(ChosenNumbers(mechanism, controls, parameters), t0)

    return system


def require_casadi(what: str) -> None:
    """Raise MbdkitError if CasADi is not installed; `what` are the first words of the message."""
    try:
        import casadi  # noqa: F401
    except ImportError:
        raise MbdkitError(f"{what} the package casadi: install it with `pip install mbdkit[predict]`") from None
