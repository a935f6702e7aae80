"""What contributes to the error bars of joint forces: `run.contributions`, the summary, and the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MethodType

import numpy as np

from mbdkit.archive.headlines import excluded_words
from mbdkit.archive.result_seams import run_attribute
from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError, UnknownNameError
from mbdkit.base.text import listed, plus_minus, table
from mbdkit_biomech.uncertainty.sources import ADVICE
from mbdkit_biomech.uncertainty.uncertain_result import INTERACTIONS
from mbdkit_report import Axis, Cell, Figure, Line, Section, Table, columns_of

SHOWN = 0.005  #: Smallest share of a source in the printed table.

NAMED, JOINTS_NAMED = 3, 4  #: Number of sources that a sentence names, and of joints in the summary.

#: What error bars of persons do not include, if their uncertainty is left out.
PERSON_ERROR = "the uncertainty of the person's joint centres, lengths, masses and strength"

#: What error bars of persons do not include otherwise.
PERSON_MODEL_ERROR = "muscles that the model lacks, and motion out of the plane"


@excluded_words
def excluded_error(run: Run) -> str:
    """Return what the error bars of a person do not include; empty for other runs of inverse dynamics."""
    if "subject" not in run.spec:
        return ""
    return PERSON_MODEL_ERROR if has_contributions(run) else PERSON_ERROR


@dataclass(frozen=True)
class Contributions:
    """What contributes to the error bar of the force of a joint at a time."""

    joint: str  #: Name of the joint.
    time: float  #: Time of the row [s].
    force: float
    error: float  #: Force of the joint and its error bar, which holds with a probability of 95 % [N].
    #: Shares of the sources in the square of the error bar, the largest first; their sum is 1. The share of
    #: ``interactions`` is what the others leave. A share is negative if a source shifts the force in one direction, and
    #: all of them together in the other.
    shares: dict[str, float]

    @property
    def advice(self) -> str:
        """What reduces the largest source of the person and its muscles; empty if the noise of the data is larger."""
        return ADVICE.get(next((name for name in self.shares if name != INTERACTIONS), "").split(" ")[0], "")

    @property
    def sentence(self) -> str:
        """The largest sources with their shares, and the advice."""
        own = [(name, share) for name, share in self.shares.items() if name != INTERACTIONS and share > 0]
        told = listed([f"{name} {share:.0%}" for name, share in own[:NAMED]], "")
        return f"{told}{': ' if self.advice else ''}{self.advice}"

    def __str__(self) -> str:
        """Return the table as text."""
        shown = {name: share for name, share in self.shares.items() if abs(share) >= SHOWN}
        rows = [["source", "share"], *([name, f"{share:.1%}"] for name, share in shown.items())]
        head = f"{self.joint} at {self.time:.4f} s: {plus_minus(self.force, self.error)} N (95 %)"
        less = len(self.shares) - len(shown)
        return f"{head}\n{table(rows, '  ')}" + (f"\n  and {less} with less than {SHOWN:.1%}" if less else "")


def contributions(run: Run, joint: str, at: float | None = None) -> Contributions:
    """Return what contributes to the error bar of the force of a joint.

    Parameters
    ----------
    run
        The result of inverse dynamics with uncertain properties of a person, loads or muscles.
    joint
        Name of the joint.
    at
        Time [s]; by default, that of the largest force. The nearest recorded row is used.

    Raises
    ------
    UnknownNameError
        If there is no such joint.
    SpecError
        If the run has no contributions, or `at` is outside of the motion.
    """
    if joint not in run.joint_names:
        raise UnknownNameError("joint", joint, list(run.joint_names))
    if (accuracy := run.accuracy) is None or "contribution" not in accuracy.parts:
        raise SpecError("the run has no contributions: its spec has no `uncertainty`", key="uncertainty")
    place, time = list(run.joint_names).index(joint), np.asarray(run.time)
    force = _forces(run)[:, place]
    row = int(np.argmax(force))
    if at is not None:
        if not time[0] <= at <= time[-1]:
            raise SpecError(f"should be from {time[0]:.6g} to {time[-1]:.6g} s, not {at:g}", key="at")
        row = int(np.argmin(np.abs(time - at)))
    own = accuracy.parts["contribution"][:, row, place]
    order = np.argsort(-own, kind="stable").tolist()
    shares = {str(accuracy.parts["source"][index]): float(own[index]) for index in order}
    return Contributions(joint, float(time[row]), float(force[row]), float(accuracy.reaction_error[row, place]), shares)


@run_attribute
def contributions_of(run: Run) -> Callable[..., Contributions]:
    """Return the function that computes contributions of a run."""
    return MethodType(contributions, run)


def has_contributions(run: Run) -> bool:
    """Return whether a run has contributions."""
    return run.accuracy is not None and "contribution" in run.accuracy.parts


def _forces(run: Run) -> np.ndarray:
    return np.asarray(np.hypot(*np.moveaxis(run.array("joints/reaction_force"), -1, 0)[:2]))


def largest_joints(run: Run) -> list[str]:
    """Return the joints with the largest forces in descending order; empty without contributions."""
    if not has_contributions(run):
        return []
    order = np.argsort(-np.max(_forces(run), axis=0), kind="stable")[:JOINTS_NAMED]
    return [run.joint_names[index] for index in order]


def uncertainty_lines(run: Run) -> list[tuple[str, str]]:
    """Return lines of the summary with the sources of the error bars at the largest forces."""
    every = [contributions(run, joint) for joint in largest_joints(run)]
    texts = [f"{one.joint}: {one.sentence}" for one in every if np.isfinite(one.error)]
    return [("" if number else "sources of error", text) for number, text in enumerate(texts)]


DRAWN = 6  #: Number of sources of a chart; those that are left out have smaller shares.


def uncertainty_sections(run: Run) -> tuple[Section, ...]:
    """Return the section with the sources of the error bars at the largest forces; empty without uncertainty."""
    if not has_contributions(run):
        return ()
    rows: list[tuple[Cell, ...]] = []
    sentences = []
    for joint in largest_joints(run):
        own = contributions(run, joint)
        sentences.append(f"{joint}: {own.sentence}.")
        rows += [(joint, own.time, own.force, own.error, name, share) for name, share in [*own.shares.items()][:DRAWN]]
    heads = columns_of("joint; time [s]; force [N]; error bar [N]; source; share")
    note = (
        "Shares in the square of the error bar at the largest force of each joint. The error bars do not contain "
        f"{PERSON_MODEL_ERROR}."
    )
    shown = Table("sources", "Sources of the error bars", heads, tuple(rows), note)
    first = f"The {NAMED} largest sources at the largest force of each joint, and what reduces the first one."
    return (Section("uncertainty", "Uncertainty", (first, *sentences), None, (shown,)),)


def uncertainty_charts(run: Run) -> list[Figure]:
    """Return a chart of the shares over time for the joints with the largest forces; empty without uncertainty."""
    accuracy, time, found = run.accuracy, np.asarray(run.time), []
    for joint in largest_joints(run):
        assert accuracy is not None
        place = list(run.joint_names).index(joint)
        size = accuracy.parts["contribution"][..., place] * accuracy.reaction_error[:, place]
        order = np.argsort(-np.nansum(np.abs(size), axis=1), kind="stable")[:DRAWN]
        lines = tuple(Line(str(accuracy.parts["source"][index]), time, size[index]) for index in order)
        caption = (
            f"Error bar of the force of {joint}, divided among its sources in proportion to their shares in its square."
        )
        axis = Axis("part of the error bar", "N")
        found.append(Figure(f"sources-{joint}", f"Sources of error, {joint}", caption, Axis("time", "s"), axis, lines))
    return found
