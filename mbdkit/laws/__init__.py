"""Built-in force laws, one per file; each file defines the options and the law."""

from mbdkit.laws import exponential, gas_spring, linear, one_sided, tabulated
from mbdkit.registry.items import ForceLawPlugin

LAWS = (
    ForceLawPlugin("linear", linear.SUMMARY, linear.LinearOptions, linear.LAW),
    ForceLawPlugin("one-sided", one_sided.SUMMARY, one_sided.OneSidedOptions, one_sided.LAW),
    ForceLawPlugin("exponential", exponential.SUMMARY, exponential.ExponentialOptions, exponential.LAW),
    ForceLawPlugin("gas-spring", gas_spring.SUMMARY, gas_spring.GasSpringOptions, gas_spring.LAW),
    ForceLawPlugin("table", tabulated.SUMMARY, tabulated.TableOptions, tabulated.LAW),
)
