"""Self-test of an installation: small runs, whose hashes are compared with stored ones.

The machine code computes the same bits on every system and processor, so that the hashes of all runs agree. Where one
does not, results are still as accurate, but `mbdkit rerun`, `Study.remake` and other comparisons by hash find
differences between this installation and others.

``python -m mbdkit_testing.self_test`` stores the hashes of this installation after a change of the results.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.runs.simulation import run
from mbdkit.spec.loading import load_spec

EQUAL, OTHER_BITS = "equal", "other bits"
_DIGEST = re.compile("[0-9a-f]{64}")
STORED = Path(__file__).with_name("self_test.json")  #: The stored hashes by name of the run.


def _steps(step: float, count: int = 40) -> dict[str, Any]:
    return {"step": step, "end": step * count}


#: Example and changes of each run: explicit and implicit methods, control of the step, projection, loops, a moving
#: driver, a beam, contacts and muscles.
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "pendulum": ("pendulum", {"integrator": {"name": "rk-gill"}, "time": _steps(0.01)}),
    "double-pendulum": (
        "double-pendulum",
        {"integrator": {"name": "dopri5", "adaptive": True, "rtol": 1e-8}, "time": {"end": 0.5}},
    ),
    "knee": ("knee", {"integrator": {"name": "gauss", "stages": 3}, "time": _steps(0.005)}),
    "slider-crank": ("slider-crank", {"integrator": {"name": "radau-iia", "stages": 3}, "time": _steps(0.002)}),
    "chain": ("chain", {"integrator": {"name": "rk4"}, "stabilization": "projection", "time": _steps(0.005)}),
    "car-axis": ("car-axis", {"integrator": {"name": "dop853"}, "time": _steps(0.005)}),
    "spin-up-beam": ("spin-up-beam", {"integrator": {"name": "radau-iia", "stages": 2}, "time": _steps(1e-6, 10)}),
    "slider-crank-clearance": ("slider-crank-clearance", {"time": _steps(1e-4)}),
    "bouncing-ball": ("bouncing-ball", {}),
    "elbow-curl": ("elbow-curl", {"time": _steps(0.005)}),
}


def hashes() -> dict[str, str]:
    """Run all specs; return ``data_sha256`` by name, or why there is none."""
    texts = {}
    for name, (example, changes) in RUNS.items():
        try:
            result = run(load_spec(example, **changes))
        except MbdkitError as error:
            texts[name] = str(error)
            continue
        texts[name] = result.data_sha256 if result.status == "complete" else str(result.status_reason)
    return texts


def compared() -> dict[str, str]:
    """Return for each run by name `EQUAL`, `OTHER_BITS`, or why it has no result."""
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    return {
        name: EQUAL if text == stored.get(name) else OTHER_BITS if _DIGEST.fullmatch(text) else text
        for name, text in hashes().items()
    }


def sentences(found: Mapping[str, str]) -> str:
    """Return what the result of `compared` means."""
    others = [name for name, text in found.items() if text == OTHER_BITS]
    failed = {name: text for name, text in found.items() if text not in (EQUAL, OTHER_BITS)}
    failures = [f"self-test: '{name}' failed: {text}" for name, text in failed.items()]
    equal = len(found) - len(others) - len(failures)
    lines = [f"self-test: the results of {equal} of {len(found)} runs have the same bits as on other machines"]
    if others:
        lines.append(
            f"self-test: {listed(others)}: last bits differ from those of the machines where mbdkit was tested, and so "
            "do hashes"
        )
    return "\n".join([*lines, *failures])


if __name__ == "__main__":
    STORED.write_text(json.dumps(hashes(), indent=1) + "\n", encoding="utf-8", newline="\n")
