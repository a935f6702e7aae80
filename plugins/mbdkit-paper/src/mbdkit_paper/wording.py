"""Words that the verdicts of the packaged studies share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from mbdkit_report import Answer, Axis, Band, Cell, Claim, Column, Figure, Line, Table, Verdict, columns_of

UNDECIDED = "Not decided: required runs are missing or failed, or their results are too uncertain for an answer."


class Words:
    """Texts of the claims, tables, figures and notes of a study, from ``words.yaml`` beside its verdict.

    They have places for values, as those of `str.format`. A text of a claim may be a mapping by answer, whose text for
    all other answers has the key ``else``.
    """

    def __init__(self, module_file: str):
        self._texts: dict[str, Any] = yaml.safe_load(Path(module_file).with_name("words.yaml").read_text("utf-8"))

    def claim(self, key: str, answer: Answer, name: str = "", /, **values: object) -> Claim:
        """Return a claim with the texts of this key, and with another name if one is given."""
        texts = self._texts["claims"][key]
        chosen = (texts.get(part, "") for part in ("statement", "published", "computed", "sentence"))
        templates = [text if isinstance(text, str) else text.get(str(answer), text["else"]) for text in chosen]
        statement, published, computed, sentence = (template.format(**values) for template in templates)
        return Claim(name or key, statement, published, computed, answer, sentence)

    def table(self, key: str, rows: Iterable[tuple[Cell, ...]], columns: Sequence[Column] = ()) -> Table:
        """Return a table with the texts of this key, and with these columns if the texts have none."""
        texts = self._texts["tables"][key]
        given = columns_of(texts["columns"]) if "columns" in texts else tuple(columns)
        return Table(key, texts["title"], given, tuple(rows), texts.get("note", ""), texts.get("headline", False))

    def figure(
        self,
        key: str,
        lines: Iterable[Line],
        name: str = "",
        *,
        bands: Iterable[Band] = (),
        equal: bool = False,
        **values: object,
    ) -> Figure:
        """Return a figure with the texts of this key, and with another name if one is given."""
        texts = self._texts["figures"][key]
        title, caption = (texts[part].format(**values) for part in ("title", "caption"))
        x, y = (Axis(**texts[axis]) for axis in "xy")
        return Figure(name or key, title, caption, x, y, tuple(lines), tuple(bands), equal=equal)

    def notes(self, **values: object) -> tuple[str, ...]:
        """Return the notes of the verdict; there may be none."""
        return tuple(note.format(**values) for note in self._texts.get("notes", ()))

    def verdict(
        self, name: str, title: str, claims: tuple[Claim, ...], tables: tuple[Table, ...], *figures: Figure
    ) -> Verdict:
        """Return a verdict with the sentences of all claims, and with the notes."""
        sentence = " ".join(claim.sentence for claim in claims)
        return Verdict(name, title, sentence, claims, tables, figures, self.notes())


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
