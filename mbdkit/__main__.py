"""``python -m mbdkit`` is the command ``mbdkit``."""

from mbdkit.cli import main

if __name__ == "__main__":
    main()
