"""Commands that draw runs: `plot`, `animate`, `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbdkit.cli.common_options import Archive, Debug, Overwrite, Quiet
from mbdkit.plot.plot_kinds import PLOT_KINDS
from mbdkit.terminal import show

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
        typer.Option("-o", "--output", metavar="FILE.png", help="A PNG, SVG or PDF file; by default FILE-KIND.png."),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Plot a run. An existing picture is replaced."""
    from mbdkit.archive.archive_check import blaming_damage
    from mbdkit.archive.reader import load
    from mbdkit.files import check_output
    from mbdkit.plot.save_plot import plot as draw

    with blaming_damage(archive), load(archive) as loaded:
        target = output or archive.with_name(f"{archive.stem}-{kind}.png")
        check_output(target, overwrite=True, source=archive)
        target = draw(loaded, kind, target)
    if not quiet:
        show(target)


def animate(
    archive: Archive,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.gif", help="A .gif, .html or .mp4 file; by default FILE.gif."),
    ] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Animate a run. An existing file is replaced."""
    from mbdkit.archive.archive_check import blaming_damage
    from mbdkit.archive.reader import load
    from mbdkit.files import check_output
    from mbdkit.report.animate import animate as draw

    with blaming_damage(archive), load(archive) as loaded:
        target = output or archive.with_suffix(".gif")
        check_output(target, overwrite=True, source=archive)
        target = draw(loaded, target)
    if not quiet:
        show(target)


def report(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A run archive, or the folder of a study.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE.html",
            help="The page; by default NAME-report.html, or report.html in a study's folder. "
            "FILE.md: verdict and tables as Markdown.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="DIR",
            help="Also write the figures as PNG and SVG; by default only for a study, to its figures/.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Write a report on a run or study as an HTML page.

    The page works offline. It has a verdict, interactive figures, an animation
    that magnifies the gaps in the joints, tables, methods and the spec.
    """
    from mbdkit.archive.archive_check import blaming_damage
    from mbdkit.report.report import report as write

    archives = sorted((path / "runs").glob("*.h5")) if path.is_dir() else [path]
    with blaming_damage(*archives):
        target = write(path, output, figures=figures, overwrite=overwrite)
    if not quiet:
        show(target)
