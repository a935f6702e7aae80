"""What a criterion finds: a doubt or a remark about a run or about data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """What a criterion finds.

    Parameters
    ----------
    criterion
        Name of the criterion, which `accept` of a spec may list.
    level
        ``doubtful`` lowers the verdict; None makes the finding a remark.
    sentence
        What was found, and what to do about it.
    key
        Key path in the spec that the finding is about; empty if there is none.
    """

    criterion: str
    level: Literal["doubtful"] | None
    sentence: str
    key: str = ""

    def __str__(self) -> str:
        return f"{self.criterion}: {self.sentence}"
