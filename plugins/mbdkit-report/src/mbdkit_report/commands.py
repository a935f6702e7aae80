"""Commands that draw runs: `plot`, `animate`, `report`."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbdkit.base.terminal import say, show
from mbdkit.cli.common_options import Archive, Archives, Debug, Overwrite, Quiet, grouped, output_to
from mbdkit.cli.completion import completing, names_in_archive
from mbdkit.registry.target import Target
from mbdkit_report.plot.plot_kinds import plot_kinds

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_KINDS = completing(Target("mbdkit_report.plot.plot_kinds:plot_kinds"))
_KINDS_HELP = "; ".join(f"{kind}: {summary}" for kind, summary in plot_kinds().items()) + "."


_Names = list[str] | None


def _several(flag: str, metavar: str, kinds: str, what: str, *groups: str) -> object:
    return typer.Option(
        flag, metavar=metavar, autocompletion=names_in_archive(*groups),
        help=f"With {kinds}: draw {what}; may be repeated.",
    )  # fmt: skip


@dataclass
class Selection:
    """The contents of a plot, by the names of the options of `mbdkit_report.plot.comparison.compare`."""

    joints: Annotated[_Names, _several("--joint", "J", "drift, reactions or torques", "this joint", "joints")] = None
    elements: Annotated[_Names, _several("--element", "F", "forces or torques", "this force element", "forces")] = None
    points: Annotated[
        _Names,
        _several("--point", "P", "trajectory", "this marker, body, joint or free end", "markers", "bodies", "joints"),
    ] = None
    beams: Annotated[_Names, _several("--beam", "B", "beams", "this beam", "beams")] = None
    times: Annotated[list[float] | None, _several("--time", "T", "beams", "values along beams at this time")] = None
    components: Annotated[
        str | None,
        typer.Option(
            "--component",
            metavar="C",
            help="With reactions: magnitude (the default); x, y or both (global); axial, shear or both (body), in the "
            "frame of the second body. With beams: moment, shear or axial.",
        ),
    ] = None


@grouped
def plot(
    archives: Archives,
    *,
    kind: Annotated[
        str, typer.Option("--kind", metavar="KIND", autocompletion=_KINDS, help=_KINDS_HELP)
    ] = "trajectory",
    selection: Selection,
    size: Annotated[
        str | None,
        typer.Option(
            "--size",
            metavar="SIZE",
            help="Draw a figure for a paper, without heading, of this width (85mm) or width and height (85mmx60mm).",
        ),
    ] = None,
    x_limits: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--x-limits", metavar="LOW HIGH", help="Range of the horizontal axis, usually a time interval [s]."
        ),
    ] = None,
    y_limits: Annotated[
        tuple[float, float] | None, typer.Option("--y-limits", metavar="LOW HIGH", help="Range of the vertical axis.")
    ] = None,
    output: Annotated[Path | None, output_to("FILE.png", "A PNG, SVG or PDF file; by default FILE-KIND.png.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Plot a run, or one quantity of several runs.

    The legend of several runs shows how they differ: method, step, other keys, or file.
    """
    from mbdkit.base.files import check_not_input, check_output
    from mbdkit_report.export_command import opened
    from mbdkit_report.plot.save_plot import plot as draw
    from mbdkit_report.plot.save_plot import size_in_mm

    options = {name: value for name, value in vars(selection).items() if value}
    _check_options(kind, options)
    with ExitStack() as stack:
        runs = [stack.enter_context(opened(archive)) for archive in archives]
        target = output or archives[0].with_name(f"{archives[0].stem}-{kind.replace(':', '-')}.png")
        for archive in archives:
            check_not_input(target, archive)
        check_output(target, overwrite=overwrite)
        place = None if size is None else size_in_mm(size)
        target = draw(runs, kind, target, size=place, x_limits=x_limits, y_limits=y_limits, **options)
        if kind == "trajectory":
            _say_what_is_not_drawn(*runs)
    if not quiet:
        show(target)


def _say_what_is_not_drawn(*runs: Run) -> None:
    for run in runs:
        if run.not_drawn:
            say(f"{run.path}: {run.not_drawn}")


def _check_options(kind: str, options: Mapping[str, object]) -> None:
    from mbdkit.base.errors import SpecError
    from mbdkit.base.text import listed
    from mbdkit_report.plot.comparison import options_of

    known = options_of(kind)
    for name in options:
        if name not in known:
            kinds = [one for one in plot_kinds() if name in options_of(one)]
            raise SpecError(f"--{name.removesuffix('s')} is an option of --kind {listed(kinds, 'or')}, not of {kind}")


def animate(
    archive: Archive,
    output: Annotated[Path | None, output_to("FILE.gif", "A .gif, .html or .mp4 file; by default FILE.gif.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Animate a run."""
    from mbdkit.base.files import check_output
    from mbdkit_report.export_command import opened
    from mbdkit_report.pages.animate import animate as draw

    with opened(archive) as loaded:
        target = output or archive.with_suffix(".gif")
        check_output(target, overwrite=overwrite, source=archive)
        target = draw(loaded, target)
        _say_what_is_not_drawn(loaded)
    if not quiet:
        show(target)


def report(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH", help="A run archive, a result of `mbdkit identify`, or the folder of a study or design."
        ),
    ],
    output: Annotated[
        Path | None,
        output_to(
            "FILE.html",
            "The page; by default NAME-report.html, or report.html in the folder. "
            "With FILE.md, the verdict and the tables as Markdown.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="DIR",
            help="Also write the figures as PNG and SVG to this folder. By default, only those of a study are written, "
            "to figures/ in its folder.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Write a report on a run, study or design as an HTML page.

    The page works offline. It has a verdict, interactive figures, an animation
    that magnifies the gaps in the joints, tables, methods and the spec.
    """
    from mbdkit.archive.archive_check import blaming_damage
    from mbdkit.base.files_read import only_known
    from mbdkit_report.pages.report import report as write

    archives = sorted((path / "runs").glob("*.h5")) if path.is_dir() else [path]
    archives = [archive for archive in archives if not archive.name.startswith("block-")]
    with blaming_damage(*archives), only_known((), allowed=False):
        target = write(path, output, figures=figures, overwrite=overwrite)
    if not quiet:
        show(target)
