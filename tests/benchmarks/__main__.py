"""`python -m tests.benchmarks [chain|implicit|memory|plugins|python|race|scale|startup ...]`: print tables."""

from __future__ import annotations

import argparse
import functools
import platform
from collections.abc import Callable

from rich.console import Console

from mbdkit.errors import SpecError
from mbdkit.files import check_suffix
from mbdkit.report.style import FORMATS

from . import chain, plugins, python_steps, race, scale, startup

SECTIONS: dict[str, Callable[[Console], None]] = {
    "chain": chain.explicit,
    "implicit": chain.implicit,
    "memory": chain.memory,
    "plugins": plugins.plugins,
    "python": python_steps.python_steps,
    "race": race.race,
    "scale": scale.scale,
    "startup": startup.startup,
}


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description="Speed and memory, as tables.")
    parser.add_argument("sections", nargs="*", help=f"{', '.join(SECTIONS)}; all by default")
    parser.add_argument("-o", "--output", metavar="FILE.png", help="where `scale` writes its plot; nowhere by default")
    asked = parser.parse_args()
    chosen = asked.sections or list(SECTIONS)
    unknown = sorted(set(chosen) - set(SECTIONS))
    if unknown:
        parser.error(f"there is no section {unknown[0]!r}; sections are {', '.join(SECTIONS)}")
    sections = dict(SECTIONS)
    if asked.output is not None:
        if "scale" not in chosen:
            parser.error("-o is for the plot of the section scale, which is not among those asked for")
        try:
            output = check_suffix(asked.output, FORMATS, "a plot")
        except SpecError as error:
            parser.error(str(error))
        if not output.parent.is_dir():
            parser.error(f"there is no folder {str(output.parent)!r} for the plot")
        sections["scale"] = functools.partial(scale.scale, output=output)
    console = Console(width=None if Console().is_terminal else 160, markup=False)  # [ns] is a unit
    console.print(
        f"{platform.platform()}, {platform.processor() or platform.machine()}, Python {platform.python_version()}"
    )
    for name in chosen:
        sections[name](console)


if __name__ == "__main__":
    main()
