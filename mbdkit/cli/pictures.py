"""What runs look like: `plot`, `animate`, `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbdkit.cli.common_options import Archive, Debug, Overwrite, Quiet
from mbdkit.plot.plot_kinds import PLOT_KINDS

_KINDS_HELP = "; ".join(f"{kind}: {summary}" for kind, summary in PLOT_KINDS.items()) + "."


def _check_kind(kind: str) -> str:
    if kind not in PLOT_KINDS:
        raise typer.BadParameter(f"there is no kind of plot {kind!r}; the kinds are {', '.join(PLOT_KINDS)}")
    return kind


def plot(
    archive: Archive,
    kind: Annotated[str, typer.Option("--kind", metavar="KIND", callback=_check_kind, help=_KINDS_HELP)] = "trajectory",
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE.png", help="PNG, SVG or PDF by its suffix; by default FILE-KIND.png."
        ),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Plot a run. A picture of the same name is replaced."""
    from mbdkit.archive.reader import load
    from mbdkit.plot.save_plot import plot as draw

    with load(archive) as loaded:
        target = draw(loaded, kind, output or archive.with_name(f"{archive.stem}-{kind}.png"))
    if not quiet:
        print(target)


def animate(
    archive: Archive,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.gif", help=".gif, .html or .mp4; by default FILE.gif."),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Animate a run. A film of the same name is replaced."""
    from mbdkit.archive.reader import load
    from mbdkit.report.animate import animate as draw

    with load(archive) as loaded:
        target = draw(loaded, output or archive.with_suffix(".gif"))
    if not quiet:
        print(target)


def report(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A run archive, or the folder of a study.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE.html",
            help="The page; by default NAME-report.html, or report.html in a study. FILE.md: its verdict and tables.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures", metavar="DIR", help="Write the figures as PNG and SVG too; a study's go to its figures/."
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Report on a run or a study: one page that works offline.

    A verdict in plain words, figures to zoom, the motion with its gaps magnified,
    tables, methods with references, and the spec.
    """
    from mbdkit.report.report import report as write

    target = write(path, output, figures=figures, overwrite=overwrite)
    if not quiet:
        print(target)
