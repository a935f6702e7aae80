"""The pages of the guide, which `mbdkit guide` finds by their names: Markdown files of this folder and of plugins."""

from __future__ import annotations

import functools
import math
import re
from collections import Counter
from typing import cast

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.feature_items import GuidePage
from mbdkit.registry.manager import registry

#: Groups of pages in the order of lists; groups of plugins follow.
GROUPS = ("Start", "Model", "Analyse", "Persons", "Trust and extend")


@dataclass(frozen=True)
class Page:
    """A page of the guide. `topic`: name of the page: its file name without ``.md``. `text`: the page, as Markdown.
    `group`: heading of the list that has it.
    """

    topic: str
    text: str
    group: str

    @property
    def title(self) -> str:
        """The heading of the page."""
        return self.text.partition("\n")[0].lstrip("# ")

    @property
    def summary(self) -> str:
        """The first sentence of the first paragraph, on one line."""
        paragraphs = (" ".join(block.split()) for block in self.text.split("\n\n"))
        first = next(block for block in paragraphs if not block.startswith(("#", "<!--")))
        sentence, stop, _ = first.partition(". ")
        return sentence + stop.strip()


def pages() -> dict[str, Page]:
    """Return all pages by topic: by group, then in the order of their items."""
    items = [cast(GuidePage, item.plugin) for item in registry().of_kind("guide-page")]
    order = list(dict.fromkeys([*GROUPS, *(item.group for item in items)]))
    items.sort(key=lambda item: order.index(item.group))
    return {item.name: Page(item.name, item.file.read_text(encoding="utf-8"), item.group or "More") for item in items}


@dataclass(frozen=True)
class Hit:
    """A section of the guide that answers a search, and its line that has most of the words."""

    topic: str
    heading: str
    line: str


def search(words: str) -> list[Hit]:
    """Return the sections of the guide that have words of a search, the most relevant one first.

    The order is that of BM25 (Robertson and Zaragoza 2009), in which a word counts more in the heading of a section, in
    the name of its page and in the first sentence of the page (`WEIGHTS`).
    """
    wanted = set(_terms(words))
    sections = [section for page in pages().values() for section in _sections(page)]
    mean_length = sum(section.length for section in sections) / len(sections)
    rarity = {}
    for word in wanted:
        number = sum(word in section.counts for section in sections)
        rarity[word] = math.log(1 + (len(sections) - number + 0.5) / (number + 0.5))

    def score(section: _Section) -> float:
        damping = SATURATION * (1 - LENGTH + LENGTH * section.length / mean_length)
        counts = {word: section.counts[word] for word in wanted}
        return sum(rarity[word] * count * (SATURATION + 1) / (count + damping) for word, count in counts.items())

    hits, numbers = list[Hit](), Counter[str]()
    for section in sorted(sections, key=score, reverse=True):
        numbers[section.topic] += 1
        if wanted & section.counts.keys() and numbers[section.topic] <= PER_PAGE:
            hits.append(section.hit(wanted))
    return hits[:HITS]


HITS = 12  #: Largest number of sections that a search returns.
PER_PAGE = 3  #: Largest number of them from one page; the reference of keys has a section for each key.


SATURATION, LENGTH = 1.2, 0.75  #: Constants k1 and b of BM25, at their usual values.

WEIGHTS = {"heading": 4, "page": 2}  #: How often words of the heading of a section, and words of the page, are counted.

#: Words that say nothing about the subject of a question.
QUESTION_WORDS = frozenset(
    re.findall(
        r"\w+",
        "a add an and are be can do does for from get how i in is it large make many mean much my of on or should that "
        "the there this to use was what when where which why with would",
    )
)


@dataclass(frozen=True)
class _Section:
    topic: str
    lines: list[str]
    counts: Counter[str]

    @property
    def length(self) -> int:
        return self.counts.total()

    def hit(self, wanted: set[str]) -> Hit:
        heading, *lines = self.lines
        best = max(lines or [""], key=lambda line: len(wanted.intersection(_terms(line))))
        return Hit(self.topic, heading.lstrip("# "), best.strip())


@functools.cache
def _sections(page: Page) -> list[_Section]:
    about = Counter(_terms(f"{page.topic} {page.title} {page.summary}"))
    sections = []
    for text in re.split(r"^(?=#+ )", page.text, flags=re.MULTILINE):
        if lines := text.splitlines():
            counts = Counter(_terms(text))
            for _ in range(WEIGHTS["heading"]):
                counts.update(_terms(lines[0]))
            for _ in range(WEIGHTS["page"]):
                counts.update(about)
            sections.append(_Section(page.topic, lines, counts))
    return sections


def _terms(text: str) -> list[str]:
    """Return the words of a text in lower case and in the singular, without words of questions."""
    words = re.findall(r"[^\W_]+", text.lower())
    return [re.sub(r"(?<=ss)es$|(?<=[^isu])s$", "", word) for word in words if word not in QUESTION_WORDS]


def find_page(topic: str) -> Page:
    """Return the page on a topic. Raises SpecError if there is no such page."""
    known = pages()
    if topic not in known:
        raise SpecError(
            f"the guide has no page '{topic}'{did_you_mean(topic, known)}, and no section with this word; its pages: "
            f"{listed(known)}"
        )
    return known[topic]
