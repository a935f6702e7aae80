"""Results of inverse dynamics are the same to the bit with the linear algebra of other processors."""

from __future__ import annotations

import json
import os
import subprocess
import sys

HASHES = """\
import json, mbdkit
found = {}
for example in ("walking-muscles", "person-walking"):
    with mbdkit.inverse(example) as run:
        found[example] = run.data_sha256
print(json.dumps(found))
"""


def hashes(**variables: str) -> dict[str, str]:
    """Return the hashes of examples, computed in a process of its own with these environment variables."""
    done = subprocess.run(
        [sys.executable, "-c", HASHES], env=os.environ | variables, capture_output=True, text=True, check=True
    )
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_results_do_not_depend_on_the_routines_of_blas() -> None:
    # expected: results of the processor's own routines; those of another one round differently
    assert hashes(OPENBLAS_CORETYPE="Nehalem") == hashes()
