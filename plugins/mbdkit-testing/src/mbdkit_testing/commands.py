"""Commands on this installation and its plugins: `doctor`, and those of the group `plugins` apart from `where`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from mbdkit.base import terminal
from mbdkit.base.errors import SpecError
from mbdkit.base.progress_bars import count_bar
from mbdkit.base.terminal import say, show_result, silence
from mbdkit.base.text import listed
from mbdkit.cli.common_options import AsJson, Debug, Overwrite, Quiet, output_to
from mbdkit.registry.manager import checked, load_installed
from mbdkit.spec.reading import Document
from mbdkit_testing import describe
from mbdkit_testing.scaffold.new_plugin import KINDS, LIKE, Like, NewKind, new_project


def doctor(as_json: AsJson = False, debug: Debug = False) -> None:
    """Check this installation: plugins, machine code, small runs.

    The hashes of ten runs are compared with stored ones. Exit status 1 if one
    differs or fails, 4 if a plugin could not be loaded.
    """
    from mbdkit_testing import self_test

    found = self_test.compared()
    _diagnose(as_json, {"self_test": found}, [self_test.sentences(found)])
    if any(text != self_test.EQUAL for text in found.values()):
        raise typer.Exit(terminal.DIFFERS)


def _diagnose(as_json: bool, further: Mapping[str, object], lines: Iterable[str] = ()) -> None:
    """Print the plugins and the machine code in use, and `further` values of the JSON or the `lines` of the text."""
    from mbdkit.engine.native.machine_code import code_report, code_text

    installed = checked(load_installed())
    values = {**describe.diagnosis(installed), "machine_code": code_report(), **further}
    show_result(values, "\n".join([describe.diagnosis_text(installed), code_text(), *lines]), as_json=as_json)
    if installed.failures:
        raise typer.Exit(terminal.PLUGIN_FAILED)


def plugins_list(as_json: AsJson = False, debug: Debug = False) -> None:
    """List installed plugins, and those that could not be loaded.

    What belongs to mbdkit itself is checked by `mbdkit plugins doctor` only.
    """
    installed = checked(load_installed(), whole=False)
    show_result(describe.listing(installed), describe.listing_text(installed), as_json=as_json)


def plugins_show(
    name: Annotated[str, typer.Argument(metavar="ID", help="A name such as gauss, or an id such as mbdkit:gauss.")],
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Show the options, claims and references of a plugin.

    Of items without options, such as commands and element kinds, it shows the
    summary, and which command says more. With --json, prints one object with a
    list "plugins": a model and an integrator may share a name.
    """
    items = describe.find(name)
    values = {"plugins": [describe.details(item) for item in items]}
    show_result(values, "\n\n".join(describe.page(item) for item in items), as_json=as_json)


def plugins_doctor(as_json: AsJson = False, debug: Debug = False) -> None:
    """Show the plugins, the machine code in use, and any problems.

    Exit status 4 if a plugin could not be loaded.
    """
    _diagnose(as_json, {})


def plugins_verify(
    name: Annotated[str, typer.Argument(metavar="ID", help="A name such as gauss, or an id such as mbdkit:gauss.")],
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set an option, such as stages=3; may be repeated."),
    ] = None,
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Skip the slow checks.")] = False,
    record: Annotated[
        bool, typer.Option("--record", help="Write the results into the package, as mbdkit-evidence.json.")
    ] = False,
    as_json: AsJson = False,
    output: Annotated[Path | None, output_to("FILE", "With --record, the file of the evidence.")] = None,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Verify the claims of a plugin by the checks of mbdkit.testing.

    Exit status 1 if it is not verified: a check failed, or no check of the
    required group could be run. The name of a distribution verifies all of its
    methods, joints, elements, laws, models and measures and, without --record,
    its kinds of plots and sections of reports. --record stores the
    results with a digest of the code in the package of the plugin, or in the file
    after -o; without --set, all options that were recorded before are verified
    again. Archives, `plugins list` and `plugins show` then say what was verified,
    and whether the code has changed since. With --json, prints one object with a list
    "reports": a model and an integrator may share a name.
    """
    from mbdkit_testing import recorded_evidence, verify

    items = describe.find_to_verify(name, () if record else ("plot-kind", "report-section"))
    options = Document({})
    for assignment in assignments or ():
        options.assign(assignment)
    if output is not None and not record:
        raise SpecError("-o takes effect only with --record")
    written = recorded_evidence.place_of_evidence(items, output) if record else None
    reports, records = [], []
    for item in items:
        chosen = [options.data] if assignments or written is None else recorded_evidence.recorded_options(item, written)
        for given in chosen:
            with count_bar(item.id, quiet) as bar:
                watch = None if bar is None else lambda done, total, check, bar=bar: bar(done, total, 0)
                notify = silence if quiet else say
                reports.append(verify(item.kind, item.id, given, quick=quick, watch=watch, notify=notify))
            records.append(recorded_evidence.record_of(item, reports[-1], quick=quick))
    if written is not None:
        recorded_evidence.write_records(records, written)
    text = "\n\n".join(report.text() for report in reports) + ("" if written is None else f"\n{written}")
    show_result({"reports": [report.to_dict() for report in reports]}, text, as_json=as_json, quiet=quiet)
    if not all(report.verified for report in reports):
        raise typer.Exit(terminal.NOT_VERIFIED)


def plugins_matrix(
    output: Annotated[Path, output_to("FOLDER", "Folder for matrix.html, matrix.csv and matrix.json.")],
    names: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="NAME", help="Verify this plugin or distribution now; may be repeated."),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Verify what this evidence is about again, and show what is broken."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Skip the slow checks.")] = False,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Draw what was observed of all plugins, side by side.

    The figures are those of recorded evidence: see `mbdkit plugins verify --record`.
    With --against, the matrix has only the plugins in that file, as they are now;
    exit status 1 if a check that passed then fails now.
    """
    from mbdkit_testing import matrix

    matrix.check_files(output, overwrite=overwrite)
    notify = silence if quiet else say
    if against is None:
        items = [item for name in names or () for item in describe.find_to_verify(name)]
        rows = matrix.recorded_rows([matrix.verified_row(item, {}, quick=quick) for item in items])
    else:
        rows = matrix.rows_against(against, quick=quick, watch=notify)
    matrix.write_matrix(rows, output)
    broken = [f"{row.id}: {sentence}" for row in rows for sentence in row.broken]
    values = {"path": str(output), "rows": len(rows), "broken": broken}
    show_result(values, "\n".join([*broken, str(output / "matrix.html")]), as_json=as_json, quiet=quiet)
    if broken:
        raise typer.Exit(terminal.NOT_VERIFIED)


def plugins_new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the distribution, such as mbdkit-rocket.")],
    kind: Annotated[NewKind, typer.Option("--kind", metavar="KIND", help=f"Kind of plugin: {listed(KINDS)}.")],
    like: Annotated[
        Like | None,
        typer.Option("--like", metavar="SORT", help=f"Sort of integrator: {listed(LIKE)}; by default adaptive."),
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Create the project of a new plugin in ./NAME.

    It can be installed at once, its tests pass, and its README says what to
    change. Existing files are not changed. `mbdkit guide plugins` has examples
    of studies, commands and further kinds.
    """
    project = new_project(name, kind, like=like)
    files = sorted(str(path) for path in project.rglob("*") if path.is_file())
    text = f"{project}: pip install -e './{project}[test]', and then see {project / 'README.md'}"
    show_result({"path": str(project), "kind": kind, "files": files}, text, as_json=as_json)
