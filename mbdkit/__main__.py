"""``python -m mbdkit`` is the command ``mbdkit``."""

from mbdkit.cli import run_and_exit

if __name__ == "__main__":
    run_and_exit()
