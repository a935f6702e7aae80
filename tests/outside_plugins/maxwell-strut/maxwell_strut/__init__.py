"""Elements: a spring and a damper in series. The extension of the damper is a first-order state."""

from pathlib import Path
from typing import ClassVar

import numpy as np
import sympy

from mbdkit import ExpressionLaw, plugin

LENGTH, FREE, STIFFNESS, VISCOSITY, EXTENSION = sympy.symbols("length free stiffness viscosity extension", real=True)
STRETCH = LENGTH - FREE - EXTENSION


class Strut(plugin.LineForce):
    """A spring in series with a damper."""

    stiffness: plugin.Positive
    """Stiffness of the spring [N/m]."""
    viscosity: plugin.Positive
    """Constant of the damper [N s/m]."""
    free: plugin.NotNegative = 0.0
    """Length of the strut without force at the start [m]."""
    extension: plugin.Number = 0.0
    """Extension of the damper at the start [m]."""
    force_law: ClassVar[ExpressionLaw] = ExpressionLaw(
        STIFFNESS * STRETCH,
        rates={"extension": (STIFFNESS * STRETCH / VISCOSITY, "m")},
        parameters=lambda strut: {key: getattr(strut, key) for key in ("stiffness", "viscosity", "free", "extension")},
    )


def take(states) -> np.ndarray:
    """Return the extensions (T, struts)."""
    return states.z[:, [one.state for one in states.mechanism.extensions["maxwell_struts"]]]


ROWS = ("time", "strut")
COLUMNS = plugin.quantity_group(
    "maxwell_struts",
    plugin.Array("time", ("time",), "s", "time of the recorded row"),
    plugin.name_array("strut", ROWS[1], "name of the strut", lambda names: names.names_of("maxwell_struts")),
    plugin.Recorded("extension", ROWS, "m", "extension of the damper", take=take),
    optional=True, is_optional=True, axis=ROWS[1], one="strut", word="maxwell_struts", example="extension",
)  # fmt: skip


@plugin.hookimpl
def mbdkit_items():
    element = plugin.ElementKind(
        name="maxwell-strut",
        summary="Struts of a spring and a damper in series.",
        key_in_model="maxwell_struts",
        model=plugin.Target("maxwell_strut:Strut"),
        builder="maxwell_strut",
        in_expressions={"length": "length", "rate": "rate", "force": "tension"},
        supports={"statics": "an analysis of a mechanism at rest does not include struts; leave them out"},
        example="maxwell-strut",
    )
    columns = plugin.QuantityKind(
        name="maxwell_struts",
        summary="Extensions of struts.",
        target=plugin.Target("maxwell_strut:COLUMNS"),
        word="maxwell_struts",
    )
    return [element, columns, *plugin.Example.folder(Path(__file__).parent)]
