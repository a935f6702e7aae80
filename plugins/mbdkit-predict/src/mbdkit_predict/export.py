"""The export of a mechanism, without an import of CasADi before it is needed."""

from __future__ import annotations

from collections.abc import Callable
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
    try:
        import casadi  # noqa: F401
    except ImportError:
        raise MbdkitError(
            "the export to CasADi needs the package casadi: install it with `pip install mbdkit[predict]`"
        ) from None
    from mbdkit_predict.symbolic_mechanism import SymbolicMechanism

    return lambda *chosen: SymbolicMechanism(mechanism, *chosen).system()
