"""Built-in force laws, one per file; each file defines the options and the law."""

from __future__ import annotations

from mbdkit.registry.items import ForceLawPlugin
from mbdkit.registry.target import Target

# fmt: off
LAWS = (
    ForceLawPlugin(
        name="linear", summary="A linear spring and damper, on any pathway.",
        options=Target("mbdkit.laws.linear:LinearOptions"), law=Target("mbdkit.laws.linear:LAW"), order=10,
    ),
    ForceLawPlugin(
        name="one-sided", summary="A spring and damper that only pulls (a rope) or only pushes (a stop).",
        options=Target("mbdkit.laws.one_sided:OneSidedOptions"), law=Target("mbdkit.laws.one_sided:LAW"), order=20,
    ),
    ForceLawPlugin(
        name="exponential",
        summary="An exponential spring that only pulls (a ligament) or only pushes (a pad), with a linear damper.",
        options=Target("mbdkit.laws.exponential:ExponentialOptions"), law=Target("mbdkit.laws.exponential:LAW"),
        order=30,
    ),
    ForceLawPlugin(
        name="gas-spring",
        summary="A gas spring: its push grows from the preload as it is compressed, by the polytropic law of its gas.",
        options=Target("mbdkit.laws.gas_spring:GasSpringOptions"), law=Target("mbdkit.laws.gas_spring:LAW"), order=40,
    ),
    ForceLawPlugin(
        name="table",
        summary="A spring with a table of force against length, interpolated by a cubic spline and extrapolated "
        "linearly.",
        options=Target("mbdkit.laws.tabulated:TableOptions"), law=Target("mbdkit.laws.tabulated:LAW"), order=50,
    ),
)
# fmt: on
