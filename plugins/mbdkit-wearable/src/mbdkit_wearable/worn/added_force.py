"""What devices add to the forces of joints in inverse dynamics: `run.added_force`, and lines of the summary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MethodType

import numpy as np

from mbdkit.plugin import Run, SpecError, UnknownNameError, listed, plus_minus
from mbdkit.plugin.seams import run_attribute, summary_lines

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
    """

    joint: str
    time: np.ndarray
    force: np.ndarray
    without: np.ndarray
    force_error: np.ndarray
    without_error: np.ndarray
    added_error: np.ndarray

    @property
    def added(self) -> np.ndarray:
        """(T, 2) what the devices add [N]."""
        return np.asarray(self.force - self.without)

    def __str__(self) -> str:
        """Return a sentence with the largest forces, and with the largest one that the devices add."""
        sizes = (np.linalg.norm(one, axis=1) for one in (self.force, self.without, self.added))
        errors = self.force_error, self.without_error, self.added_error
        texts, row = [], 0
        for size, error in zip(sizes, errors, strict=True):
            row = int(np.argmax(size))
            texts.append(f"{size[row]:.4g} N" if np.isnan(error[row]) else f"{plus_minus(size[row], error[row])} N")
        return (
            f"{self.joint}: {texts[0]} with devices, {texts[1]} without; they add at most {texts[2]}, at "
            f"{self.time[row]:.4g} s"
        )


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
    errors = [
        parts[name][:, index] if name in parts else unknown
        for name in ("force_error", "reaction_without_error", "reaction_added_error")
    ]
    forces = (run.array(path)[:, index] for path in ("joints/reaction_force", WITHOUT))
    return AddedForce(joint, np.asarray(run.time), *forces, *errors)


@run_attribute
def added_force_of(run: Run) -> Callable[..., AddedForce]:
    """Return the function that computes what devices add to a joint of a run."""
    return MethodType(added_force, run)


@summary_lines
def device_lines(run: Run) -> list[tuple[str, str]]:
    """Return lines of the summary with the forces of joints with and without devices."""
    forces = [added_force(run, joint) for joint in run.joint_names]
    changed = [one for one in forces if np.max(np.abs(one.added)) > 0]
    changed.sort(key=lambda one: -float(np.max(np.linalg.norm(one.added, axis=1))))
    names = listed([str(name) for name in run.array("followers/follower")], "and")
    return [("devices", names), *(("", str(one)) for one in changed[:3])] if changed else []
