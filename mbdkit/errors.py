"""Every error that mbdkit raises on purpose: a sentence for the person who can act, and where to act."""

from __future__ import annotations

from pathlib import Path
from typing import Literal


class MbdkitError(Exception):
    """Base of all errors that mbdkit raises on purpose; `str(error)` is a complete sentence."""


class SpecError(MbdkitError, ValueError):
    """What the user wrote is wrong: a spec, a mechanism, an expression, a file name.

    Parameters
    ----------
    message
        What was wrong and what would be right.
    key
        Dotted key path in the spec, such as ``model.joints.A.bodies[1]``; empty where there is none.
    file, line
        Where it was written, where known (lines count from 1).
    """

    def __init__(self, message: str, *, key: str = "", file: str | Path | None = None, line: int | None = None):
        super().__init__(message)
        self.message = message
        self.key = key
        self.file = None if file is None else str(file)
        self.line = line

    def __str__(self) -> str:
        place = self.file or ""
        if self.line is not None:
            place += f":{self.line}" if place else f"line {self.line}"
        where = ": ".join(part for part in (place, self.key) if part)
        return f"{where}: {self.message}" if where else self.message

    def located(self, *, prefix: str = "", file: str | Path | None = None, line: int | None = None) -> SpecError:
        """Return the same error with `prefix` put before its key, and with a file and line if it has none."""
        joint = "" if not prefix or not self.key or self.key.startswith("[") else "."
        key = f"{prefix}{joint}{self.key}"
        new = type(self)(self.message, key=key, file=self.file or file, line=self.line or line)
        new.__cause__ = self.__cause__
        return new


class PluginError(MbdkitError):
    """A plugin failed: it could not be imported, it clashes with another, or it raised while it was used."""


class RunError(MbdkitError):
    """A run did not complete; raised by `Run.check`."""


class StepError(Exception):
    """A step cannot be taken; the run ends as failed with this reason, and keeps the rows recorded before.

    `EquationsOfMotion` raises it if the equations have no unique or no finite solution; a method raises it if its own
    iteration does not converge.

    Parameters
    ----------
    code
        Reason as stored in the archive.
    sentence
        What went wrong, without the time and without a full stop.
    """

    def __init__(self, code: Literal["newton-failed", "singular", "not-finite", "step-too-small"], sentence: str):
        super().__init__(code, sentence)
        self.code, self.sentence = code, sentence

    def __str__(self) -> str:
        return self.sentence
