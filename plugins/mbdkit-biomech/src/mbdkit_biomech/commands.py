"""Commands of inverse dynamics: `inverse` and `workload`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError
from mbdkit.base.terminal import say, show, show_json
from mbdkit.base.text import counted, shown
from mbdkit.cli.common_options import Archive, AsJson, Debug, SpecCommand
from mbdkit.cli.outcome import tell
from mbdkit.runs.run_seams import repeated_run
from mbdkit.spec.reading import Document
from mbdkit.spec.spec_kinds import spec_check


@SpecCommand.of("a packaged example such as walking", key="motion.smooth.cutoff=6")
def inverse(command: SpecCommand) -> None:
    """Compute joint and actuator forces from a measured motion.

    First, the mechanism is fitted to the measured data, with its joints closed to
    round-off. Then the motion is smoothed, and the equations of motion are solved for the
    actuators and the reactions. See `mbdkit guide inverse`, and `mbdkit guide persons` for
    the markers of a person.
    """
    from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec

    checked = command.load(load_inverse_spec)
    from mbdkit_biomech.inverse_dynamics.results.inverse_run import compute_run

    tell(compute_run(checked, path=command.path, overwrite=command.overwrite), command.printing)


def workload(
    archive: Archive,
    load: Annotated[
        str | None,
        typer.Option("--load", metavar="LOAD", help="Begin a cycle when the force of this load exceeds the threshold."),
    ] = None,
    threshold: Annotated[
        float, typer.Option("--threshold", metavar="N", help="Force above which there is contact [N].")
    ] = 20.0,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Print the workload of joints: peaks, impulses and work.

    With --load, the workload is also printed for each phase of contact, each swing and each cycle, and --json contains
    the mean cycle from 0 to 100 % with its standard deviation. Drivers of a forward run count as actuators.
    """
    from mbdkit.archive.archive_check import blaming_damage
    from mbdkit.archive.reader import load as opened
    from mbdkit_biomech.inverse_dynamics.results.workload import workload as of

    with blaming_damage(archive), opened(archive) as run:
        found = of(run, load=load, threshold=threshold)
        if as_json:
            show_json(found.to_dict())
        else:
            show(found.text())


@repeated_run
def repeated_inverse(before: Run, archive: Path, output: Path | None, *, overwrite: bool, progress: object) -> Run:
    """Compute the inverse dynamics of an archive again.

    Tables are read from the folder of the archive only: an untrusted archive must not
    make mbdkit read other files.

    Raises
    ------
    SpecError
        If a table is not there.
    """
    from mbdkit_biomech.inverse_dynamics.results.inverse_run import compute_run
    from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec

    folder, motion = archive.parent.resolve(), before.spec["motion"]
    own = [before.spec.get(key, {}).values() for key in ("loads", "emg")]
    tables = [one.get("file") for group in own for one in group if isinstance(one, dict)]
    files = (motion.get("file"), motion.get("static"), *tables)
    for file in filter(None, files):  # before the spec is loaded, which reads the files of a person
        path = (folder / file).resolve()
        if not (path.is_relative_to(folder) and path.is_file()):
            raise SpecError(
                f"its data are in {shown(file)}, which is not in the folder of the archive; repeat it "
                "from its spec with `mbdkit inverse`"
            )
    spec = load_inverse_spec(Document(before.spec, folder=archive.parent))
    return compute_run(spec, path=output, overwrite=overwrite)


@spec_check
def validate_inverse(source: str | Document, name: str, assignments: list[str]) -> None:
    """Check a spec of inverse dynamics, its data and their first frame, and print what would be computed."""
    from mbdkit.measures.take import check_measures
    from mbdkit.mechanism.mechanism import gravity_text
    from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, check
    from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import doubts_before_computation
    from mbdkit_biomech.inverse_dynamics.results.inverse_run import causes_named
    from mbdkit_biomech.inverse_dynamics.results.inverse_summary import UNUSED_DATA
    from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
    from mbdkit_biomech.inverse_dynamics.spec.named_actuators import free_roots

    spec = load_inverse_spec(source, assignments)
    problem = InverseProblem.of(spec)
    check_measures(spec)
    with causes_named(problem):
        check(problem)
    measured, time = problem.measured, problem.measured.time
    for warning in (*problem.warnings, *doubts_before_computation(problem)):
        say(f"warning: {warning}")
    show(f"{name}: this spec of inverse dynamics is valid")
    show(f"model        {spec.model_item.id}: {spec.mechanism().description()}")
    show(f"gravity      {gravity_text(spec.mechanism().gravity)}")
    show(f"freedom      {problem.prepared.workspace.mechanism.freedoms()}")
    for label, text in ({} if spec.person is None else spec.person.lines()).items():
        show(f"{label:<12} {text}")
    show(f"motion       {counted(len(time), 'row')} from {time[0]:g} to {time[-1]:g} s: {', '.join(measured.names)}")
    for key, text in problem.unused.notes.items():
        show(f"{UNUSED_DATA[key]:<12} {text}")
    if problem.loads:
        show(f"loads        {', '.join(problem.loads)}")
    show(f"actuators    {', '.join(actuator.name for actuator in problem.recorded_actuators) or 'none'}")
    if any(actuator.is_residual for actuator in problem.actuators):
        show(f"residuals    on {', '.join(free_roots(spec.mechanism()))}")
    if problem.recruiter is not None:
        show(f"muscles      {', '.join(problem.recruiter.muscles)}")
    show("not checked  rows after the first, smoothed motion, loads and results, which `mbdkit inverse` checks")
