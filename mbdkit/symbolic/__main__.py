"""``python -m mbdkit.symbolic [--check]``: write the generated element kernels, or check that they are current."""

from __future__ import annotations

import sys

from mbdkit.symbolic.generate import TARGET, source


def main(arguments: list[str]) -> int:
    """Write or check ``mbdkit/engine/kernels/element_kernels.py``; return the exit status."""
    fresh = source()
    if "--check" in arguments:
        if TARGET.read_text(encoding="utf-8") == fresh:
            return 0
        print(
            f"{TARGET.name} differs from the output of mbdkit/symbolic: run `python -m mbdkit.symbolic`",
            file=sys.stderr,
        )
        return 1
    TARGET.write_text(fresh, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
