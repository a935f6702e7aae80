"""`python -m tests.benchmarks [SECTION ...]`: print tables, those of all sections by default."""

from __future__ import annotations

import argparse
import functools
import platform
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from mbdkit.base.errors import SpecError
from mbdkit.base.files import check_suffix
from mbdkit_report import FORMATS

from . import (
    adjoint_cost,
    beams,
    chain,
    contacts,
    drawn_emg,
    drawn_frontal,
    drawn_persons,
    elementary,
    ensemble,
    executors,
    gradients,
    inverse_frames,
    person_times,
    plugins,
    predictions,
    public_codes,
    python_steps,
    race,
    scale,
    startup,
    turning_beams,
)
from .precision.evaluations import evaluations
from .precision.race import precision, series

SECTIONS: dict[str, Callable[[Console], None]] = {
    "adjoint": adjoint_cost.adjoint_cost,
    "beams": beams.beams,
    "chain": chain.explicit,
    "contacts": contacts.contacts,
    "elementary": elementary.elementary,
    "codes": public_codes.public_codes,
    "emg": drawn_emg.emg,
    "ensemble": ensemble.ensemble,
    "evaluations": evaluations,
    "executors": executors.executors,
    "frontal": drawn_frontal.frontal,
    "gradients": gradients.gradients,
    "implicit": chain.implicit,
    "inverse": inverse_frames.inverse_frames,
    "memory": chain.memory,
    "person-times": person_times.person_times,
    "persons": drawn_persons.persons,
    "plugins": plugins.plugins,
    "precision": precision,
    "predictions": predictions.predictions,
    "python": python_steps.python_steps,
    "race": race.race,
    "scale": scale.scale,
    "series": series,
    "startup": startup.startup,
    "turning": turning_beams.turning,
}


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description="Speed and memory, as tables.")
    parser.add_argument("sections", nargs="*", help=f"{', '.join(SECTIONS)}; all by default")
    parser.add_argument(
        "-o",
        "--output",
        metavar="PATH",
        help="the file that `scale` draws into, or the folder for the picture and the numbers of `precision`",
    )
    parser.add_argument("--only", choices=contacts.NAMES, help="the one case of `contacts` to measure")
    parser.add_argument("--quick", action="store_true", help="measure `contacts` once, and leave out long runs")
    parser.add_argument(
        "--profile",
        action="store_true",
        help="print the calls of Python functions a step of `contacts` instead of times",
    )
    parser.add_argument(
        "--count", type=int, default=20, metavar="N", help="number of persons of `persons`, `emg`, `frontal`"
    )
    parser.add_argument(
        "--doubled", action="store_true", help="double the deviations of every second person of `persons`"
    )
    asked = parser.parse_args()
    chosen = asked.sections or list(SECTIONS)
    unknown = sorted(set(chosen) - set(SECTIONS))
    if unknown:
        parser.error(f"there is no section {unknown[0]!r}; sections are {', '.join(SECTIONS)}")
    of_contacts = {"only": asked.only, "quick": asked.quick, "profile": asked.profile}
    if any(of_contacts.values()) and chosen != ["contacts"]:
        parser.error("--only, --quick and --profile are for the section contacts; ask for this one alone")
    sections = {
        **SECTIONS,
        "contacts": functools.partial(contacts.contacts, **of_contacts),
        "emg": functools.partial(drawn_emg.emg, count=asked.count),
        "frontal": functools.partial(drawn_frontal.frontal, count=asked.count),
        "persons": functools.partial(drawn_persons.persons, count=asked.count, doubled=asked.doubled),
    }
    if asked.output is not None:
        drawing = [name for name in chosen if name in ("precision", "scale")]
        if len(drawing) != 1:
            parser.error("-o is for one of the sections precision and scale; ask for one of them")
        try:
            sections[drawing[0]] = _with_output(drawing[0], asked.output)
        except SpecError as error:
            parser.error(str(error))
    console = Console(width=None if Console().is_terminal else 160, markup=False)  # [ns] is a unit
    console.print(
        f"{platform.platform()}, {platform.processor() or platform.machine()}, Python {platform.python_version()}"
    )
    for name in chosen:
        sections[name](console)


def _with_output(section: str, output: str) -> Callable[[Console], None]:
    """Return the section that writes to `output`. Raises SpecError where it cannot."""
    if section == "precision":
        folder = Path(output)
        if not folder.is_dir():
            raise SpecError(f"there is no folder {output!r} for the picture and the numbers")
        return functools.partial(precision, output=folder)
    file = check_suffix(output, FORMATS, "a plot")
    if not file.parent.is_dir():
        raise SpecError(f"there is no folder {str(file.parent)!r} for the plot")
    return functools.partial(scale.scale, output=file)


if __name__ == "__main__":
    main()
