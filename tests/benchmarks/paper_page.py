"""`python -m tests.benchmarks.paper_page FOLDER`: writes what the study in FOLDER says of the source paper's claims.

FOLDER is that of `mbdkit study paper -o FOLDER`. It is the page `paper` of the guide.
"""

from __future__ import annotations

import sys
import textwrap

import mbdkit
from mbdkit_paper.paper.source_paper import BIBTEX, TITLE
from mbdkit_report import Answer, Claim, Verdict
from mbdkit_studies.results.judge import judge
from tests.first_party import PARTS

GUIDE = PARTS["mbdkit_paper"] / "guide" / "paper.md"
OF_A_MACHINE = ("time-bodies", "substitution")
"""Claims whose figures are times, which differ between machines."""

ANSWERS = {Answer.YES: "Confirmed", Answer.NO: "Not confirmed", Answer.PARTLY: "Partly confirmed", Answer.OPEN: "Open"}

PICTURES = "../../../../../.github"
"""Folder of pictures, from that of the page."""

OUTLINE = """\
# The source paper, re-run

The claims of the source paper on explicit and implicit methods, compared with a study of {runs} runs.

<!-- Written by `python -m tests.benchmarks.paper_page FOLDER`; do not edit. -->

The source paper is

> {title}.

The paper asks which integrator keeps the joints of a mechanism closed, and at what cost, as a step towards the design
of devices that support human joints. The *misalignment* of a revolute joint is the distance between its two points,
which should coincide but drift apart because of numerical error. The paper measures the misalignment for pendulums of
one and two rods, and predicts it for a knee linkage with four joints.

`mbdkit study paper -o paper --report` repeats the comparison within one to three minutes on two cores. Its report
contains the claims below, with tables and figures. "This machine" is the machine on which this page was generated. The
BibTeX entry of the paper, whose author and DOI are not known to us, is:

```bibtex
{bibtex}
```

![Misalignment of a double pendulum over 150 steps: it grows with RK-Gill only]({pictures}/paper-drift.png)
![Misalignment of a knee linkage over the step, with the two predicted ranges shaded]({pictures}/paper-knee.png)

## Claims

{claims}

## Assumptions

{notes}
"""


def page(verdict: Verdict, runs: int) -> str:
    """Return the page on the paper."""
    claims = "\n".join(full_entry(claim) for claim in verdict.claims)
    notes = "\n".join(_item(note) for note in verdict.notes[1:])  # the first one names the paper, as the page does
    return OUTLINE.format(
        pictures=PICTURES,
        runs=runs,
        title="\n> ".join(textwrap.wrap(TITLE, 118)),
        bibtex=BIBTEX,
        claims=claims,
        notes=notes,
    )


def full_entry(claim: Claim) -> str:
    """Return a claim as an item of the page."""
    return _item(
        f"**{ANSWERS[claim.answer]}**: {claim.statement} Published: {claim.published}. Found: {claim.computed}. "
        f"{claim.sentence}"
    )


def _item(text: str) -> str:
    return "- " + "\n  ".join(textwrap.wrap(text, 118, break_long_words=False, break_on_hyphens=False))


def main(folder: str) -> None:
    """Write the page."""
    study = mbdkit.load_study(folder)
    verdict = judge(study)
    GUIDE.write_text(page(verdict, len(study.points)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
