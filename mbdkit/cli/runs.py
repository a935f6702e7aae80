"""Commands that run a spec: `run`, `validate`, `rerun`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbdkit.base import higher_layers, terminal
from mbdkit.base.called_functions import calls_allowed, returning
from mbdkit.base.errors import SpecError
from mbdkit.base.progress_bars import progress_bar
from mbdkit.base.terminal import say, show
from mbdkit.base.text import listed, table
from mbdkit.cli.common_options import (
    AnySpecName,
    Archive,
    Call,
    Debug,
    Files,
    Overwrite,
    Printing,
    Quiet,
    Set,
    SpecNameOrNone,
    check_new,
    grouped,
    output_to,
    stem,
)
from mbdkit.cli.outcome import exit_with, tell
from mbdkit.spec.spec_kinds import kind_of, packaged_spec, spec_check, spec_kinds, spec_loader

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.engine.assembly import AssembledState
    from mbdkit.engine.workspace import Workspace
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.registry.feature_items import SpecKind
    from mbdkit.spec import RunSpec
    from mbdkit.spec.reading import Document

BODIES_SHOWN = 20


@grouped
def run(
    spec: SpecNameOrNone = None,
    *,
    output: Annotated[Path | None, output_to("FILE.h5", "The archive; by default ./SPEC.h5.")] = None,
    assignments: Set = None,
    overwrite: Overwrite = False,
    check: Annotated[
        bool, typer.Option("--check", help="Estimate errors by comparison runs; takes 4 to 15 times as long, or more.")
    ] = False,
    accuracy: Annotated[
        float | None,
        typer.Option("--accuracy", metavar="FRACTION", help="Choose method and step for this accuracy, such as 1e-6."),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="FILE", help="Continue the killed or interrupted run that left this file."),
    ] = None,
    files: Files = False,
    call: Call = False,
    printing: Printing,
) -> None:
    """Run a spec and write its archive.

    With --check, comparison runs estimate the errors of positions, velocities and
    reactions, and the time until which these errors are known.

    With --accuracy, mbdkit chooses method and step from short trial runs, so that errors
    of positions stay below this fraction of the mechanism's size over the whole run, and
    a check confirms this. If the spec names an integrator, only its step or tolerance is
    chosen.

    With --resume instead of SPEC, a run that was killed (FILE.h5.part) or interrupted by
    Ctrl-C (FILE.h5, with --overwrite) is continued from its last checkpoint; the results
    are bitwise identical to those of an uninterrupted run.
    Checkpoints are written every 5 s, except by SciPy's solvers, other methods whose state
    cannot be stored, and with --accuracy. Files that its spec names are read only with
    --files, and only if they have the SHA-256 that FILE lists.

    With --call, Python functions that controllers of the spec name are called; without
    it, such a spec is refused. They can execute any code: read the spec before.

    Gravity is (0, -9.81) m/s^2 unless `model.gravity` of the spec is given.
    """
    if resume is not None:
        given = {"SPEC": spec, "--output": output, "--set": assignments, "--check": check, "--accuracy": accuracy}
        with calls_allowed(call):
            _resume(resume, [name for name, value in given.items() if value], overwrite, files, printing)
        return
    if files:
        raise typer.BadParameter("takes effect only with --resume; files that SPEC names are always read")
    if spec is None:
        raise typer.BadParameter("give a SPEC, or --resume FILE", param_hint="SPEC")
    from mbdkit.spec import load_spec

    if accuracy is not None:
        _check_accuracy(accuracy)
    asked = [*(["check=true"] if check else []), *([] if accuracy is None else [f"accuracy={accuracy!r}"])]
    checked = load_spec(spec, [*(assignments or ()), *asked])
    path = output if output is not None else Path(f"{stem(spec)}.h5")
    check_new(path, spec, overwrite)
    from mbdkit.runs.simulation import simulate  # imports compiled code, which is not needed to refuse an invalid spec

    with SpecError.place_by(checked.placed), calls_allowed(call), progress_bar(path.name, printing.quiet) as progress:
        result = simulate(checked, path=path, overwrite=overwrite, progress=progress)
    tell(result, printing)


def _resume(part: Path, superfluous: list[str], overwrite: bool, files: bool, printing: Printing) -> None:
    """Continue a run that was killed or interrupted."""
    if superfluous:
        new = "; other settings, such as a later time.end, need a new run" if "--set" in superfluous else ""
        raise SpecError(f"--resume reads all settings from {part.name}: omit {', '.join(superfluous)}{new}")
    from mbdkit.runs.resuming import continue_run, final_path

    with progress_bar(final_path(part).name, printing.quiet) as progress:
        result = continue_run(part, overwrite=overwrite, progress=progress, files=files)
    tell(result, printing)


def _check_accuracy(accuracy: float) -> None:
    """Raise SpecError for an accuracy outside the allowed limits."""
    from mbdkit.spec.run_spec import LARGEST_ACCURACY, SMALLEST_ACCURACY

    if not SMALLEST_ACCURACY <= accuracy <= LARGEST_ACCURACY:  # also false for nan
        why = f"; rounding errors dominate below {SMALLEST_ACCURACY:g}" if accuracy < SMALLEST_ACCURACY else ""
        message = (
            f"--accuracy should be a share of the mechanism's size from {SMALLEST_ACCURACY:g} to {LARGEST_ACCURACY:g}"
        )
        raise SpecError(f"{message}, not {accuracy:g}{why}")


def validate(
    spec: AnySpecName,
    assignments: Set = None,
    assembled: Annotated[
        Path | None,
        typer.Option("--assembled", metavar="FILE", help="Write the run spec with the initial values after assembly."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Check a spec of any kind without running it.

    The mechanism is built and its initial state made consistent; changes of the initial
    state are printed. Gravity is (0, -9.81) m/s^2 unless `model.gravity` is given. For a
    study, the expressions of its measures and the specs of all runs are checked (a few of
    them if many runs share a file); --set changes the base of every run.

    With --assembled, the spec is also written with the initial values after assembly, so
    that its start is consistent. The text is kept, comments included, as far as it
    defines the bodies itself; otherwise, the mechanism is written in full.
    """
    from mbdkit.spec.loading import read_source

    if spec != "-" and not os.path.isfile(spec):
        for kind in spec_kinds():
            if kind.is_packaged is not None and packaged_spec.of(kind.is_packaged)(spec):
                _validate(kind, spec, spec, assignments)
                return
    document = read_source(spec)
    kind = kind_of(document.data)
    _validate(kind, document, spec, assignments)
    if assembled is not None:
        _write_assembled(kind, document, spec, assignments, assembled)


