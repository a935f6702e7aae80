"""The functions `design` and `load_design`, which compute designs and open their folders."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.terminal import silence
from mbdkit.base.text import counted
from mbdkit_design.computing import Computer
from mbdkit_design.design import Design, solve, with_comparisons
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.known_points import KnownPoints, Notify, PointFile
from mbdkit_design.search import check_installed
from mbdkit_design.stages import Stages
from mbdkit_design.store import DesignFolder
from mbdkit_studies import Engine

WORKER = "mbdkit_design.job_worker"  #: Module that carries out the tasks of worker processes.

#: Function that is called with the number of runs so far, and the number of failed runs.
Progress = Callable[[int, int], None]


def design(
    source: object,
    *,
    out: str | Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
    notify: Notify | None = None,
    assignments: Sequence[str] = (),
    overwrite: bool = False,
    optimum_only: bool = False,
    **sections: object,
) -> Design:
    """Choose numbers of a spec so that measures of its runs become small.

    Parameters
    ----------
    source
        A design spec: a file, the name of a packaged design, a mapping, or a DesignSpec.
    out
        Folder for the result, for archives of the start and the best point, and for all points that are evaluated. If a
        call was interrupted, the same call continues from these points, with the same result as without the
        interruption; the result of a completed design is read. By default nothing is written.
    workers, executor, progress, notify
        See `mbdkit.study`. `progress` is called with the number of runs so far and the number of failed runs, `notify`
        with a sentence when a stage begins or a search ends.
    assignments
        Assignments to keys of the design spec, such as ``"optimizer.starts=8"``.
    overwrite
        Whether to remove the files of an earlier design in the folder first; other files remain.
    optimum_only
        Whether to omit the comparisons with other settings (`compare`). A later call with the same folder adds them.
    **sections
        Sections of the spec, such as ``optimizer={"name": "slsqp", "starts": 8}``; they replace those of `source`.

    Returns
    -------
    Design
        The result: ``.best``, ``.front`` and ``.trust``.

    Raises
    ------
    SpecError
        If an argument or the spec is not valid, the optimiser is not installed, or the folder has another design.
        Nothing is written in this case.
    RunError
        If a run fails at the start of the variables, or a worker fails for a reason other than a failed run.
    ResourceError
        If the folder cannot be written to or is in use, or a resource is not available. Points evaluated so far remain.

    Examples
    --------
    The stiffness that minimises the oscillation of a mass:

    >>> import mbdkit
    >>> m = mbdkit.Mechanism()
    >>> mass = m.body("mass", mass=1.0, inertia=1.0)
    >>> m.revolute("pin", m.ground, mass, at=(0, 0))
    >>> m.torsion_spring("spring", m.ground, mass, stiffness=1.0)
    >>> m.torque("load", mass, value=1.0)
    >>> base = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}}
    >>> stiffness = {"model.forces.spring.stiffness": {"bounds": [1.0, 4.0]}}
    >>> spec = {"mbdkit_design": 1, "base": base, "variables": stiffness, "minimize": "rms(mass.angle)"}
    >>> round(mbdkit.design(spec).best.variables["model.forces.spring.stiffness"], 6)
    4.0
    """
    spec = load_design_spec(source, assignments, **sections)
    check_installed(spec)
    engine = Engine.of(workers, executor, WORKER)
    folder = None if out is None else DesignFolder(Path(out))

    def count(done: int, failed: int, stage: str) -> None:
        if progress is not None:
            progress(done, failed)

    stages = Stages(spec, notify or silence, count, optimum_only=optimum_only)
    if folder is not None:
        return solved_in(folder, spec, engine, stages, overwrite=overwrite)
    with evaluating(spec, None, engine, stages) as evaluator:
        return _compared(evaluator, solve(evaluator, stages), stages)


def solved_in(
    folder: DesignFolder, spec: DesignSpec, engine: Engine, stages: Stages, *, overwrite: bool = False
) -> Design:
    """Carry out a design in its folder, or read its result there.

    The result is written as soon as the best point and its errors are known, and again with the comparisons.
    """
    check_installed(spec)
    folder.check(spec, overwrite=overwrite)
    Evaluator(spec)  # checks the expressions before anything is written
    if overwrite:
        folder.clear()
    folder.prepare(spec)
    with folder.locked():
        result = folder.read() if folder.result.is_file() else None
        if result is not None and (stages.optimum_only or len(result.compared) == len(spec.compare)):
            return result
        with evaluating(spec, folder, engine, stages) as evaluator:
            if result is None:
                result = solve(evaluator, stages)
                folder.write(result)
            result = _compared(evaluator, result, stages)
            folder.write_result(result)
    return result


def _compared(evaluator: Evaluator, result: Design, stages: Stages) -> Design:
    """Return a design with its comparisons, unless they are omitted."""
    if stages.optimum_only or not result.spec.compare:
        return result
    return with_comparisons(Evaluator(evaluator.spec, evaluator.source), result, stages)


def load_design(folder: str | Path) -> Design:
    """Open the folder of a design without computing anything.

    Parameters
    ----------
    folder
        Folder that was written by `design` or ``mbdkit design``.

    Raises
    ------
    SpecError
        If the folder contains no design with a valid result.
    """
    return DesignFolder(Path(folder)).read()


@contextmanager
def evaluating(spec: DesignSpec, folder: DesignFolder | None, engine: Engine, stages: Stages) -> Iterator[Evaluator]:
    """Yield the evaluator of a design, which reads and stores points in the folder, if there is one.

    The folder must exist, and the caller should lock it. If Ctrl-C ends the block, a message says how to continue.
    """
    notify = stages.notify
    place = Path("points.jsonl") if folder is None else folder.points
    # searches need linear algebra, too
    with one_thread_of_linear_algebra(), Computer(spec, engine, notify, place) as computer:
        names = [measure.name for measure in spec.defined_measures()]
        known = KnownPoints(computer, None if folder is None else PointFile(place, names, notify), stages.count)
        try:
            yield Evaluator(spec, known)
        except KeyboardInterrupt:
            if folder is not None:
                notify(f"{counted(known.count, 'run')} are kept in {folder.points}; the same call continues from there")
            raise
