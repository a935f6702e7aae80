"""Share of true torques and joint forces that the error bars of inverse dynamics cover, for three closed loops.

``python -m tests.benchmarks.inverse_coverage [SAMPLES]``
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.inverse_dynamics.noisy import CUTOFF, Truth, covered
from tests.inverse_dynamics.test_closed_loops import moved


def main(samples: int) -> None:
    """Print the shares for each actuator and the range of those of the joints."""
    for example, cutoff in CUTOFF.items():
        with tempfile.TemporaryDirectory() as folder:
            run, spec = moved(example, Path(folder) / "run.h5")
            torques, forces = covered(Truth.of(example, run, spec["actuators"]), spec, cutoff, samples)
        told = ", ".join(f"{name} {share:.1%}" for name, share in zip(spec["actuators"], torques, strict=True))
        print(f"{example}, {cutoff:g} Hz: {told}; joint forces {forces.min():.1%} to {forces.max():.1%}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