def _write_assembled(kind: SpecKind, source: Document, name: str, assignments: list[str] | None, path: Path) -> None:
    """Write a run spec with the initial values after assembly."""
    from mbdkit.runs.assembled_spec import write_assembled
    from mbdkit.runs.preparation import build
    from mbdkit.spec import example_text, load_spec

    if kind.run_kind not in ("forward", ""):
        raise SpecError(f"--assembled writes specs of runs, but this is {kind.phrase}", file=name)
    spec, text = load_spec(source, assignments or ()), ""
    if not assignments and name != "-" and Path(name).suffix.lower() != ".toml":
        text = Path(name).read_text("utf-8") if os.path.isfile(name) else example_text(name)
    start = build(spec)[1]
    if not start.changed:
        raise SpecError("the start is consistent, so that --assembled has nothing to write", file=name)
    is_kept = write_assembled(spec, start, text, path)
    show(f"written      {path}, {'with the text of the spec' if is_kept else 'with the mechanism in full'}")


def _validate(kind: SpecKind, source: Document | str, name: str, assignments: list[str] | None) -> None:
    from mbdkit.registry.manager import registry, use

    item = registry().get("spec-kind", kind.name)
    if kind.validate is not None:
        use(item, lambda check=kind.validate: spec_check.of(check)(source, name, assignments or []))  # type: ignore[misc]
    else:
        use(item, lambda: spec_loader.of(kind.load)(source, assignments or ()))
        show(f"{name}: this is valid as {kind.phrase}")


@spec_check
def validate_run(source: Document | str, name: str, assignments: list[str]) -> None:
    """Check a run spec, build its mechanism, and print what it defines."""
    from mbdkit.spec import load_spec

    checked = load_spec(source, assignments)
    from mbdkit.engine.spanning_tree import cut_joints
    from mbdkit.mechanism.mechanism import gravity_text
    from mbdkit.runs.corners import check_jumps
    from mbdkit.runs.preparation import RunSetup, make_method

    mechanism = checked.mechanism()
    check_jumps(checked)
    if checked.gradients:
        higher_layers.check_gradients(checked, make_method(checked))
    setup = RunSetup.of(checked)
    problem, start = setup.workspace, setup.start
    with SpecError.place_by(checked.placed):
        setup.require_support()
    for warning in setup.findings():
        say(f"warning: {warning}")
    show(f"{name}: this spec is valid")
    show(f"model        {checked.model_item.id}: {mechanism.description()}")
    show(f"gravity      {gravity_text(mechanism.gravity)}")
    show(f"freedom      {problem.mechanism.freedoms()}")
    chosen = {"method": "method and step", "step": "its step or tolerance"}.get(checked.choose or "")
    if chosen:
        show(f"accuracy     {checked.accuracy:g} of the mechanism's size: the run chooses {chosen}")
    if checked.choose != "method":
        show(f"integrator   {checked.integrator_item.id}, {checked.formulated.name}")
    if checked.formulated.coordinates == "joint":
        without = "none, so that `loops` has no effect" if checked.formulated.solves_multipliers else "none"
        show(f"cut joints   {listed(cut_joints(problem.mechanism)) or without}")
    if checked.stabilized.kind != "none":
        show(f"stabilized   {checked.stabilized.describe()}")
    if slides := _slides(mechanism, start):
        show("slides       the travel grows where the point of BODY moves along DIRECTION, both as at the start")
        show(table([("JOINT", "BODY", "ON", "DIRECTION", "TRAVEL"), *slides], indent="  "))
    if mechanism.inputs:
        show("inputs       with their values at the start")
        show(table([("INPUT", "AT START", "UNIT", "BOUNDS", "HOLD", "TIMES"), *_inputs(checked, problem)], indent="  "))
    if checked.events:
        show("events       with values of their expressions at the start")
        show(table([("EVENT", "DIRECTION", "ACTION", "AT START", "WHEN"), *_events(checked, problem)], indent="  "))
    if start.changed:
        show(f"start        made consistent, with residuals {start.residual:.2g} and {start.velocity_residual:.2g}")
        show(table([("BODY", "MOVED", "TURNED", "VELOCITY", "RATE"), *_moves(start)], indent="  "))
    else:
        show("start        consistent, unchanged")


