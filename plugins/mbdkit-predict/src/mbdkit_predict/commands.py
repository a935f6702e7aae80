"""The command `predict`."""

from __future__ import annotations

from typing import Annotated

import typer

from mbdkit.base.terminal import show
from mbdkit.cli.common_options import SpecCommand
from mbdkit.cli.outcome import tell
from mbdkit.spec.spec_kinds import spec_check


@spec_check
def validate_predict(source: object, name: str, assignments: list[str]) -> None:
    """Check the spec of a prediction and all its expressions, and print what would be computed."""
    from mbdkit_predict.predict_loading import compared_spec, load_predict_spec
    from mbdkit_predict.prediction import require_casadi

    spec = load_predict_spec(source, assignments)
    require_casadi("the check of a prediction needs")
    from mbdkit_predict.predicted_run import transcribed

    transcribed(spec)
    if spec.compare:
        transcribed(compared_spec(spec))
    show(f"{name}: this is valid as a spec of a prediction")
    show(f"model        {spec.model_item.id}: {spec.mechanism().description()}")
    show(f"controls     {', '.join(spec.controls)}")
    if spec.optimized:
        show(f"parameters   {', '.join(spec.optimized)}")
    show("not checked  whether a motion satisfies all conditions")


@SpecCommand.of("an example such as block", key="motion.smooth.cutoff=6")
def predict(
    command: SpecCommand,
    *,
    report: Annotated[bool, typer.Option("--report", help="Also write a report, as `mbdkit report` does.")] = False,
) -> None:
    """Find the motion and the controls that minimize an objective.

    The optimal control problem is solved by direct collocation on finer and finer meshes,
    until the error of the objective is below the tolerance of the spec. Ctrl-C keeps the
    best motion so far. See `mbdkit guide predict`.
    """
    from mbdkit_predict.predict_loading import load_predict_spec

    checked = command.load(load_predict_spec)
    from mbdkit_predict.prediction import compute

    run = compute(checked, path=command.path, overwrite=command.overwrite)
    if report:
        from mbdkit_report import report as write

        target = write(command.path, overwrite=command.overwrite)
        if not (command.printing.quiet or command.printing.as_json):
            show(target)
    tell(run, command.printing)
