"""`python -m tests.benchmarks [chain|implicit|memory|race|startup ...]`: print the tables, all by default."""

from __future__ import annotations

import argparse
import platform
from collections.abc import Callable

from rich.console import Console

from . import chain, race, startup

SECTIONS: dict[str, Callable[[Console], None]] = {
    "chain": chain.explicit,
    "implicit": chain.implicit,
    "memory": chain.memory,
    "race": race.race,
    "startup": startup.startup,
}


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description="Speed and memory, as tables.")
    parser.add_argument("sections", nargs="*", help=f"{', '.join(SECTIONS)}; all by default")
    chosen = parser.parse_args().sections or list(SECTIONS)
    unknown = sorted(set(chosen) - set(SECTIONS))
    if unknown:
        parser.error(f"there is no section {unknown[0]!r}; sections are {', '.join(SECTIONS)}")
    console = Console(width=None if Console().is_terminal else 160)
    console.print(
        f"{platform.platform()}, {platform.processor() or platform.machine()}, Python {platform.python_version()}"
    )
    for name in chosen:
        SECTIONS[name](console)


if __name__ == "__main__":
    main()
