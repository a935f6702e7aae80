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

import yaml

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.runs.simulation import run
from mbdkit.spec.loading import load_spec

EQUAL, OTHER_BITS = "equal", "other bits"
_DIGEST = re.compile("[0-9a-f]{64}")
STORED = Path(__file__).with_name("self_test.json")  #: The stored hashes by name of the run.


#: Changes of each run by the name of its example.
RUNS: dict[str, dict[str, Any]] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))


def hashes() -> dict[str, str]:
    """Run all specs; return ``data_sha256`` by name, or why there is none."""
    texts = {}
    for name, changes in RUNS.items():
        try:
            result = run(load_spec(name, **changes))
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
