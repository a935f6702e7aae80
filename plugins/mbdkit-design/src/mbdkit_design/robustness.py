"""The effect of inexact numbers on a design, such as dimensions of the built device and measured masses of its user."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.base.plain_data import Path, canonical
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import variable_path
from mbdkit_design.evaluation import Evaluator, Job, Settings
from mbdkit_report import key_unit, key_words, leaves

OFF = 0.05  #: Relative deviation of variables and masses.
MOVED = 0.002  #: Deviation of a coordinate of an attachment [m].
_ELEMENTS = ("forces", "springs")
_INERTIA = {"mass": "inertia", "masses": "inertias"}  #: Key of the inertia beside the key of a mass.
_POINTS = ("points", "point", "at", "from", "to")
#: Largest number of masses that are varied: those of the heaviest bodies.
MOST = 12


@dataclass(frozen=True)
class Deviation:
    """Goals and limits of a design if one number deviates from its value at the best point.

    Attributes
    ----------
    words, size
        Name of the number, and size of the deviation, such as 5 % or 2 mm.
    goals
        (2, G) goals with the number reduced and increased by the deviation; nan where a run fails.
    exceeds
        Names of the limits that are violated with the reduced or the increased number.
    """

    words: str
    size: str
    goals: np.ndarray
    exceeds: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the data that are printed as JSON."""
        return {"number": self.words, "off_by": self.size, "goals": self.goals, "exceeds": self.exceeds}


def robustness(evaluator: Evaluator, best: np.ndarray) -> list[Deviation]:
    """Return goals and limits near the best point (n,), with one number changed at a time.

    Each variable (all values of a table at once) and each of the `MOST` largest masses of the model are changed by 5 %.
    The inertia of a body is
    changed with its mass, as if its density changed, unless it is a variable or follows from the mass. Each attachment
    of a force element is moved by 2 mm along x and along y.
    """
    settings = evaluator.settings(best)
    specs = [runs.at(settings) for runs in evaluator.scenarios]
    moved = [dict(_numbers(spec, [path for path, _ in settings])) for spec in specs]
    values_at = evaluator.variables(best)
    keys = {name: (name,) for name in evaluator.spec.single} | {n: t.keys for n, t in evaluator.spec.tables.items()}
    cases: list[tuple[str, str, list[Sequence[Settings]]]] = [
        (key_words(name), f"{100 * OFF:g} %",
         [[[(variable_path(key), values_at[key] * (1 + off)) for key in some] for off in (-OFF, OFF)]] * len(specs))
        for name, some in keys.items()
    ]  # fmt: skip
    for path in moved[0]:
        if all(path in one for one in moved):
            size = f"{1000 * MOVED:g} mm" if path[1] in _ELEMENTS else f"{100 * OFF:g} %"
            head, of, body = key_words(path).partition(" of ")
            if len(moved[0][path][0]) > 1:
                head += f" and {key_words(_inertia_of(path)).partition(' of ')[0]}"
            cases.append((f"{head}{of}{body}", size, [one[path] for one in moved]))
    jobs = [
        Job(scenario, [*settings, *both[side]])
        for _, _, by_scenario in cases
        for side in (0, 1)
        for scenario, both in zip(evaluator.spec.specs, by_scenario, strict=True)
    ]
    values = np.array([outcome.values for outcome in evaluator.run(jobs)])
    values = values.reshape(len(cases), 2, len(specs), len(evaluator.names))
    return [
        Deviation(words, size, np.array([evaluator.sums(one) for one in of_case]), evaluator.exceeded(of_case))
        for (words, size, _), of_case in zip(cases, values, strict=True)
    ]


def _numbers(spec: ModelSpec, taken: Sequence[Path]) -> Iterator[tuple[Path, Sequence[Settings]]]:
    """Yield the paths of masses and of coordinates of attachments in a model, with the settings for both deviations.

    Numbers at or below the paths in `taken` are left out.
    """
    model = canonical(spec.model)
    numbers = [path for path, value in leaves(model, ("model",)) if type(value) in (int, float)]
    results = [path for path in numbers if not any(path[: len(one)] == one for one in taken)]
    masses = [path for path in results if path[1] not in _ELEMENTS and key_unit(path, [spec]) == "kg"]
    for path in sorted(masses, key=lambda path: -abs(_at(model, path)))[:MOST]:
        paths = [path, *(result for result in results if result == _inertia_of(path))]
        yield path, [_scaled(model, paths, 1 + off) for off in (-OFF, OFF)]
    for path in results:
        if path[1] in _ELEMENTS and any(key in path for key in _POINTS) and key_unit(path, [spec]) == "m":
            value = _at(model, path)
            yield path, [_setting(model, path, value + off) for off in (-MOVED, MOVED)]


def _inertia_of(path: Path) -> Path:
    """Return the path that the inertia beside a mass would have."""
    place = max(index for index, part in enumerate(path) if isinstance(part, str))
    return (*path[:place], _INERTIA.get(str(path[place]), ""), *path[place + 1 :])


def _scaled(model: object, paths: Sequence[Path], factor: float) -> Settings:
    return [one for path in paths for one in _setting(model, path, factor * _at(model, path))]


def _at(model: Any, path: Path) -> Any:
    for part in path[1:]:
        model = model[part]
    return model


def _setting(model: object, path: Path, value: float) -> Settings:
    """Return the setting of a number. A number in a list is set with the whole list, because the base may omit the
    list.
    """
    depth = next((index for index, part in enumerate(path) if isinstance(part, int)), len(path))
    if depth == len(path):
        return [(path, value)]
    numbers = deepcopy(_at(model, path[:depth]))
    _at(numbers, path[depth - 1 : -1])[path[-1]] = value
    return [(path[:depth], numbers)]
