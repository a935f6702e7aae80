"""Built-in force laws, one per file; each file defines the options and the law."""

from __future__ import annotations

from mbdkit.registry.items import ForceLawPlugin
from mbdkit.registry.target import Target


def _law(order: int, name: str, summary: str, module: str, options: str) -> ForceLawPlugin:
    home = f"{__name__}.{module}"
    return ForceLawPlugin(name, summary, Target(f"{home}:{options}", type), Target(f"{home}:LAW"), order=order)


LAWS = (
    _law(10, "linear", "A linear spring and damper, on any pathway.", "linear", "LinearOptions"),
    _law(
        20,
        "one-sided",
        "A spring and damper that only pulls (a rope) or only pushes (a stop).",
        "one_sided",
        "OneSidedOptions",
    ),
    _law(
        30,
        "exponential",
        "An exponential spring that only pulls (a ligament) or only pushes (a pad), with a linear damper.",
        "exponential",
        "ExponentialOptions",
    ),
    _law(
        40,
        "gas-spring",
        "A gas spring: its push grows from the preload as it is compressed, by the polytropic law of its gas.",
        "gas_spring",
        "GasSpringOptions",
    ),
    _law(
        50,
        "table",
        "A spring with a table of force against length, interpolated by a cubic spline and extrapolated linearly.",
        "tabulated",
        "TableOptions",
    ),
)
