"""The built-in models; each builds a mechanism from a few parameters."""

from mbdkit.models import four_bar_knee, free_form, leg, n_four_bar, pendulums
from mbdkit.registry.items import ModelPlugin

MODELS = (
    ModelPlugin("single-pendulum", pendulums.SINGLE_SUMMARY, pendulums.SinglePendulumOptions, pendulums.build_single),
    ModelPlugin("double-pendulum", pendulums.DOUBLE_SUMMARY, pendulums.DoublePendulumOptions, pendulums.build_double),
    ModelPlugin("n-pendulum", pendulums.N_SUMMARY, pendulums.NPendulumOptions, pendulums.build_n),
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
