"""The command `identify`."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdkit.plugin import counted, listed, show, show_json
from mbdkit.plugin.seams import spec_check
from mbdkit.plugin.terminal import (
    STOPPED_EARLY,
    Overwrite,
    Printing,
    Set,
    check_new,
    grouped,
    output_to,
    say,
    silence,
    stem,
)

if TYPE_CHECKING:
    from mbdkit.plugin.specs import Document
    from mbdkit_identify.identification import Identification


@grouped
def identify(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC",
            help="A YAML, TOML or JSON file, - for stdin, or a packaged identification.",
        ),
    ],
    *,
    output: Annotated[Path | None, output_to("FILE.h5", "The result; by default ./SPEC.h5.")] = None,
    assignments: Set = None,
    report: Annotated[bool, typer.Option("--report", help="Also write a report, as `mbdkit report` does.")] = False,
    overwrite: Overwrite = False,
    printing: Printing,
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

    path = output if output is not None else Path(f"{stem(spec)}.h5")
    loaded = load_identify_spec(spec, assignments or ())
    check_new(path, spec, overwrite)
    result = solve(loaded, notify=silence if printing.quiet or printing.as_json else say)
    write_identification(result, path, overwrite)
    page = None
    if report:
        from mbdkit_report import report as write

        page = write(path, overwrite=overwrite)
    if printing.as_json:
        show_json({"path": str(path), **_plain(result)} | ({} if page is None else {"report": str(page)}))
    elif not printing.quiet:
        show(result.summary())
        show(f"result: {path}{'' if page is None else f', report: {page}'}")
    if result.verdict == "bad":
        raise typer.Exit(STOPPED_EARLY)


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
    show(f"parameters   {', '.join(spec.parameters)}")
    if spec.intervals.of:
        show(f"expressions  {', '.join(f'{key} = {text}' for key, text in spec.intervals.of.items())}")
    show(f"intervals    {100 * spec.intervals.level:g} %, {spec.intervals.method}")
    if spec.candidates:
        show(f"candidates   {', '.join(spec.candidates)}")