def _slides(mechanism: Mechanism, start: AssembledState) -> list[tuple[str, ...]]:
    """Return a table row for each joint with a travel: its global direction and the travel at the start."""
    from mbdkit.base.plain_data import quoted
    from mbdkit.mechanism.mechanism_quantities import Point, Travel
    from mbdkit.mechanism.quantity_names import QuantityNames

    rows: list[tuple[str, ...]] = []
    q, names = start.q.reshape(1, -1), QuantityNames(mechanism)
    for name, joint in mechanism.joints.items():
        travel = names.joint(name, f"model.joints.{quoted(name)}")
        if isinstance(travel, Travel):
            x, y = (
                round(component.item(), 4) + 0.0 for component in Point(travel.first.body, *travel.direction).arm(q)
            )
            rows.append((name, joint.bodies[1], joint.bodies[0], f"({x:g}, {y:g})", f"{travel.value(q).item():.6g} m"))
    return rows


def _inputs(spec: RunSpec, problem: Workspace) -> list[tuple[str, ...]]:
    """Return a table row for each input, with its value at the start and the number of times at which it is set."""
    from mbdkit.integrators.run.sampled_control import states_at_start

    z = states_at_start(problem)
    return [
        (
            item.name,
            f"{z[item.state]:.6g}",
            item.unit,
            "none" if item.bounds is None else f"{item.bounds[0]:g} to {item.bounds[1]:g}",
            spec.mechanism().inputs[item.name].hold,
            str(len(schedule.times)),
        )
        for item, schedule in zip(problem.mechanism.inputs, spec.schedules(), strict=True)
    ]


def _events(spec: RunSpec, problem: Workspace) -> list[tuple[str, ...]]:
    """Return a table row for each event, with the value of its expression at the start."""
    from mbdkit.events.watch import values_at_start

    values = values_at_start(spec.watched(), problem)
    return [
        (
            name,
            event.direction,
            f"set {listed(list(event.set), 'and')}" if event.set else event.action,
            f"{values[name]:.6g}",
            event.when,
        )
        for name, event in spec.events.items()
    ]


def _moves(start: AssembledState) -> list[tuple[str, ...]]:
    """Return a table row for each body whose initial state was changed, the largest changes first."""
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


def rerun(
    archive: Archive,
    output: Annotated[Path | None, output_to("FILE.h5", "Keep the new archive; by default it is discarded.")] = None,
    overwrite: Overwrite = False,
    files: Files = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run the spec of an archive again and compare the results.

    Prints the largest relative difference. Files that the spec names, such as models of
    other programs and tables, are read only with --files, tables only from the folder of
    the archive, and only if they have the SHA-256 that the archive lists. Controllers in
    Python repeat their recorded outputs; their functions are not called. Exit status 1
    if the data differ.
    """
    if output is not None:
        check_new(output, str(archive), overwrite)
    from mbdkit.archive.compare import compare
    from mbdkit.archive.missing_plugins import check_plugins_of
    from mbdkit.archive.reader import load
    from mbdkit.archive.recorded_data import recorded_outputs
    from mbdkit.base.files_read import only_known

    with load(archive) as before:
        check_plugins_of(archive, before.provenance)
        with (
            only_known(before.files, allowed=files),
            returning(recorded_outputs(before)),
            _repeated(before, archive, output, overwrite=overwrite, quiet=quiet) as after,
        ):
            if after.status == "interrupted":
                exit_with(after)
            if after.status != "complete":
                say(f"the new run stopped early: {after.status}: {after.status_reason}")
            comparison = compare(before, after)
            if not quiet:
                if before.status in ("interrupted", "running"):
                    show(f"{archive} is incomplete ({before.status}), so that it has fewer recorded times")
                show(comparison)
    if not comparison.same_data:
        raise typer.Exit(terminal.DIFFERS)


def _repeated(before: Run, archive: Path, output: Path | None, *, overwrite: bool, quiet: bool) -> Run:
    """Repeat the run in an archive."""
    from mbdkit.runs.run_seams import computed_run, repeated_run

    in_archive = SpecError.place_by(lambda error: error.located(file=archive))
    with in_archive, progress_bar(archive.name, quiet) as progress:
        kind = before.spec_kind
        if kind.repeat is None:
            spec = spec_loader.of(kind.load)(before.spec, ())
            return computed_run.of(kind.compute)(spec, path=output, overwrite=overwrite, progress=progress)
        return repeated_run.of(kind.repeat)(before, archive, output, overwrite=overwrite, progress=progress)
