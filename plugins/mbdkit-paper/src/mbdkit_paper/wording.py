"""Words that the verdicts of the packaged studies share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from mbdkit_report import Answer, Claim

UNDECIDED = "Not decided: the required runs are missing or failed."


def reported(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return claims for a report: the sentences of open ones are replaced by `UNDECIDED`."""
    return tuple(replace(claim, sentence=UNDECIDED) if claim.answer is Answer.OPEN else claim for claim in claims)


def least_most(values: Iterable[float]) -> str:
    """Return the smallest and the largest finite value as text with two significant digits."""
    known = [value for value in values if math.isfinite(value)]
    return f"{min(known):.2g} to {max(known):.2g}" if known else "an unknown number of"


def two_digits(number: float) -> str:
    """Return a count as text with two significant digits and thousands separators."""
    return f"{float(f'{number:.2g}'):,.0f}" if math.isfinite(number) else "an unknown number of"
