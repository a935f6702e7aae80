"""Landmarks of the skeleton by the names that laboratories give to their markers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal

Side = Literal["r", "l"]
SIDES: tuple[Side, Side] = ("r", "l")

LEFT = "_left"  #: Suffix of the names of the second leg.

_KNEE, _ANKLE = r"(knee|kne|femoral)?(epicondyle|epi|condyle)?(knee|kne)?", r"(ankle|ank)?(malleolus|mal)?(ankle|ank)?"
#: Patterns of names by landmark, in lower case, without subject, side and signs: ``Subject:R.Knee.Lateral`` is
#: ``kneelateral``. A name of which the joint is missing, such as ``RMedial``, is left out by `landmark`.
PATTERNS = {
    "asis": r"asis?|ias",
    "psis": r"psis?|ips",
    "sacrum": r"v?sac(r|rum|ral)?",
    "knee.lateral": rf"kne|knee|lfe|fle|(lateral|lat){_KNEE}|{_KNEE}(lateral|lat)",
    "knee.medial": rf"knm|mkne|kneem|mfe|fme|(medial|med){_KNEE}|{_KNEE}(medial|med)",
    "ankle.lateral": rf"ank|ankle|lmal|fal|(lateral|lat){_ANKLE}|{_ANKLE}(lateral|lat)",
    "ankle.medial": rf"anm|mank|anklem|mmal|tam|(medial|med){_ANKLE}|{_ANKLE}(medial|med)",
}

_WORDS = {"knee": r"kn|fe|fle|fme|epi|condyle", "ankle": r"an|mal|fal|tam"}


def plain_name(name: str) -> str:
    """Return a name in lower case, without the subject and without signs."""
    return "".join(filter(str.isalnum, name.rpartition(":")[2])).casefold()


def sided(name: str) -> tuple[Side | None, str]:
    """Return the side of a plain name and the name without it: at the beginning, or else at the end."""
    given = re.fullmatch(r"(right|r|left|l)(.+)", name) or re.fullmatch(r"(.+?)(right|left)", name)
    if given is None:
        return None, name
    side, rest = sorted(given.groups(), key=lambda part: part not in ("right", "r", "left", "l"))
    return ("r" if side.startswith("r") else "l"), rest


def landmark(names: Iterable[str], kind: str, side: Side | None) -> str | None:
    """Return the name of the marker of a landmark; None if there is none.

    Parameters
    ----------
    kind
        A key of `PATTERNS`.
    side
        Side of the body; None for landmarks in its middle.
    """
    words = _WORDS.get(kind.partition(".")[0], "")
    for name in names:
        own, rest = sided(plain_name(name)) if side is not None else (None, plain_name(name))
        if own == side and re.fullmatch(PATTERNS[kind], rest) and re.search(words, rest):
            return name
    return None


def side_of(names: Iterable[str]) -> Side:
    """Return the side that most names of markers begin with; right if there is no majority."""
    sides = [sided(plain_name(name))[0] for name in names]
    return "l" if sides.count("l") > sides.count("r") else "r"
