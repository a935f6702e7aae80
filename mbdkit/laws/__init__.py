"""The force laws that mbdkit ships, one a file: options, the law, and where it comes from."""

from mbdkit.laws import linear, one_sided, tabulated
from mbdkit.registry.items import ForceLawPlugin

LAWS = (
    ForceLawPlugin("linear", linear.SUMMARY, linear.LinearOptions, linear.LAW),
    ForceLawPlugin("one-sided", one_sided.SUMMARY, one_sided.OneSidedOptions, one_sided.LAW),
    ForceLawPlugin("table", tabulated.SUMMARY, tabulated.TableOptions, tabulated.LAW),
)
