"""The command ``mbdkit``: each command says what it does in its docstring; what it needs is imported when it runs."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mbdkit import terminal
from mbdkit.terminal import Commands, count_bar, progress_bar, say, silence
from mbdkit.text import table

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.engine.assembly import AssembledState
    from mbdkit.spec import RunSpec

CONTEXT = {"help_option_names": ["-h", "--help"]}
PLAIN: dict[str, Any] = {"context_settings": CONTEXT, "rich_markup_mode": None, "no_args_is_help": True}

BODIES_SHOWN = 20

app = typer.Typer(cls=Commands, add_completion=False, pretty_exceptions_enable=False, **PLAIN)
schema_app = typer.Typer(help="Print the JSON schema of a spec, for editors.", **PLAIN)
plugins_app = typer.Typer(help="List, verify, diagnose and begin plugins.", **PLAIN)
examples_app = typer.Typer(
    help="List the packaged examples, or copy one to edit it.",
    **{**PLAIN, "no_args_is_help": False},
)
archive_app = typer.Typer(help="Describe and check run archives.", **PLAIN)
app.add_typer(schema_app, name="schema")
app.add_typer(plugins_app, name="plugins")
app.add_typer(examples_app, name="examples")
app.add_typer(archive_app, name="archive")


def _set_debug(context: typer.Context, value: bool) -> bool:
    if value:
        context.meta[terminal.DEBUG] = True
    return value


def _print_version(value: bool) -> None:
    if value:
        from mbdkit import __version__

        print(f"mbdkit {__version__}")
        raise typer.Exit


SpecName = Annotated[
    str,
    typer.Argument(metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged example such as knee."),
]
StudyName = Annotated[
    str,
    typer.Argument(metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged study such as paper."),
]
Archive = Annotated[Path, typer.Argument(metavar="FILE.h5", help="A run archive.")]
Archives = Annotated[list[Path], typer.Argument(metavar="FILE.h5", help="Run archives.")]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set one key of the spec, such as time.step=0.005; may be repeated."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing file, once the new one is complete.")]
Debug = Annotated[bool, typer.Option("--debug", callback=_set_debug, help="Show the traceback of an error.")]


@app.callback()
def mbdkit(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Planar multibody dynamics: a spec goes in, a trustworthy HDF5 archive comes out.

    Exit status: 0 done, 1 a rerun differs or a plugin is not verified, 2 the input is wrong, 3 the integration stopped
    early, 4 a plugin failed, 130 interrupted.

    Environment: MBDKIT_PLUGINS=a,b loads plugins of these distributions alone, of none if it is empty;
    MBDKIT_DISABLE_PLUGINS=a,b leaves these out; MBDKIT_STRICT_PLUGINS=1 refuses to work where a plugin cannot be
    loaded; MBDKIT_CACHE_DIR is where compiled code is kept.
    """


