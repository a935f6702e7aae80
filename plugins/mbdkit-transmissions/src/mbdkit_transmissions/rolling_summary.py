"""What the summary of a run says of rolling wheels: the friction that they need."""

from __future__ import annotations

import numpy as np

from mbdkit.plugin import Run
from mbdkit.plugin.seams import summary_lines


@summary_lines
def needed_friction(run: Run) -> list[tuple[str, str]]:
    """Return the coefficient of friction that each wheel needs to roll."""
    if not run.records("constraints/multiplier"):
        return []
    names = [str(name) for name in run.array("constraints/constraint")]
    wheels = [name.removesuffix(".tangential") for name in names if name.endswith(".tangential")]
    if not wheels:
        return []
    multiplier, needs = run.array("constraints/multiplier"), []
    for wheel in wheels:
        normal, across = (np.abs(multiplier[:, names.index(f"{wheel}.{row}")]) for row in ("normal", "tangential"))
        ratio = np.divide(across, normal, out=np.zeros_like(normal), where=normal > 0.0)
        needs.append(f"{wheel} {np.max(ratio, initial=0.0):.4g}")
    return [("rolling", f"coefficient of friction needed: {', '.join(needs)}")]
