"""Built-in force laws, one per file; each file defines the options and the law."""

from mbdkit.laws import linear, one_sided, tabulated
from mbdkit.registry.items import ForceLawPlugin

LAWS = (
    ForceLawPlugin("linear", linear.SUMMARY, linear.LinearOptions, linear.LAW),
    ForceLawPlugin("one-sided", one_sided.SUMMARY, one_sided.OneSidedOptions, one_sided.LAW),
    ForceLawPlugin("table", tabulated.SUMMARY, tabulated.TableOptions, tabulated.LAW),
)
