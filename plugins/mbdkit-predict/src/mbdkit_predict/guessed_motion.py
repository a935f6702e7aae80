"""The first guess from a known motion: that in an archive, or the optimum of a simpler problem."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.files_read import check_readable, read_data
from mbdkit.base.plain_data import parse_path
from mbdkit.base.text import listed, shown
from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.predict_spec import PredictSpec

LARGEST_FILE = 2**31  #: Largest size of an archive that is read [bytes].
#: Quantities in archives that stand for controls; equilibria of elements name those that stand for their unknowns.
IN_PLACE = {"excitation": "activation"}


class GuessedMotion:
    """Values (K, T) of each kind of unknowns at times (T,), nan where they are not known, and durations of phases."""

    def __init__(self, time: np.ndarray, known: Mapping[str, np.ndarray], durations: Sequence[float]):
        self._time, self._known, self._durations = time, known, durations

    def durations(self, guess: np.ndarray) -> np.ndarray:
        """Return the durations (P,) of the phases; by default in proportion to `guess`."""
        if len(self._durations) == len(guess):
            return np.array(self._durations)
        return np.asarray(guess / guess.sum() * (sum(self._durations) or self._time[-1]))

    def known(self, name: str, guess: np.ndarray, times: np.ndarray, durations: np.ndarray) -> np.ndarray:
        """Return the unknowns (K, T) with a name at `times` (T,); those of `guess` where none are known.

        Each phase is stretched to the duration of that of the guess.
        """
        if name not in self._known:
            return guess
        known = self.durations(durations)
        here, there = (np.append(0.0, np.cumsum(x)) for x in (durations, known))
        at = np.interp(times, here, there)
        values = np.array([np.interp(at, self._time, row) for row in self._known[name]]).reshape(guess.shape)
        pace = (known / durations)[np.searchsorted(here[1:-1], times)]
        return np.where(np.isnan(values), guess, values * pace ** {"v": 1, "a": 2}.get(name, 0))


def archived_motion(spec: PredictSpec, system: CasadiSystem) -> GuessedMotion:
    """Return the motion in the archive that a spec names, by names of bodies, constraints, states and controls."""
    path = spec.folder / str(spec.guess)
    check_readable(path)
    if not path.is_file():
        raise SpecError(f"there is no such archive: {shown(str(path))}", key="guess")
    with spec.recording_files():
        read_data(path, LARGEST_FILE)
    with load(path) as run:
        time, bodies = run.time - run.time[0], list(run.bodies)
        if not set(bodies) & set(system.bodies):
            both = f"{listed(bodies, 'and')}; the mechanism has {listed(system.bodies, 'and')}"
            raise SpecError(f"no body of {shown(path.name)} is one of the mechanism: it has {both}", key="guess")
        of_bodies = [
            _chosen(system.bodies, bodies, run.array(f"trajectory/{name}"))
            for name in ("position", "velocity", "acceleration")
        ]
        known = dict(zip("qva", system.coordinates_of(*of_bodies, time=time), strict=True))
        if run.records("constraints/multiplier"):
            rows = run.array("constraints/constraint").tolist()
            known["lam"] = _chosen(system.constraint_names, rows, run.array("constraints/multiplier"))
        chosen = spec.chosen
        controls = list[np.ndarray]()
        for key, state in zip(chosen.controls, chosen.control_states, strict=True):
            equilibrium, k = chosen.unknowns.get(key, (None, 0))
            recorded, size = (equilibrium.recorded[k], equilibrium.sizes[k]) if equilibrium else ("", 1.0)
            controls.append(_history(run, state, key, recorded) / size)
        optimized = json.loads(str(run.provenance.get("optimized", "{}")))
        known |= {
            "z": np.array([_history(run, name) for name in system.state_names]),
            "u": np.array(controls),
            "p": np.array([np.full(len(run.time), optimized.get(key, np.nan)) for key in system.parameter_names]),
        }
        return GuessedMotion(time, known, json.loads(str(run.provenance.get("durations", "[]"))))


def solved_motion(
    time: np.ndarray, values: Mapping[str, np.ndarray], solved: CasadiSystem, system: CasadiSystem
) -> GuessedMotion:
    """Return the solution of another problem of the same mechanism, with the unknowns at times (T,)."""
    n = len(values["q"])
    start = dict(zip("qvz", np.split(values["start"], [n, 2 * n]), strict=True))
    known = {x: np.column_stack([start.get(x, values[x][:, 0]), values[x]]) for x in ("q", "v", "a", "lam", "z", "u")}
    time, known["p"] = np.append(0.0, time), np.repeat(values["p"][:, None], len(time) + 1, axis=1)
    if len(solved.q0) != len(system.q0):  # other coordinates
        placed = solved.placed.map(len(time))(*(known[x] for x in "qvap"), time[None])
        known |= zip("qva", system.coordinates_of(*map(np.array, placed), time=time), strict=True)
        known["lam"] = _chosen(system.constraint_names, list(solved.constraint_names), known["lam"].T)
    for name, names in (("z", "state_names"), ("u", "control_names"), ("p", "parameter_names")):
        known[name] = _chosen(getattr(system, names), list(getattr(solved, names)), known[name].T)
    return GuessedMotion(time, known, values["duration"].tolist())


def _chosen(wanted: Sequence[str], names: list[str], histories: np.ndarray) -> np.ndarray:
    """Return rows (W ..., T) of histories (T, N, ...) with the wanted names; nan for those without one."""
    padded = np.concatenate([histories, np.full((len(histories), 1, *histories.shape[2:]), np.nan)], axis=1)
    places = [names.index(name) if name in names else len(names) for name in wanted]
    return padded[:, places].reshape(len(padded), -1).T


def _history(run: Run, state: str, control: str = "", recorded: str = "") -> np.ndarray:
    """Return the values (T,) of a state, or of what stands for a control, `recorded` by default; nan without any."""
    owner, _, attribute = state.rpartition(".")
    sources = [("states", state, "value"), ("muscles", owner, attribute)]
    if control and len(path := parse_path(control)) == 3:
        kind, name, value = map(str, path)
        in_place = recorded or IN_PLACE.get(value, value)
        sources[1:] = [("actuators", name, value), (kind, name, value), (kind, name, in_place)]
    for kind, name, value in sources:
        with suppress(AttributeError, LookupError, MbdkitError):
            values = np.asarray(getattr(getattr(run, kind)[name], value))
            if values.shape == run.time.shape and np.isfinite(values).any():
                return values
    return np.full(run.time.shape, np.nan)