@app.command()
def run(
    spec: SpecName,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.h5", help="The archive; by default ./SPEC.h5.")
    ] = None,
    assignments: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run a spec and write its archive."""
    path = output if output is not None else Path(f"{_stem(spec)}.h5")
    _check_new(path, spec, overwrite)
    checked = _load(spec, assignments)
    from mbdkit.simulation import simulate  # compiled code: not needed to refuse a spec

    with _placing(checked), progress_bar(path.name, quiet) as progress:
        result = simulate(checked, path=path, overwrite=overwrite, progress=progress, notify=silence if quiet else say)
    with result:
        if as_json:
            print(json.dumps(_outcome(result)))
        elif not quiet:
            print(result.summary())
        _exit_with(result, told=not (as_json or quiet))


@app.command()
def validate(spec: SpecName, assignments: Set = None, debug: Debug = False) -> None:
    """Check a spec without running it.

    Its mechanism is built and its start made consistent; what that moves is said.
    """
    checked = _load(spec, assignments)
    from mbdkit.simulation import build

    mechanism = checked.mechanism()
    problem, start = build(checked)
    print(f"{spec}: this spec is valid")
    print(f"model        {checked.model_item.id}: {mechanism.description()}")
    print(f"freedom      {problem.mechanism.freedoms()}")
    print(f"integrator   {checked.integrator_item.id}")
    if start.changed:
        print(f"start        made consistent, with residuals {start.residual:.2g} and {start.velocity_residual:.2g}")
        print(table([("BODY", "MOVED", "TURNED", "VELOCITY", "RATE"), *_moves(start)], indent="  "))
    else:
        print("start        consistent as it is, left untouched")


def _moves(start: AssembledState) -> list[tuple[str, ...]]:
    """Return a row for each body whose start was changed, the largest moves first."""
    changes = {
        name: (moved, start.moved_angle[name], start.changed_velocity[name], start.changed_rate[name])
        for name, moved in start.moved_position.items()
    }
    named = sorted((item for item in changes.items() if any(item[1])), key=lambda item: -max(map(abs, item[1])))
    rows = [
        (name, *(f"{value:.3g} {unit}" for value, unit in zip(values, ("m", "rad", "m/s", "rad/s"), strict=True)))
        for name, values in named[:BODIES_SHOWN]
    ]
    if len(named) > BODIES_SHOWN:
        rows.append((f"and {len(named) - BODIES_SHOWN} more", "", "", "", ""))
    return rows


@app.command()
def equilibrium(
    spec: SpecName,
    assignments: Set = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", metavar="FILE.yaml", help="Write the spec anew, its mechanism at rest there."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Find where a mechanism rests: positions, reactions, stability.

    The search goes downhill from the start, with drivers and loads held as they
    are at the start time. Velocities do not count.
    """
    from mbdkit.mechanics import summary
    from mbdkit.mechanics.equilibrium import equilibrium_of, spec_at
    from mbdkit.mechanics.source import Placed

    if write is not None:
        _check_free(write, spec, overwrite)
    placed = Placed.of(spec, assignments or ())
    found = equilibrium_of(placed)
    if write is not None:
        from mbdkit.report.style import replacing
        from mbdkit.spec.yaml import write_yaml

        with replacing(write) as temporary:
            temporary.write_text(write_yaml(spec_at(placed, found)), encoding="utf-8")
    print(json.dumps(summary.equilibrium_data(found)) if as_json else summary.equilibrium_text(found))


