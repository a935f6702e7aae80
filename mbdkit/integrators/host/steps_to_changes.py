"""Methods in Python and libraries whose controlled steps end where forces change: at switches, or at a contact.

Error control sees only the motion at the stages of a step. A function therefore looks into each step that a method
would accept, and the step is taken again up to the first change that it finds.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.interpolation import hermite
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.integrators.interface import SAME_INSTANT
from mbdkit.integrators.loop.steps_to_switches import PARTS, first_place, is_clear, next_place
from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState, Why

#: Dense output is not believed if it deviates from the cubic through both ends by this many times the way of the step.
ASTRAY = 10.0
MOST_CUTS = 20  #: Largest number of times that a library is opened again in one step.

#: Function of the equations, start and state of a step, the step, and its end; it returns the share of the step at
#: which a force changes, 1 if none does.
Change = Callable[[EquationsOfMotion, float, StepState, Step, float], float]
#: Function of the equations and a time and state from which a library cannot go on because a force changes there. It
#: returns a step across this instant, or None.
Across = Callable[[EquationsOfMotion, float, StepState], Step | None]


def with_changes(
    method: StepMethod | ExternalMethod, change: Change, across: Across | None = None
) -> StepMethod | ExternalMethod:
    """Return a method whose steps end where forces change; methods with fixed steps are returned unchanged."""
    if isinstance(method, ExternalMethod):
        return LibraryToChanges(method, change, across)
    return method if method.tolerances is None else StepsToChanges(method, change)


class StepsToChanges(StepMethod):
    """A method in Python with controlled steps that end where forces change.

    Parameters
    ----------
    method
        The method that takes the steps.
    change
        Finds the first change in a step.
    """

    def __init__(self, method: StepMethod, change: Change):
        self.method, self.change = method, change
        self.tolerances, self.error_order, self.hint = method.tolerances, method.error_order, method.hint
        self.carries_multipliers = method.carries_multipliers  # type: ignore[misc]

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> object:
        """See `StepMethod.begin`."""
        return self.method.begin(equations, t, state, why)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        """Take a step; reject it if a force changes within it, and ask for the part before."""
        new = self.method.step(equations, t, state, h)
        made = new if isinstance(new, Step) else Step(new)
        share = self.change(equations, t, state, made, t + h) if made.accepted and made.time is None else 1.0
        return made if share == 1.0 else replace(made, accepted=False, next_step=share * h)


class LibraryToChanges(ExternalMethod):
    """A library with a loop of its own whose steps end where forces change.

    If a force changes within a step, the library is opened again at the start of this step, with that point as its end,
    and then there.

    Parameters
    ----------
    library
        The library.
    change, across
        Find the first change in a step, and cross one at which the library fails.
    """

    def __init__(self, library: ExternalMethod, change: Change, across: Across | None = None):
        self._given, self._change, self._across = library, change, across
        self.tolerances, self.hint = library.tolerances, library.hint
        self.carries_multipliers = library.carries_multipliers  # type: ignore[misc]

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        """See `ExternalMethod.open`."""
        self._library, self._equations, self._stop = copy.copy(self._given), equations, stop
        self._open(t, state, stop)

    def _open(self, t: float, state: StepState, until: float) -> None:
        self._now, self._until, self._ended = (t, state), until, False
        self._library.open(self._equations, t, state, until)

    def advance(self) -> Step:
        """See `ExternalMethod.advance`."""
        if self._ended:
            self._open(*self._now, self._stop)
        t, begin = self._now
        for cuts in range(MOST_CUTS + 1):
            made = self._advance()
            assert made.time is not None
            end = float(made.time)
            share = self._change(self._equations, t, begin, made, end) if cuts < MOST_CUTS else 1.0
            if share == 1.0:
                break
            self._open(t, begin, t + share * (end - t))
        self._now = end, made.state
        self._ended |= self._now[0] >= self._until - SAME_INSTANT * max(abs(self._until), 1.0)
        return made

    def _advance(self) -> Step:
        """Return a step of the library, or across a change before which it fails because a force jumps."""
        try:
            return self._library.advance()
        except StepError as error:
            step = None if self._across is None else self._across(self._equations, *self._now)
            if error.code != "step-too-small" or step is None:
                raise
        self._ended = True
        return step

    def cut(self, t: float) -> StepState | None:
        """See `ExternalMethod.cut`."""
        return self._library.cut(t)

    def save(self) -> bytes | None:
        """See `ExternalMethod.save`: nothing where the library is opened again."""
        own = self._library.save()
        return b"" if self._ended and own is not None else own

    def restore(self, stored: bytes) -> None:
        """See `ExternalMethod.restore`."""
        if stored:
            self._library.restore(stored)


class ToSwitches:
    """Finds where laws and expressions switch (`Change`); see `mbdkit.integrators.loop.steps_to_switches`.

    `pinned`: the switching functions of the run.
    """

    def __init__(self, pinned: PinnedBundle):
        self.pinned = pinned

    def __call__(self, equations: EquationsOfMotion, t: float, begin: StepState, made: Step, end: float) -> float:
        """Return the share of a step at which a law or an expression switches."""
        switches, engine = self.pinned.address, equations.workspace.engine
        h, last, dense, bundle = end - t, made.state, made.dense, self.pinned.bundle

        def state(x: float) -> tuple[np.ndarray, ...]:
            q, v = hermite(x, h, begin.q, last.q - begin.q, begin.v, last.v)
            if dense is not None and not by_cubic and 0.0 < x < 1.0:
                between = dense(x)
                astray.append(float(np.max(np.abs(between[0] - q))))
                return between
            return q, v, begin.z + x * (last.z - begin.z)

        astray = list[float]()
        place, count, by_cubic = float(first_place(switches, t, h)), 0, dense is not None
        while place >= 0.0:
            q, v, z, *_ = state(place)
            bundle.q[:], bundle.v[:], bundle.z[:] = with_ground(q), with_ground(v), z
            place, count = float(next_place(engine, switches, t, h, place)), count + 1
            if by_cubic and count == 2 + PARTS:
                if is_clear(switches):
                    return 1.0
                place, by_cubic = float(first_place(switches, t, h)), False
        share = -1.0 - place
        if 0.0 < share < 1.0:
            return share
        ways = np.abs(last.q - begin.q) + h * (np.abs(begin.v) + np.abs(last.v))
        if astray and max(astray) > ASTRAY * float(np.max(ways)):  # stages behind the zero make it useless
            return self(equations, t, begin, replace(made, dense=None), end)
        return 1.0
