"""What a criterion finds: a doubt or a remark about a run or about data."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal, NamedTuple

from mbdkit.base.frozen import dataclass


@dataclass(frozen=True)
class Finding:
    """What a criterion finds.

    - `criterion`: name of the criterion, which `accept` of a spec may list.
    - `level`: ``doubtful`` or ``bad`` lowers the verdict; None makes the finding a remark.
    - `sentence`: what was found, and what to do about it.
    - `key`: key path in the spec that the finding is about; empty if there is none.
    - `is_named`: whether the text of the finding begins with the name of the criterion.
    """

    criterion: str
    level: Literal["doubtful", "bad"] | None
    sentence: str
    key: str = ""
    is_named: bool = True

    def __str__(self) -> str:
        return f"{self.criterion}: {self.sentence}" if self.is_named else self.sentence


class Doubts(NamedTuple):
    """What findings mean for the verdict on a result, as sentences.

    - `open`: doubts that the spec does not accept. `accepted`: those that it accepts.
    - `remarks`: remarks, which do not change the verdict.
    - `faults`: findings that make the result bad, and that the spec does not accept.
    """

    open: tuple[str, ...] = ()
    accepted: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @classmethod
    def of(cls, findings: Collection[Finding], accepted: Collection[str]) -> Doubts:
        """Return those of findings, of which the spec accepts some criteria."""
        open_, faults = (
            tuple(str(one) for one in findings if one.level == level and one.criterion not in accepted)
            for level in ("doubtful", "bad")
        )
        known = tuple(str(one) for one in findings if one.level is not None and one.criterion in accepted)
        return cls(open_, known, tuple(str(one) for one in findings if one.level is None), faults)
