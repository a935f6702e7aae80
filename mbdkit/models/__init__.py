"""The built-in models; each module builds a mechanism from a few parameters."""

from mbdkit.models import double_pendulum, four_bar_knee, free_form, leg, n_four_bar, n_pendulum, single_pendulum
from mbdkit.registry.items import ModelPlugin

MODELS = (
    ModelPlugin(
        "single-pendulum",
        single_pendulum.SUMMARY,
        single_pendulum.SinglePendulumOptions,
        single_pendulum.build,
    ),
    ModelPlugin(
        "double-pendulum",
        double_pendulum.SUMMARY,
        double_pendulum.DoublePendulumOptions,
        double_pendulum.build,
    ),
    ModelPlugin("n-pendulum", n_pendulum.SUMMARY, n_pendulum.NPendulumOptions, n_pendulum.build),
    ModelPlugin("n-four-bar", n_four_bar.SUMMARY, n_four_bar.NFourBarOptions, n_four_bar.build, n_four_bar.REFERENCES),
    ModelPlugin(
        "four-bar-knee",
        four_bar_knee.SUMMARY,
        four_bar_knee.FourBarKneeOptions,
        four_bar_knee.build,
        four_bar_knee.REFERENCES,
    ),
    ModelPlugin("leg", leg.SUMMARY, leg.LegOptions, leg.build, leg.REFERENCES),
    ModelPlugin(
        "leg-four-bar", leg.FOUR_BAR_SUMMARY, leg.LegFourBarOptions, leg.build_four_bar, leg.FOUR_BAR_REFERENCES
    ),
    ModelPlugin("mechanism", free_form.SUMMARY, free_form.MechanismOptions, free_form.build),
)
"""The built-in models, in the order in which `mbdkit plugins list` shows them."""
