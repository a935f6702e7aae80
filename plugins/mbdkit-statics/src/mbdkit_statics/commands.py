"""Commands that analyse a mechanism without integrating: `equilibrium`, `modes`, `kinematics`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import typer

from mbdkit.base.files import check_output, check_suffix, replacing
from mbdkit.base.terminal import show, show_json
from mbdkit.base.text import listed
from mbdkit.cli.common_options import AsJson, Debug, Overwrite, Set, SpecName, output_to

if TYPE_CHECKING:
    from mbdkit_statics.prepared_mechanism import PreparedMechanism

Result = TypeVar("Result")


def equilibrium(
    spec: SpecName,
    assignments: Set = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", metavar="FILE.yaml", help="Write the spec with the equilibrium as its start."),
    ] = None,
    output: Annotated[
        Path | None, output_to("FILE.png", "Draw the equilibrium, with internal forces of beams, to PNG, SVG or PDF.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Find a static equilibrium, its stability and its forces.

    The search begins at the start position and moves in the direction of the
    forces. Drivers and loads are evaluated at the start time; velocities are
    ignored. Gravity is (0, -9.81) m/s^2 unless `model.gravity` is given.
    """
    from mbdkit_statics.equilibrium import equilibrium_of, spec_at
    from mbdkit_statics.mechanics_summary import equilibrium_data, equilibrium_text
    from mbdkit_statics.prepared_mechanism import PreparedMechanism

    if write is not None:
        check_output(write, overwrite=overwrite, source=spec)
    if output is not None:
        _check_picture(output, spec, overwrite=overwrite)
    prepared = PreparedMechanism.of(spec, assignments or ())
    result = equilibrium_of(prepared)
    notes = []
    if write is not None:
        from mbdkit.spec.yaml_reader import write_yaml

        written = spec_at(prepared, result)
        with replacing(write, overwrite=overwrite, source=spec) as temporary:
            temporary.write_text(write_yaml(written), encoding="utf-8", newline="\n")
        if left_out := [name for name in prepared.spec.parameters if name not in written["parameters"]]:
            notes.append(f"{write.name} has numbers in place of the parameters {listed(left_out, 'and')}")
    if output is not None:
        from mbdkit_report import save
        from mbdkit_statics.views import equilibrium_figure

        mechanism = prepared.spec.mechanism()
        save(equilibrium_figure(result, mechanism, f"Equilibrium: {prepared.spec.title or mechanism.name}"), output)
    _show(result, equilibrium_text, equilibrium_data, prepared, as_json, result.warnings, notes)


def modes(
    spec: SpecName,
    assignments: Set = None,
    at: Annotated[
        Literal["equilibrium", "start"],
        typer.Option("--at", help="Linearise at the equilibrium near the start, or at the start."),
    ] = "equilibrium",
    count: Annotated[
        int | None, typer.Option("--count", min=1, metavar="N", help="Compute only the N slowest modes.")
    ] = None,
    output: Annotated[Path | None, output_to("FILE.png", "Draw the modes to a PNG, SVG or PDF file.")] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Find natural frequencies, damping ratios and mode shapes.

    Coordinates that drivers prescribe do not vibrate.
    """
    from mbdkit_statics.mechanics_summary import modes_data, modes_text
    from mbdkit_statics.modes import modes_of
    from mbdkit_statics.prepared_mechanism import PreparedMechanism

    if output is not None:
        _check_picture(output, spec, overwrite=overwrite)
    prepared = PreparedMechanism.of(spec, assignments or ())
    result = modes_of(prepared, at, count)
    if output is not None:
        from mbdkit_report import save
        from mbdkit_statics.views import modes_figure

        mechanism = prepared.spec.mechanism()
        save(modes_figure(result, mechanism, f"Modes: {prepared.spec.title or mechanism.name}"), output)
    _show(result, modes_text, modes_data, prepared, as_json, result.warnings)


def kinematics(
    spec: SpecName,
    assignments: Set = None,
    output: Annotated[Path | None, output_to("FILE.csv", "Write the motion of all bodies to a CSV file.")] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Compute the motion that drivers prescribe, without forces.

    Drivers must prescribe all degrees of freedom. The motion is computed at the times of
    the steps in the spec.
    """
    from mbdkit_statics.kinematics import kinematics_of
    from mbdkit_statics.mechanics_summary import kinematics_data, kinematics_text
    from mbdkit_statics.prepared_mechanism import PreparedMechanism

    if output is not None:
        check_output(output, overwrite=overwrite, source=spec)
    prepared = PreparedMechanism.of(spec, assignments or ())
    result = kinematics_of(prepared)
    if output is not None:
        with replacing(output, overwrite=overwrite, source=spec) as temporary:
            result.write_csv(temporary)
    _show(result, kinematics_text, kinematics_data, prepared, as_json)


def _show(
    result: Result, text: Callable[[Result], str], data: Callable[[Result], dict[str, object]],
    prepared: PreparedMechanism, as_json: bool, warnings: Sequence[str] = (), notes: Sequence[str] = (),
) -> None:  # fmt: skip
    """Show a result as text or as JSON, with the warnings of the spec and of the result, and further notes."""
    from mbdkit.runs.findings import findings

    warnings = [*(str(finding) for finding in findings("spec", prepared.spec, (), kind="mechanism")), *warnings]
    if as_json:
        show_json(data(result) | {"warnings": [*warnings, *notes]})
        return
    lines = [*(f"warning      {warning}" for warning in warnings), *(f"note         {note}" for note in notes)]
    show("\n".join([text(result), *lines]))


def _check_picture(output: Path, spec: str, *, overwrite: bool) -> None:
    from mbdkit_report import FORMATS

    check_output(check_suffix(output, FORMATS, "a plot"), overwrite=overwrite, source=spec)