@app.command()
def modes(
    spec: SpecName,
    assignments: Set = None,
    at: Annotated[
        Literal["equilibrium", "start"],
        typer.Option("--at", help="At rest in the equilibrium near the start, or in the start as it is."),
    ] = "equilibrium",
    count: Annotated[
        int | None, typer.Option("--count", min=1, metavar="N", help="How many modes, the slowest first.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.png", help="Draw the modes: PNG, SVG or PDF by the suffix."),
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Find natural frequencies, damping ratios and mode shapes.

    Drivers are held to their motion. A picture of the same name is replaced.
    """
    from mbdkit.mechanics import summary
    from mbdkit.mechanics.modes import modes_of
    from mbdkit.mechanics.source import Placed

    if output is not None:
        from mbdkit.report.style import FORMATS, check_suffix

        check_suffix(output, FORMATS, "a plot")
    placed = Placed.of(spec, assignments or ())
    found = modes_of(placed, at, count)
    if output is not None:
        from mbdkit.report.mode_shapes import plot_modes

        mechanism = placed.spec.mechanism()
        plot_modes(found, mechanism, f"Modes: {placed.spec.title or mechanism.name}", output)
    print(json.dumps(summary.modes_data(found)) if as_json else summary.modes_text(found))


@app.command()
def kinematics(
    spec: SpecName,
    assignments: Set = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.csv", help="Write positions, velocities, accelerations as CSV."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Compute the motion that drivers prescribe, without forces.

    The mechanism must be fully driven; times are those of the spec, step by step.
    """
    from mbdkit.mechanics import summary
    from mbdkit.mechanics.kinematics import kinematics_of
    from mbdkit.mechanics.source import Placed

    if output is not None:
        _check_free(output, spec, overwrite)
    found = kinematics_of(Placed.of(spec, assignments or ()))
    if output is not None:
        from mbdkit.report.style import replacing

        with replacing(output) as temporary:
            found.write_csv(temporary)
    print(json.dumps(summary.kinematics_data(found)) if as_json else summary.kinematics_text(found))


@app.command()
def study(
    spec: StudyName,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="The study's folder; by default ./SPEC.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, metavar="N", help="How many processes compute; by default one a core."),
    ] = None,
    shard: Annotated[
        str | None, typer.Option("--shard", metavar="i/N", help="Compute only part i of N of the runs.")
    ] = None,
    executor: Annotated[
        Literal["local"], typer.Option("--executor", help="Where the processes are: on this machine.")
    ] = "local",
    with_report: Annotated[
        bool, typer.Option("--report", help="Write report.html and figures/ as well, anew.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run a family of specs and collect what comes out.

    The folder gets one archive a run and index.h5, one row a run. A second call
    computes only what is missing; runs that failed are results like others.
    """
    from mbdkit.studies.execute import Shard
    from mbdkit.studies.study import study as carry_out
    from mbdkit.studies.summary import outcome, summary

    part = None if shard is None else Shard.parse(shard)
    path = output if output is not None else Path(_stem(spec))
    notify = silence if quiet else say
    with count_bar(path.name, quiet) as progress:
        result = carry_out(spec, out=path, workers=workers or _cores(), shard=part, progress=progress, notify=notify)
    page = None
    if with_report:
        from mbdkit.report.report import report as write

        page = write(path, overwrite=True)
    if as_json:
        print(json.dumps(outcome(result) | ({} if page is None else {"report": str(page)})))
    elif not quiet:
        print(summary(result))
        if page is not None:
            print(f"report     {page}")


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


@schema_app.command("study")
def schema_study(debug: Debug = False) -> None:
    """Print the JSON schema of a study spec.

    It has the options of every model and integrator that is installed.
    """
    from mbdkit.spec.schema import study_schema

    print(json.dumps(study_schema(), indent=2, ensure_ascii=False))


@schema_app.command("run")
def schema_run(debug: Debug = False) -> None:
    """Print the JSON schema of a run spec.

    It has the options of every model, integrator and force law that is installed.
    """
    from mbdkit.spec.schema import run_schema

    print(json.dumps(run_schema(), indent=2, ensure_ascii=False))


@examples_app.callback(invoke_without_command=True)
def examples(context: typer.Context, debug: Debug = False) -> None:
    """List the packaged examples.

    Run one by its name, or copy its spec to change it.
    """
    if context.invoked_subcommand is not None:
        return
    from mbdkit.spec import example_names, load_spec

    print(table([("NAME", "WHAT"), *((name, load_spec(name).title) for name in example_names())]))


@examples_app.command("copy")
def examples_copy(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An example, as listed.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.yaml", help="Where to; by default ./NAME.yaml.")
    ] = None,
    debug: Debug = False,
) -> None:
    """Write the spec of an example, comments included.

    An existing file is never replaced.
    """
    from mbdkit.errors import SpecError
    from mbdkit.spec import example_text

    text = example_text(name)
    path = output if output is not None else Path(f"{name}.yaml")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise SpecError("this file exists already; choose another name with -o", file=path) from None
    print(path)


@plugins_app.command("list")
def plugins_list(as_json: AsJson = False, debug: Debug = False) -> None:
    """List what is installed, and what could not be loaded."""
    from mbdkit.registry import describe
    from mbdkit.registry.manager import load_installed

    installed = load_installed()
    print(json.dumps(describe.listing(installed)) if as_json else describe.listing_text(installed))


@plugins_app.command("show")
def plugins_show(
    name: Annotated[str, typer.Argument(metavar="ID", help="A name such as gauss, or an id such as mbdkit:gauss.")],
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Show the options, claims and references of one.

    With --json, one object whose "plugins" is a list: a model and an integrator
    may share a name.
    """
    from mbdkit.registry import describe

    items = describe.find(name)
    if as_json:
        print(json.dumps({"plugins": [describe.details(item) for item in items]}))
    else:
        print("\n\n".join(describe.page(item) for item in items))


@plugins_app.command("verify")
def plugins_verify(
    name: Annotated[str, typer.Argument(metavar="ID", help="A name such as gauss, or an id such as mbdkit:gauss.")],
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set one of its options, such as stages=3; may be repeated."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Leave out the slow checks.")] = False,
    as_json: AsJson = False,
    as_html: Annotated[bool, typer.Option("--html", help="Write a page as well.")] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.html", help="The page; by default ./NAME-verification.html."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Hold one to what it claims, by the checks of mbdkit.testing.

    Exit status 1 if it is not verified: a check failed, or none of those that
    matter most could be run. With --json, one object whose "reports" is a list:
    a model and an integrator may share a name.
    """
    from mbdkit.registry import describe
    from mbdkit.spec.reading import read_assignments

    items = describe.find(name)
    options = read_assignments(assignments or ())
    from mbdkit.testing import verify
    from mbdkit.testing.page import check_page, write_page

    page = (output or Path(f"{name.replace(':', '-')}-verification.html")) if as_html or output is not None else None
    if page is not None:
        check_page(page, overwrite=overwrite)
    reports = []
    for item in items:
        with count_bar(item.id, quiet) as bar:
            watch = None if bar is None else lambda done, total, check, bar=bar: bar(done, total, 0)
            notify = silence if quiet else say
            reports.append(verify(item.kind, item.id, options, quick=quick, watch=watch, notify=notify))
    if page is not None:
        write_page(reports, page)
    if as_json:
        print(json.dumps({"reports": [report.to_dict() for report in reports]}))
    elif not quiet:
        print("\n\n".join(report.text() for report in reports))
        if page is not None:
            print(page)
    if not all(report.verified for report in reports):
        raise typer.Exit(terminal.NOT_VERIFIED)


@plugins_app.command("doctor")
def plugins_doctor(as_json: AsJson = False, debug: Debug = False) -> None:
    """Say how loading each plugin went.

    Exit status 4 if one could not be loaded.
    """
    from mbdkit.registry import describe
    from mbdkit.registry.manager import load_installed

    installed = load_installed()
    print(json.dumps(describe.diagnosis(installed)) if as_json else describe.diagnosis_text(installed))
    if not describe.is_sound(installed):
        raise typer.Exit(terminal.PLUGIN_FAILED)


@plugins_app.command("new")
def plugins_new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the distribution, such as mbdkit-rocket.")],
    kind: Annotated[
        Literal["integrator", "tableau", "model", "force-law"], typer.Option("--kind", help="What it is to offer.")
    ],
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Make the project of a new plugin in ./NAME.

    It installs as it is, its tests pass, and its README says what to change.
    Nothing that exists is touched.
    """
    from mbdkit.scaffold.new import new_project

    project = new_project(name, kind)
    if as_json:
        files = sorted(str(path) for path in project.rglob("*") if path.is_file())
        print(json.dumps({"path": str(project), "kind": kind, "files": files}))
    else:
        print(f"{project}: pip install -e './{project}[test]', and then see {project / 'README.md'}")


@app.command()
def plot(
    archive: Archive,
    kind: Annotated[
        Literal["trajectory", "drift", "energy", "reactions"], typer.Option("--kind", help="What to plot.")
    ] = "trajectory",
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
    from mbdkit.report.plot import plot as draw

    with load(archive) as loaded:
        target = draw(loaded, kind, output or archive.with_name(f"{archive.stem}-{kind}.png"))
    if not quiet:
        print(target)


@app.command()
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


@app.command()
def report(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A run archive, or the folder of a study.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE.html",
            help="The page; by default NAME-report.html, or report.html in a study.",
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


@archive_app.command("info")
def archive_info(archives: Archives, as_json: AsJson = False, debug: Debug = False) -> None:
    """Describe run archives.

    With --json, one object whose "archives" is a list.
    """
    from mbdkit.archive.info import describe, text

    descriptions = [describe(archive) for archive in archives]
    if as_json:
        print(json.dumps({"archives": descriptions}))
    else:
        print("\n\n".join(text(description) for description in descriptions))


@archive_app.command("check")
def archive_check(archives: Archives, quiet: Quiet = False, debug: Debug = False) -> None:
    """Check run archives to the last array.

    Exit status 2 if anything is wrong with one.
    """
    from mbdkit.archive.check import check

    sound = True
    for archive in archives:
        problems = check(archive)
        sound = sound and not problems
        for problem in problems:
            say(f"{archive}: {problem}")
        if not problems and not quiet:
            print(f"{archive}: sound")
    if not sound:
        raise typer.Exit(terminal.WRONG_INPUT)


@app.command()
def rerun(
    archive: Archive,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.h5", help="Keep the new archive; by default it is not."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run the spec in an archive again and compare.

    Exit status 1 if the data differ; the largest relative difference is said.
    """
    if output is not None:
        _check_new(output, str(archive), overwrite)
    from mbdkit.archive.compare import compare
    from mbdkit.archive.needed import check_plugins_of
    from mbdkit.archive.reader import load
    from mbdkit.errors import SpecError
    from mbdkit.simulation import simulate
    from mbdkit.spec import load_spec

    with load(archive) as before:
        check_plugins_of(archive, before.provenance)
        try:
            checked = load_spec(before.spec)
        except SpecError as error:
            raise error.located(file=archive) from error
        with progress_bar(archive.name, quiet) as progress:
            result = simulate(
                checked, path=output, overwrite=overwrite, progress=progress, notify=silence if quiet else say
            )
        with result as after:
            if after.status == "interrupted":
                _exit_with(after)
            comparison = compare(before, after)
            if not quiet:
                if before.status in ("interrupted", "running"):
                    print(f"{archive} was cut short ({before.status}), so it has fewer rows")
                print(comparison)
    if not comparison.same_data:
        raise typer.Exit(terminal.DIFFERS)


def _load(spec: str, assignments: list[str] | None) -> RunSpec:
    from mbdkit.spec import load_spec

    return load_spec(spec, assignments or ())


@contextmanager
def _placing(spec: RunSpec) -> Iterator[None]:
    """Give errors about this spec the file and line where it was written."""
    from mbdkit.errors import SpecError

    try:
        yield
    except SpecError as error:
        raise spec.placed(error) from error


def _stem(spec: str) -> str:
    return "stdin" if spec == "-" else Path(spec).stem


def _check_new(path: Path, source: str, overwrite: bool) -> None:
    """Refuse an archive that cannot be written, before any work."""
    from mbdkit.archive.target import check_target
    from mbdkit.errors import SpecError

    if source != "-" and os.path.isfile(path) and os.path.isfile(source) and os.path.samefile(path, source):
        raise SpecError(
            "this is what is read here, so it is not written to; choose another name with -o "
            "(and `mbdkit rerun` runs an archive again)",
            file=path,
        )
    if os.path.isfile(path) and not overwrite:
        raise SpecError("this file exists; choose another name with -o, or replace it with --overwrite", file=path)
    check_target(path, overwrite=overwrite)


def _check_free(path: Path, source: str, overwrite: bool) -> None:
    """Refuse to write over a file that exists, or over what is read, before any work."""
    from mbdkit.errors import SpecError

    if path.is_dir():
        raise SpecError("this is a folder; name a file", file=path)
    if not path.exists():
        return
    if source != "-" and os.path.isfile(source) and os.path.samefile(path, source):
        raise SpecError("this is what is read here, so it is not written to; choose another name", file=path)
    if not overwrite:
        raise SpecError("this file exists; choose another name, or replace it with --overwrite", file=path)


def _outcome(result: Run) -> dict[str, Any]:
    return {
        "path": None if result.path is None else str(result.path),
        "status": result.status,
        "status_reason": result.status_reason,
        "run_id": result.run_id,
        "stats": dict(result.stats),
        "misalignment_max": result.misalignment_max,
    }


def _exit_with(result: Run, *, told: bool = False) -> None:
    """Leave with the exit status that the run's status asks for; say why, unless the summary has `told` already."""
    if result.status == "complete":
        return
    if not told:
        say(f"{result.status}: {result.status_reason.removeprefix('interrupted: ')}")
    if result.status == "interrupted":
        raise typer.Exit(terminal.INTERRUPTED)
    failed_plugin = result.status_reason.startswith("plugin-error")
    raise typer.Exit(terminal.PLUGIN_FAILED if failed_plugin else terminal.STOPPED_EARLY)


def main() -> None:
    """Run the command line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name that the terminal has no letters for
    app(prog_name="mbdkit")
