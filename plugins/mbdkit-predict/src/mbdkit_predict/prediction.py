"""`predict` finds the motion that minimizes the objective of a spec; `to_casadi` exports a mechanism."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import mechanism_attribute
from mbdkit.runs.run_seams import computed_run, repeated_run
from mbdkit.spec.reading import Document
from mbdkit_predict.predict_loading import PredictSource, load_predict_spec
from mbdkit_predict.predict_spec import PredictSpec

if TYPE_CHECKING:
    from mbdkit_predict.casadi_system import CasadiSystem


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


@mechanism_attribute
def exported(mechanism: Mechanism) -> Callable[..., CasadiSystem]:
    """Return the method `to_casadi` of a mechanism."""

    def to_casadi(*, controls: Sequence[str] = (), parameters: Sequence[str] = (), t0: float = 0.0) -> CasadiSystem:
        """Return equations of motion, constraints and quantities as functions of CasADi, for optimal control.

        Parameters
        ----------
        controls
            Key paths of the values that become controls: of a load (``forces.motor.value``, and
            ``forces.push.value[0]`` of a component), the excitation of a muscle (``muscles.soleus.excitation``), or the
            rate of a first-order state (``states.current.rate``).
        parameters
            Key paths of numbers that become parameters, such as ``forces.spring.stiffness``, ``bodies.rod.mass`` and
            ``joints.A.points[1][0]``.
        t0
            Time [s] at which the initial state is made consistent.

        Raises
        ------
        MbdkitError
            If CasADi is not installed.
        SpecError
            For the first error of the mechanism, for an element that cannot be exported, or for a key that is wrong.
        """
        require_casadi("the export to CasADi needs")
        from mbdkit_predict.casadi_system import CasadiSystem
        from mbdkit_predict.chosen_numbers import ChosenNumbers

        return CasadiSystem(ChosenNumbers(mechanism, controls, parameters), t0)

    return to_casadi


def require_casadi(what: str) -> None:
    """Raise MbdkitError if CasADi is not installed; `what` are the first words of the message."""
    try:
        import casadi  # noqa: F401
    except ImportError:
        raise MbdkitError(f"{what} the package casadi: install it with `pip install mbdkit[predict]`") from None
