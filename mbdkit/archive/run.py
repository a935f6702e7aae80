"""`Run`: access to a run archive, in a file or in memory. Arrays are read on demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import h5py

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.measured_values import Integrals, MeasuredValues
from mbdkit.archive.part_file import write_image
from mbdkit.archive.recorded_data import RecordedData
from mbdkit.archive.result_table import ResultTable
from mbdkit.archive.run_contents import ArchiveContents, RunContents
from mbdkit.archive.run_views import Animation, RunPlots, StatedErrors
from mbdkit.archive.stored_mechanism import StoredMechanism
from mbdkit.base import higher_layers
from mbdkit.base.errors import ArchiveError, RunError, SpecError
from mbdkit.base.files_read import FileRead
from mbdkit.base.html_view import HtmlView
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.accessors import computed
from mbdkit.spec import RunSpec
from mbdkit.spec.spec_kinds import kind_of, refused
from mbdkit.trust.criteria import LEVELS, Level

if TYPE_CHECKING:
    import pandas
    import xarray

    from mbdkit.registry.feature_items import SpecKind


class Run(RecordedData, HtmlView):
    """A run: its spec, status and recorded data, in SI units and radians.

    Arrays are read-only and are read from the archive on first use. Close the run, or use it in a `with` block, to
    release the file. Closing a run in memory discards its data.

    Parameters
    ----------
    contents
        The data of the run, or an HDF5 file in memory that holds them.
    """

    def __init__(self, contents: RunContents | h5py.File):
        super().__init__(contents)
        #: The exception of a plugin that ended the run, if the run was executed in this process; `check` chains it to
        #: the error that it raises.
        self.cause: BaseException | None = self._contents.cause

    @classmethod
    def open(cls, path: Path) -> Run:
        """Open the archive at `path`; see `mbdkit.load`."""
        return cls(ArchiveContents.open(path))

    @property
    def status(self) -> str:
        """``complete``, ``failed``, ``interrupted``, or ``running`` if the run crashed."""
        return self._header.attributes["status"]

    @property
    def status_reason(self) -> str:
        """Code and sentence that say why the run is not complete, or which event ended it; otherwise empty."""
        return self._header.attributes["status_reason"]

    @property
    def verdict(self) -> Level:
        """The verdict on the results: ``good``, ``unknown``, ``doubtful`` or ``bad``.

        ``good`` needs an estimate of the error. ``unknown`` means that nothing suspicious was seen, but that the error
        is not known. Runs that crashed are ``unknown`` as well, see `is_judged`.
        """
        return next((level for level in LEVELS if level == self._header.verdict), "unknown")

    @property
    def is_judged(self) -> bool:
        """Whether the archive holds a verdict; archives of crashed runs do not."""
        return bool(self._header.verdict)

    @property
    def verdict_reasons(self) -> list[str]:
        """Reasons for the verdict, as sentences with their limits, the worst first; empty if there are none."""
        return list(self._header.verdict_reasons)

    @property
    def warnings(self) -> list[str]:
        """Warnings about the spec and the run, as sentences."""
        return list(self._header.warnings)

    @property
    def run_id(self) -> str:
        """Unique name of the run."""
        return self._header.attributes["run_id"]

    @property
    def created_utc(self) -> str:
        """Time at which the archive was created, ISO 8601, UTC."""
        return self._header.attributes["created_utc"]

    @property
    def spec_sha256(self) -> str:
        """SHA-256 of `spec_json`."""
        return self._header.attributes["spec_sha256"]

    @property
    def data_sha256(self) -> str:
        """SHA-256 of all arrays except timings and estimated errors; empty if the run crashed."""
        return self._header.attributes["data_sha256"]

    @cached_property
    def run_spec(self) -> RunSpec:
        """The spec of the run as a validated object.

        Raises
        ------
        SpecError
            If a plugin that it names is not installed, or if it is a spec of inverse dynamics.
        """
        if self._contents.run_spec is not None:
            return self._contents.run_spec
        model = kind_of(self.spec).model
        spec_class = RunSpec if model is None else cast("type[RunSpec]", model())
        if not issubclass(spec_class, RunSpec):  # kinds of plugins may derive their specs from it
            raise refused(self.spec, "run") or SpecError("this is not a spec of a run")
        spec = spec_class(**self.spec)
        if self._mechanism.mechanism is not None and not self._mechanism.not_drawn:
            spec.adopt(self._mechanism.mechanism, self.files or ())
        return spec

    @cached_property
    def _mechanism(self) -> StoredMechanism:
        return self._contents.mechanism()

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism that was run. Archives hold it, so that neither its model nor a file is needed.

        Raises
        ------
        ArchiveError
            If this version of mbdkit does not know all of its bodies.
        """
        if self._mechanism.mechanism is None:
            raise ArchiveError(self._mechanism.not_drawn, file=self.path)
        return self._mechanism.mechanism

    @property
    def not_drawn(self) -> str:
        """Sentence on what drawings of the run lack, and why; empty if they are complete."""
        return self._mechanism.not_drawn

    @property
    def files(self) -> tuple[FileRead, ...]:
        """Name, size and SHA-256 of every file that was read for the run."""
        return tuple(self._contents.files)

    @cached_property
    def stats(self) -> Mapping[str, int | float]:
        """Counters (steps, evaluations, factorizations, ...) and times in s (setup_s, wall_s, finish_s, cpu_s)."""
        return self._header.stats

    @cached_property
    def provenance(self) -> Mapping[str, str | int | float]:
        """Versions, platform and command."""
        return self._contents.provenance

    @property
    def kind(self) -> str:
        """``forward`` for the integration of a motion, ``inverse`` for inverse dynamics, or a kind of a plugin."""
        return self.spec_kind.run_kind

    @property
    def spec_kind(self) -> SpecKind:
        """The kind of the spec, which says how such runs are computed."""
        return kind_of(self.spec)

    @property
    def errors(self) -> StatedErrors:
        """What is known of the errors of the run, and how it is stated."""
        of_kind = self.spec_kind.errors
        stated = higher_layers.run_errors if of_kind is None else of_kind()
        return cast("Callable[[Run], StatedErrors]", stated)(self)

    @cached_property
    def integrals(self) -> Integrals:
        """Integrals over time and extrema that the measures of the run need, by expression, in SI units.

        Those of checked runs also contain the largest loads that recorded rows may miss.

        See `mbdkit.runs.integrals`.
        """
        return self._contents.integrals

    @cached_property
    def measures(self) -> MeasuredValues:
        """Values of the measures in the spec of the run by name, each in its unit; nan where one is undefined.

        Examples
        --------
        >>> import mbdkit
        >>> pull = {"value": "max(abs(joints.J1.force))", "unit": "kN"}
        >>> run = mbdkit.run("double-pendulum", time={"end": 0.1, "step": 0.01}, measures={"pull": pull})
        >>> 0.0 < run.measures["pull"] < 1.0
        True
        >>> run.measures.units["pull"]
        'kN'
        """
        return self._contents.measures

    @property
    def measure_errors(self) -> Mapping[str, float]:
        """Estimated errors of the measures by name, each in its unit; nan where unknown, as in runs without check.

        In inverse dynamics, they are bounds that hold with a probability of 95 %, given the noise of the data and the
        uncertainties of the cutoff and of stated properties.
        """
        return self.measures.errors

    @cached_property
    def gradients(self) -> Mapping[str, Mapping[str, Any]]:
        """Derivatives of measures with respect to the parameters that the spec lists under `gradients`.

        The keys are the names of the measures. Each entry has its ``unit``, the ``derivatives`` and their estimated
        ``errors`` by name of the parameter, and a ``check`` by differences of runs. If there are no derivatives, it has
        a ``reason`` instead. The mapping is empty if the spec has no `gradients`.
        """
        return self._contents.gradients

    @property
    def redundancy(self) -> str:
        """Description of the redundant constraints, such as ``1 redundant row: joint D``; empty if there are none.

        With redundant constraints, reactions are not unique. Of all reactions that produce the same motion, the
        recorded ones minimize the sum over joints of ``|force|^2 + (torque / length)^2``. The length [m] is the
        attribute ``characteristic_length`` of the group ``joints``.
        """
        return self._header.redundancy

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """Estimated errors of the recorded rows; None if the run was not checked (``check: true``), or if a study does
        not keep the errors.
        """
        return self._contents.accuracy

    @property
    def tables(self) -> Mapping[str, ResultTable]:
        """Tables of further results by name, such as residuals or a covariance, which kinds of specs may store."""
        return self._contents.tables

    @property
    def file(self) -> h5py.File:
        """The run as an open HDF5 file, all of whose arrays have been verified; it is created in memory if the run has
        no file.

        Raises
        ------
        ArchiveError
            If an array is damaged.
        MbdkitError
            If the run is closed, or a study does not keep all of its arrays.
        """
        self._contents.verify()
        return self._contents.file

    def check(self) -> Run:
        """Return the run if it is complete.

        Raises
        ------
        RunError
            If the run failed, was interrupted or crashed; the message gives the reason.

        Examples
        --------
        >>> import mbdkit
        >>> mbdkit.run("pendulum", time={"end": 1.0, "step": 0.01}).check().status
        'complete'
        >>> mbdkit.run("pendulum", time={"end": 1.0, "step": 0.01}, limits={"max_steps": 5}).check()
        Traceback (most recent call last):
            ...
        mbdkit.base.errors.RunError: max-steps: ...
        """
        if self.status == "complete":
            return self
        if self.status == "running":
            raise RunError("the run did not end: it crashed or is still running")
        reason = self.status_reason.removeprefix("interrupted: ")
        why = f": {reason}" if reason else ""
        raise RunError(f"the run {'failed' if self.status == 'failed' else 'was interrupted'}{why}") from self.cause

    @property
    def plot(self) -> RunPlots:
        """Plots of the run on Matplotlib axes, such as ``run.plot.reactions(joints=["knee"])``."""
        return RunPlots(computed(self, "plot", "mbdkit-report"))

    def animate(self) -> Animation:
        """Return an animation, which notebooks show with its controls.

        ``run.animate().save("motion.gif")`` writes it to a file; see `mbdkit_report.notebook.animation.Animation.save`.

        Raises
        ------
        SpecError
            If the run has no rows.
        """
        return cast(Animation, computed(self, "animate", "mbdkit-report"))

    def summary(self) -> str:
        """Return a summary of the run as a few lines of plain text.

        Examples
        --------
        >>> import mbdkit
        >>> print(mbdkit.run("pendulum", time={"end": 1.0, "step": 0.01}).summary().splitlines()[0])
        verdict       unknown: nothing suspicious seen; error not estimated
        """
        return higher_layers.run_summary(self)

    def to_xarray(self) -> xarray.DataTree:
        """Load the archive as an xarray DataTree, equal to the result of `xarray.open_datatree` for the file.

        Raises
        ------
        MbdkitError
            If xarray is not installed.

        Examples
        --------
        >>> import mbdkit
        >>> tree = mbdkit.run("double-pendulum", time={"end": 1.0, "step": 0.01}).to_xarray()
        >>> tree["joints"]["reaction_force"].dims
        ('time', 'joint', 'axis')
        """
        with reading("its contents", self.path):
            return cast("xarray.DataTree", higher_layers.run_datatree(self.file))

    def to_frame(self, group: str) -> pandas.DataFrame:
        """Return a group of the archive as a table with one row for each time in the group.

        Columns are named as quantities in expressions of events, such as ``knee.force_x`` [N], ``foot.vy`` [m/s] or
        ``kinetic`` [J]. The index is the time [s]; ``frame.attrs["units"]`` maps the names to units.

        Parameters
        ----------
        group
            A group of arrays over time, such as ``trajectory``, ``joints``, ``forces``, ``beams``, ``energy``,
            ``steps``, ``events`` or ``accuracy``.

        Raises
        ------
        UnknownNameError
            If there is no such group.
        MbdkitError
            If pandas is not installed, the run did not record the group, or its mechanism has no such elements.
        """
        return cast("pandas.DataFrame", higher_layers.run_frame(self, group))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a copy of the archive to a file, byte for byte.

        Parameters
        ----------
        overwrite
            Whether an existing file may be replaced.

        Raises
        ------
        SpecError
            If no archive may be written at `path`.
        ResourceError
            If the file cannot be written, as on a full disk.
        MbdkitError
            If the run is closed, or a study does not keep all of its arrays.

        Examples
        --------
        >>> import mbdkit
        >>> run = mbdkit.run("pendulum", time={"end": 1.0, "step": 0.01})
        >>> run.save("kept.h5")
        >>> mbdkit.load("kept.h5").data_sha256 == run.data_sha256
        True
        """
        write_image(Path(path), self.file.id.get_file_image(), overwrite=overwrite)

    def close(self) -> None:
        """Close the archive; arrays read before remain valid."""
        self._contents.close()

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[object, ...]:
        if self.path is None:
            raise TypeError("a run in memory cannot be pickled; save it to a file and load that")
        return Run.open, (self.path.resolve(),)

    def __repr__(self) -> str:
        where = "in memory" if self.path is None else str(self.path)
        bodies = len(self._names["trajectory/body"])
        return f"<Run {self.run_id} {self.status}, verdict {self.verdict}, {bodies} bodies, {where}>"
