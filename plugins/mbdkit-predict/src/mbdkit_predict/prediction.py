"""`predict`: finds the motion that minimizes the objective of a spec, and returns or writes it as an archive."""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive.run import Run
from mbdkit.runs.run_seams import computed_run, repeated_run
from mbdkit.spec.reading import Document
from mbdkit_predict.export import require_casadi
from mbdkit_predict.predict_loading import PredictSource, load_predict_spec
from mbdkit_predict.predict_spec import PredictSpec


def predict(
    source: PredictSource, *, archive: str | Path | None = None, overwrite: bool = False, **sections: object
) -> Run:
    """Find the motion and the controls that minimize the objective of a spec.

    The motion satisfies the equations of motion and all conditions at the collocation points. Intervals are halved
    until the objective changes by less than the tolerance.

    Parameters
    ----------
    source
        A file, the name of a packaged example, a mapping, or a PredictSpec.
    archive
        File to which the result is written; by default, the result stays in memory.
    overwrite
        Whether an existing archive may be replaced.
    **sections
        Sections of the spec, such as ``duration=2.0``; they replace those of `source`.

    Returns
    -------
    Run
        The motion, with ``run.kind == "predicted"`` and a row for the start and for each collocation point;
        `Run.objective`, `Run.objective_error`, `Run.mesh`, `Run.controls` and `Run.parameters`. If no optimum was
        found, the status is ``failed``, and the motion is the last iterate.

    Raises
    ------
    MbdkitError
        If CasADi is not installed.
    SpecError
        If the spec is wrong, or its mechanism cannot be exported.
    RunError
        If the last iterate is no motion.
    """
    return compute(load_predict_spec(source, (), **sections), path=archive, overwrite=overwrite)


def compute(
    spec: PredictSpec, *, path: str | Path | None = None, overwrite: bool = False, progress: object = None
) -> Run:
    """Compute a validated spec; see `predict`. The progress of optimization is not known."""
    require_casadi("predictions need")
    from mbdkit_predict.predicted_run import predicted

    return predicted(spec, path=path, overwrite=overwrite)


computed_run(compute)


@repeated_run
def repeated(before: Run, archive: Path, output: Path | None, *, overwrite: bool, progress: object) -> Run:
    """Compute the prediction of an archive again."""
    document = Document(dict(before.spec), folder=archive.parent)
    return compute(load_predict_spec(document), path=output, overwrite=overwrite)
