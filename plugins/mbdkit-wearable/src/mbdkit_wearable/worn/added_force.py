"""What devices add to the forces of joints in inverse dynamics: `run.added_force`, and lines of the summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MethodType
from typing import NamedTuple

import numpy as np

from mbdkit.plugin import Run, SpecError, UnknownNameError, listed, plus_minus
from mbdkit.plugin.seams import run_attribute, run_headlines, summary_lines

WITHOUT = "followers/reaction_force_without"


@dataclass(frozen=True)
class AddedForce:
    """The force in a joint with and without the devices that a person wears, in T rows.

    Attributes
    ----------
    joint
        Name of the joint.
    time
        (T,) [s].
    force, without
        (T, 2) forces on the second body with the devices, and for the same motion without them [N].
    force_error, without_error, added_error
        (T,) bounds (95 %) of the norms of the errors of both forces, and of their difference [N]; nan where unknown.
        The last two do not contain the noise of the data.
    changes
        What the devices change over the motion: the largest and the mean force, the impulse, and the largest added
        force.
    """

    joint: str
    time: np.ndarray
    force: np.ndarray
    without: np.ndarray
    force_error: np.ndarray
    without_error: np.ndarray
    added_error: np.ndarray
    changes: tuple[Change, ...]

    @property
    def added(self) -> np.ndarray:
        """(T, 2) what the devices add [N]."""
        return np.asarray(self.force - self.without)

    def __str__(self) -> str:
        """Return a sentence with the changes."""
        row = int(np.argmax(np.linalg.norm(self.added, axis=1)))
        return f"{self.joint}: {'; '.join(map(str, self.changes))} at {self.time[row]:.4g} s"


class Change(NamedTuple):
    """A number of the force in a joint with and without the devices, with the bar (95 %) of each, nan where unknown.

    The noise of the data changes the force with and without the devices alike, so that the bar of the difference does
    not contain it.
    """

    what: str
    unit: str
    ids: tuple[str, str]  #: Ids of the number without the devices, and of its change; see `mbdkit guide trust`.
    force: float
    force_bar: tuple[float, float]
    without: float
    without_bar: tuple[float, float]
    difference: float
    difference_bar: tuple[float, float]

    def __str__(self) -> str:
        """Return the number with and without the devices, and the difference, as text."""
        change = f"{_text(self.difference, self.difference_bar)} {self.unit}"
        if np.isnan(self.force):
            return f"{self.what} {change}"
        first, second = _text(self.force, self.force_bar), _text(self.without, self.without_bar)
        return f"{self.what} {first} {self.unit} with devices, {second} {self.unit} without, change {change}"


def _text(value: float, bar: tuple[float, float]) -> str:
    return f"{value:.4g}" if np.isnan(bar[0]) else plus_minus(value, bar)


def added_force(run: Run, joint: str) -> AddedForce:
    """Return the force in a joint with and without the devices that follow the motion of a run of inverse dynamics.

    Raises
    ------
    UnknownNameError
        If there is no such joint.
    SpecError
        If no device follows the motion.
    """
    if joint not in run.joint_names:
        raise UnknownNameError("joint", joint, list(run.joint_names))
    if not run.records(WITHOUT):
        raise SpecError("no device follows the motion of the run", key="follows")
    index, unknown, accuracy = list(run.joint_names).index(joint), np.full(len(run.time), np.nan), run.accuracy
    parts = {} if accuracy is None else {"force_error": accuracy.reaction_error, **accuracy.parts}
    names = "force_error", "reaction_without_error", "reaction_added_error"
    first, second, both = (parts[name][:, index] if name in parts else unknown for name in names)
    force, without = (run.array(path)[:, index] for path in ("joints/reaction_force", WITHOUT))
    changes = _changes(run, joint, force, without, parts)
    return AddedForce(joint, np.asarray(run.time), force, without, first, second, both, changes)


def _changes(
    run: Run, joint: str, force: np.ndarray, without: np.ndarray, parts: Mapping[str, np.ndarray]
) -> tuple[Change, ...]:
    """Return what devices change in forces (T, 2) of a joint; `parts` are the arrays of errors."""
    index, time, none = list(run.joint_names).index(joint), np.asarray(run.time), (np.nan, np.nan)
    first, second, added = (np.linalg.norm(one, axis=1) for one in (force, without, force - without))
    errors = parts["reaction_change_error"][:, index] if "reaction_change_error" in parts else np.full(3, np.nan)
    bars, of_force, of_without = [(error, error) for error in errors.tolist()], none, none
    if "reaction_without_peak_error" in parts:
        sizes = np.linalg.norm(run.array("joints/reaction_force"), axis=2)
        found = run.errors.of_largest("joints.force", run.joint_names, sizes, parts["force_error"])
        noise = parts["reaction_error_data"][int(np.argmax(second)), index]  # nearly that with the devices
        error = float(np.hypot(noise, parts["reaction_without_peak_error"][index]))
        of_force, of_without = tuple(found.bars[index].tolist()), (error, error)
    path, duration = f"joints.{joint}.force", float(time[-1] - time[0])
    means = [float(np.trapezoid(size, time)) / duration for size in (first, second)]
    largest = [float(np.max(size)) for size in (first, second)]
    impulse = tuple(duration * end for end in bars[1])

    def change(what: str, unit: str, expression: str, pair: list[float], ends: tuple[float, float]) -> Change:
        ids, both = (f"{expression} without devices", f"{expression} by devices"), (none, none)
        both = (of_force, of_without) if what == "largest force" else both
        return Change(what, unit, ids, pair[0], both[0], pair[1], both[1], pair[0] - pair[1], ends)

    most, of_added = float(np.max(added)), f"max(abs({path} by devices))"
    return (
        change("largest force", "N", f"max(abs({path}))", largest, bars[0]),
        change("mean force", "N", f"mean(abs({path}))", means, bars[1]),
        change("impulse", "N s", f"integral(abs({path}))", [duration * mean for mean in means], impulse),
        Change("added force up to", "N", ("", of_added), np.nan, none, np.nan, none, most, bars[2]),
    )


@run_attribute
def added_force_of(run: Run) -> Callable[..., AddedForce]:
    """Return the function that computes what devices add to a joint of a run."""
    return MethodType(added_force, run)


def _changed(run: Run) -> list[AddedForce]:
    """Return the joints whose force the devices change, those with the largest added forces first."""
    forces = [added_force(run, joint) for joint in run.joint_names]
    changed = [one for one in forces if np.max(np.abs(one.added)) > 0]
    return sorted(changed, key=lambda one: -float(np.max(np.linalg.norm(one.added, axis=1))))


@run_headlines
def device_headlines(run: Run) -> list[dict[str, object]]:
    """Return what devices change in joints; the changes of the joint that they load most are headlines."""
    found: list[dict[str, object]] = []
    for number, one in enumerate(_changed(run)):
        for change in one.changes:
            words = f"change of {change.what} in" if change.ids[0] else "largest force added to"
            pairs = [
                (f"{words} {one.joint} by devices", change.difference, change.difference_bar),
                (f"{change.what} in {one.joint} without devices", change.without, change.without_bar),
            ]
            for (label, value, bar), key in zip(pairs, change.ids[::-1], strict=True):
                if key:
                    own = {"label": label, "value": value, "bar": bar, "unit": change.unit, "id": key}
                    found.append(own | {"is_main": number == 0 and key == change.ids[1]})
    return found


@summary_lines
def device_lines(run: Run) -> list[tuple[str, str]]:
    """Return lines of the summary with the forces of joints with and without devices."""
    changed = _changed(run)
    names = listed([str(name) for name in run.array("followers/follower")], "and")
    lines = [("devices", names), *(("", str(one)) for one in changed[:3])] if changed else []
    has_bars = any(np.isfinite(change.difference_bar[0]) for one in changed for change in one.changes)
    return [*lines, *([("", "bars of changes leave out the noise of the data, which both share")] * has_bars)]
