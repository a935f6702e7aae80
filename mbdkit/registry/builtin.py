"""The plugin of mbdkit itself: its models and integrators arrive like anybody's."""

from __future__ import annotations

from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.items import IntegratorPlugin, ModelPlugin


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return the models that mbdkit ships."""
    from mbdkit.models import double_pendulum, four_bar_knee, free, n_pendulum, single_pendulum

    return [
        ModelPlugin(
            "single-pendulum", single_pendulum.SUMMARY, single_pendulum.SinglePendulumOptions, single_pendulum.build
        ),
        ModelPlugin(
            "double-pendulum", double_pendulum.SUMMARY, double_pendulum.DoublePendulumOptions, double_pendulum.build
        ),
        ModelPlugin("n-pendulum", n_pendulum.SUMMARY, n_pendulum.NPendulumOptions, n_pendulum.build),
        ModelPlugin(
            "four-bar-knee",
            four_bar_knee.SUMMARY,
            four_bar_knee.FourBarKneeOptions,
            four_bar_knee.build,
            four_bar_knee.REFERENCES,
        ),
        ModelPlugin("mechanism", free.SUMMARY, free.MechanismOptions, free.build),
    ]


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Return the integrators that mbdkit ships."""
    from mbdkit.integrators.builtin import INTEGRATORS

    return list(INTEGRATORS)
