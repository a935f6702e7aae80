"""Results of inverse dynamics are the same to the bit with the linear algebra of other processors."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

import mbdkit
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec

SPECS = {"walking-muscles": ["time={start: 0.5, end: 0.6}"], "person-walking": []}
"""Examples with changes of their specs: nine frames have all terms of the error bars of muscles."""


def hashes() -> dict[str, str]:
    """Return the hashes of examples."""
    found = {}
    for example, changes in SPECS.items():
        with mbdkit.inverse(load_inverse_spec(example, changes)) as run:
            found[example] = run.data_sha256
    return found


@pytest.mark.slow
def test_results_do_not_depend_on_the_routines_of_blas() -> None:
    # expected: results of the processor's own routines; those of another one round differently
    program = f"import json, runpy; print(json.dumps(runpy.run_path({__file__!r})['hashes']()))"
    variables = os.environ | {"OPENBLAS_CORETYPE": "Nehalem"}
    done = subprocess.run([sys.executable, "-c", program], env=variables, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == hashes()
