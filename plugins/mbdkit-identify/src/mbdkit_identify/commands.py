"""The command `identify`."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdkit.plugin import SpecCommand, counted, listed, show
from mbdkit.plugin.seams import spec_check

if TYPE_CHECKING:
    from mbdkit.plugin.specs import Document
    from mbdkit_identify.identification import Identification


@SpecCommand.of("a packaged identification", "The result")
def identify(
    command: SpecCommand,
    *,
    report: Annotated[bool, typer.Option("--report", help="Also write a report, as `mbdkit report` does.")] = False,
) -> None:
    """Find parameters of a model from measured motion.

    Experiments with measured data, parameters and sensors are stated in the spec. The
    result has the estimates with their intervals and covariance, what the data do not
    determine, residuals, and whether the model is right. Runs take the estimates with
    `parameters: {from: FILE.h5}`. See `mbdkit guide identify`.

    Exit status 3 if the verdict is bad.
    """
    from mbdkit_identify.archive import write_identification
    from mbdkit_identify.identify import identify as solve
    from mbdkit_identify.loading import load_identify_spec

    result = solve(command.load(load_identify_spec), notify=command.notify)
    write_identification(result, command.path, command.overwrite)
    written, values = f"result: {command.path}", {"path": str(command.path), **_plain(result)}
    if report:
        from mbdkit.plugin.reports import report as write

        page = write(command.path, overwrite=command.overwrite)
        written, values = f"{written}, report: {page}", {**values, "report": str(page)}
    command.conclude(f"{result.summary()}\n{written}", values, is_good=result.verdict != "bad")


def _plain(result: Identification) -> dict[str, Any]:
    """Return the result without specs and histories, as values for JSON."""
    histories = ("time", "measured", "fitted", "white", "band")
    signals = [
        {name: value for name, value in vars(one).items() if name not in histories} | {"rms": one.rms}
        for one in result.residuals
    ]
    values = asdict(replace(result, spec={}, base={}, residuals=(), profiles={}))
    left_out = ("spec", "base", "residuals", "profiles")
    values = {name: value for name, value in values.items() if name not in left_out}
    return values | {"covariance": result.covariance.tolist(), "signals": signals}


@spec_check
def validate_identify(source: Document | str, name: str, assignments: list[str]) -> None:
    """Check the spec of an identification, its base and its data, and print what would be estimated."""
    from mbdkit_identify.loading import load_identify_spec
    from mbdkit_identify.measured_data import read_experiment

    spec = load_identify_spec(source, assignments)
    data = [read_experiment(spec, experiment) for experiment in spec.experiments]
    show(f"{name}: this identification is valid")
    for one in data:
        samples = f"{counted(len(one.time), 'sample')} from {one.time[0]:g} to {one.time[-1]:g} s"
        signals = listed([signal.quantity for signal in one.signals], "and")
        held_out = ", held out" if one.experiment.role == "hold-out" else ""
        show(f"experiment   {one.name}{held_out}: {signals}, {samples}")
        for note in one.notes:
            show(f"note: {note}")
    show(f"parameters   {', '.join(spec.parameters)}")
    if spec.intervals.of:
        show(f"expressions  {', '.join(f'{key} = {text}' for key, text in spec.intervals.of.items())}")
    show(f"intervals    {100 * spec.intervals.level:g} %, {spec.intervals.method}")
    if spec.candidates:
        show(f"candidates   {', '.join(spec.candidates)}")
