"""Generate ``mbdkit/engine/kernels/law_kernels.py``: the packaged laws that are SymPy expressions, as kernels.

Run by ``python -m mbdkit_builder laws``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbdkit.engine.native import machine_code
from mbdkit.laws import exponential, gas_spring, linear, one_sided
from mbdkit.mechanism.force_law import law_parameters
from mbdkit.symbolic.symbolic_law import law_source

TARGET = machine_code.PACKAGE / "engine/kernels/law_kernels.py"

#: Module and example options of each packaged law.
_EXAMPLES: dict[str, tuple[Any, Any]] = {
    "exponential": (exponential, exponential.ExponentialOptions(scale=1.0, growth=1.0, acts="tension")),
    "gas_spring": (
        gas_spring,
        gas_spring.GasSpringOptions(preload=1.0, progression=2.0, stroke=0.1, extended_length=0.5),
    ),
    "linear": (linear, linear.LinearOptions()),
    "one_sided": (one_sided, one_sided.OneSidedOptions(stiffness=1.0, acts="tension")),
}

_HEADER = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")

_LAW = Path(__file__).with_name("packaged_law.txt").read_text(encoding="utf-8")


class _Options:
    """Stand-in for a force element: attributes are the options of its law, and ``law_options`` is their model."""

    law_options: Any


def generated() -> str:
    """Return the source of the module."""
    parts, parameters = [_HEADER], {}
    for name, (module, options) in _EXAMPLES.items():
        names, values = law_parameters(module.LAW, _with_options(options), name)
        parameters[name] = names
        source = law_source(module.LAW, dict(zip(names, values, strict=True)))
        parts.append(_LAW.format(name=name, source=source.replace("def law(", f"def _{name}(", 1)))
    lines = "".join(f'    "{name}": {names!r},\n' for name, names in parameters.items())
    parts.append(f"\n#: Names of the parameters of each law.\nPARAMETERS = {{\n{lines}}}\n")
    return "".join(parts)


def _with_options(options: Any) -> Any:
    kind = type("Options", (_Options,), {"law_options": type(options)})
    element = kind()
    for name in type(options).model_fields:
        setattr(element, name, getattr(options, name))
    return element
