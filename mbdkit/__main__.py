"""``python -m mbdkit`` is the command ``mbdkit``."""

import gc

# Imports create many objects, but little garbage; collecting it at the default rate would take a tenth of a short run.
# The imports of a run create 140 000 objects.
gc.set_threshold(300_000)

from mbdkit.cli import run_and_exit  # noqa: E402

if __name__ == "__main__":
    run_and_exit()
