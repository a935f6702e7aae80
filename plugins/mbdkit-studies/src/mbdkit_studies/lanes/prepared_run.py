"""Repeated runs of one spec with different numbers."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Never, Unpack

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError
from mbdkit.base.file_locks import UseLock, one_thread_at_a_time
from mbdkit.base.plain_data import Path, path_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import CompiledMechanism, with_ground
from mbdkit.engine.consistent_start import Starts
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.given_start import GivenStart
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.simulation import simulate
from mbdkit.runs.varied_numbers import VariedNumbers
from mbdkit.runs.varied_runs import VariedRuns, run_in_lane
from mbdkit.spec.loading import RunSource, Sections, load_spec
from mbdkit.spec.reading import variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_report import keys_ending_in

if TYPE_CHECKING:
    from mbdkit_studies.lanes.run_batch import Measures, RunBatch
    from mbdkit_studies.spec.study_spec import Storing

#: Runs are computed by the vectorized loop until one takes more evaluations times bodies than this.
#:
#: With a single run in the vectorized loop, the steps take up to twice as long as those of the ordinary loop, but the
#: preparation takes 1 to 2 ms less.
LONG = 15_000

MOST_NAMES = 32  #: Largest number of sets of names whose formulas are kept.


Numbers = Mapping[str, float | str]


class PreparedRun:
    """A spec that is run repeatedly with different numbers.

    Everything that does not depend on the numbers is prepared once: the validation of other sections, the compiled
    mechanism, and the loop over the steps.

    Parameters
    ----------
    spec
        The validated spec.

    Attributes
    ----------
    spec
        The spec with its original numbers.
    in_use
        Held by the thread that uses the prepared run.
    """

    def __init__(self, spec: RunSpec):
        self.spec = spec
        self._text = spec.canonical_json()
        self._varied = VariedSpecs(self._text)
        self._paths: dict[tuple[str, ...], tuple[Path, ...]] = {}  # by names
        self._lanes = LaneRuns(Starts(), ())
        self._varied_runs: dict[tuple[str, ...], VariedRuns | None] = {}  # None for names that were varied once
        self._is_long = False
        self._given: tuple[RunSpec, GivenStart] | None = None
        self.in_use = UseLock("another thread is using this prepared run; give each thread its own `mbdkit.prepare`")

    def __reduce_ex__(self, protocol: object) -> Never:
        raise TypeError(
            "a prepared run cannot be copied or pickled; prepare another one by `mbdkit.prepare(prepared.spec)`"
        )

    @one_thread_at_a_time
    def spec_with(self, parameters: Numbers | None = None, initial: Numbers | None = None) -> RunSpec:
        """Return the spec with other numbers; see `run`."""
        spec = self._varied.spec([(self._path_of(name), value) for name, value in (parameters or {}).items()])
        return spec_started_at(spec, initial, self._lanes.starts) if initial else spec

    @one_thread_at_a_time
    def start_with(
        self, parameters: Numbers | None = None, initial: Numbers | None = None
    ) -> tuple[CompiledMechanism, np.ndarray, np.ndarray]:
        """Return the compiled mechanism at its start with other numbers, ten times as fast as `spec_with`.

        See `run` for the arguments and errors; this function does not refuse joints that would move with the start.

        Returns
        -------
        mechanism : CompiledMechanism
            The mechanism.
        q, v : (3 (B + 1),) arrays
            Positions and velocities, ground last.
        """
        spec = self.spec_with(parameters) if parameters else self.spec
        if self._given is None or self._given[0] is not spec:
            self._given = spec, GivenStart(spec.mechanism(), spec, self._lanes.starts)
        given = self._given[1]
        if not initial:
            return given.start.mechanism, given.start.q0, given.start.v0
        q, v = given.state(initial)
        return given.start.mechanism, with_ground(q), with_ground(v)

    @one_thread_at_a_time
    def run(self, parameters: Numbers | None = None, initial: Numbers | None = None) -> Run:
        """Run the spec with other numbers; the results are bitwise equal to those of `mbdkit.run` for `spec_with`.

        Ctrl-C raises KeyboardInterrupt. Warnings are not printed; `Run.warnings` contains them.

        Parameters
        ----------
        parameters
            Values by name of a parameter, or by key, such as ``model.springs.support.stiffness`` or ``model.angles.0``:
            numbers, or texts with a unit such as ``"2 N/mm"``.
        initial
            Initial values of kinematic quantities, such as ``crank.angle``, ``knee.angle`` (of a joint), ``foot.vx`` or
            ``crank.angular_velocity``. Of all states that satisfy the joints and these values, the run starts from the
            one nearest to the start of `spec` in the mass metric. The spec of the run contains the mechanism at this
            start.

        Returns
        -------
        Run
            The results, in memory.

        Raises
        ------
        SpecError
            If the spec has no such parameter, key or quantity, or is not valid with these values, or if the joints
            cannot be assembled.
        PluginError
            If a plugin fails.
        """
        is_short = not (self._is_long or self.spec.gradients)
        if is_short and not initial and (run := self._by_formulas(parameters or {})) is not None:
            return run
        spec = self.spec_with(parameters, initial)
        if is_short and (found := run_in_lane(self._lanes, spec)) is not None:
            run, work = found
            self._is_long = work > LONG
            return run
        made = simulate(spec, starts=self._lanes.starts)
        if made.status == "interrupted":
            raise KeyboardInterrupt
        return made

    @one_thread_at_a_time
    def run_many(
        self,
        parameters: Mapping[str, Sequence[float] | np.ndarray],
        measures: Measures = "all",
        derivatives: str | Sequence[str] = (),
        store: Storing = "hashes",
        *,
        out: str | FilePath | None = None,
        workers: int = 1,
    ) -> RunBatch:
        """Run the spec with N values of some numbers; the results are bitwise equal to those of `run`.

        Parameters
        ----------
        parameters
            (N,) values by name of a parameter, or by key; see `run`. Run i has the values at index i.
        measures
            Expressions such as ``"max(abs(joints.B.force))"``, and names of measures of the spec or of studies: one,
            several, or a mapping of names to them. By default, all measures that studies compute.
        derivatives
            Names of parameters, or keys, with respect to which the measures are differentiated; see `mbdkit.gradient`.
            Their values need not be among `parameters`.
        store, out, workers
            What is stored of each run, the folder for it, and the number of processes; see `mbdkit.ensemble`.

        Returns
        -------
        RunBatch
            Measures, verdicts, hashes and derivatives; `RunBatch.remake` repeats a run with all its arrays. Runs that
            fail, or whose numbers are not valid, are part of it.

        Raises
        ------
        SpecError
            If the spec has no such parameter or key, arrays differ in length, or a measure is not valid or has no
            derivatives.
        ResourceError
            If the folder cannot be written to.

        Examples
        --------
        >>> import mbdkit
        >>> prepared = mbdkit.prepare("double-pendulum", time={"end": 1.0, "step": 0.01})
        >>> masses = {"model.masses.1": [1.0, 2.0, 3.0]}
        >>> runs = prepared.run_many(masses, "final(energy.kinetic)", derivatives=["model.masses.1"])
        >>> len(runs), runs.statuses[0]
        (3, 'complete')
        >>> runs.derivatives["final(energy.kinetic)"].shape
        (3, 1)
        >>> runs.remake(2).data_sha256 == runs.hashes[2]
        True
        """
        from mbdkit_studies.lanes.run_batch import batch  # single runs, and simulations, need no studies

        columns = {path_text(self._path_of(name)): np.asarray(values) for name, values in parameters.items()}
        if len(columns) < len(parameters):
            raise SpecError("two names stand for one key", key="parameters")
        by = [derivatives] if isinstance(derivatives, str) else [*derivatives]
        return batch(self.spec, columns, measures, by, store, out, workers)

    def _by_formulas(self, parameters: Numbers) -> Run | None:
        """Return the run with these numbers if there are formulas for them, otherwise None."""
        paths = self._paths.get(names := tuple(parameters))
        if paths is None:
            paths = self._paths[names] = tuple([self._path_of(name) for name in names])
        if not all(type(x) is float or (type(x) is int and abs(x) <= sys.float_info.max) for x in parameters.values()):
            return None
        if names not in self._varied_runs:
            self._varied_runs[names] = None
            return None
        numbers = VariedNumbers(paths, partial(_varied, self._text, paths))
        runs = self._varied_runs.pop(names) or VariedRuns(self._lanes, numbers)
        self._varied_runs[names] = runs  # at the end; those used least recently are discarded first
        if len(self._varied_runs) > MOST_NAMES:
            self._varied_runs.pop(next(iter(self._varied_runs)))
        run = runs.run([*map(float, parameters.values())])
        self._is_long = runs.work > LONG
        return run

    def _path_of(self, name: str) -> Path:
        path = variable_path(name)
        if path[:1] == ("parameters",) and path[1:] not in [(parameter,) for parameter in self.spec.parameters]:
            known = list(self.spec.parameters)
            keys = list(keys_ending_in(name, json.loads(self.spec.canonical_json())["model"]))
            hint = did_you_mean(name, known) or (f"; parameters: {listed(known)}" if known else "")
            hint += f"; numbers of the model have dotted keys{f', such as {keys[0]}' if keys else ''}"
            raise SpecError(f"the spec has no parameter '{name}'{hint}", key="parameters")
        return path


def _varied(text: str, paths: Sequence[Path], numbers: Sequence[float]) -> RunSpec:
    """Return a new spec, given as JSON, with other numbers at some key paths."""
    return VariedSpecs(text).spec([*zip(paths, numbers, strict=True)])


def prepare(source: RunSource, **sections: Unpack[Sections]) -> PreparedRun:
    """Prepare a spec for many runs with other numbers, one after another, as in optimisation.

    A small run of the prepared spec then takes about a millisecond in addition to its steps. If all numbers are known
    in advance, `PreparedRun.run_many` and `mbdkit.ensemble` are faster.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism with its `sections`.
    **sections
        Sections of the spec, such as ``integrator={"name": "gauss", "stages": 2}``; they replace those of `source`.

    Raises
    ------
    SpecError
        If the input is wrong.

    Examples
    --------
    >>> import mbdkit
    >>> prepared = mbdkit.prepare("double-pendulum", time={"end": 1.0, "step": 0.01})
    >>> light, heavy = (prepared.run({"model.masses.1": mass}) for mass in (1.0, 2.0))
    >>> peaks = [abs(run.joints["J1"].reaction_force).max() for run in (light, heavy)]
    >>> bool(peaks[0] < peaks[1])
    True
    """
    return PreparedRun(load_spec(source, (), **sections))


def spec_started_at(spec: RunSpec, values: Mapping[str, float | str], starts: Starts) -> RunSpec:
    """Return a spec with the mechanism written out at a start in which some quantities have given values.

    Of all states that satisfy the joints and the given values, the new start is the one nearest to the start of the
    spec in the mass metric. It is found along a path on which the values change gradually.

    Parameters
    ----------
    values
        Values by name of a quantity, such as ``crank.angle``, ``J1.angle``, ``crank.angular_velocity`` or ``tip.vx``;
        numbers, or texts with a unit.
    starts
        Cache of compiled mechanisms.

    Raises
    ------
    SpecError
        If there is no such quantity, if a value is not valid, if the values and the joints are inconsistent, if the
        mechanism has beams, or if joints would move with the start.
    """
    mechanism = spec.mechanism()
    q, v = GivenStart(mechanism, spec, starts).state(values)
    model = mechanism.to_spec()
    states = np.hstack([q.reshape(-1, 3), v.reshape(-1, 3)]).tolist()
    places = dict(zip(mechanism.bodies, states, strict=True))
    for name, body in model["bodies"].items():
        x, y, angle, vx, vy, rate = places[name]
        body |= {"position": [x, y], "velocity": [vx, vy]}
        if mechanism.bodies[name].inertia is not None:
            body |= {"angle": angle, "angular_velocity": rate}
    started = type(spec)(**(spec.sections() | {"model": model}))
    _check_equal_but_for_start(mechanism, started.mechanism())
    return started


def _check_equal_but_for_start(one: Mechanism, other: Mechanism) -> None:
    """Raise SpecError if initial positions of the mechanism determine anything else than the initial state."""
    for a, b in zip(compile_mechanism(one).topology, compile_mechanism(other).topology, strict=True):
        if a.shape != b.shape or not np.allclose(a, b, rtol=1e-9, atol=1e-9, equal_nan=True):
            raise SpecError("joints placed by `at`, `from` or `to` move with the start; give `points`", key="initial")
