"""The pages of the guide, which `mbdkit guide` finds by their names: Markdown files of this folder and of plugins."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import cast

from mbdkit.base.errors import SpecError
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
    """A section of the guide that contains the words of a search, and the line that contains most of them."""

    topic: str
    heading: str
    line: str


def search(words: str) -> list[Hit]:
    """Return the sections of the guide that contain all words; sections in which the words are adjacent come first."""
    wanted = _plain(words).split()
    matches: list[tuple[bool, int, Hit]] = []
    for page in pages().values():
        for section in re.split(r"^(?=#+ )", page.text, flags=re.MULTILINE):
            text = _plain(section)
            if not wanted or not all(word in text for word in wanted):
                continue
            heading, *lines = section.splitlines()
            best = max(lines or [""], key=lambda line: sum(word in _plain(line) for word in wanted))
            away = sum(word not in _plain(heading) for word in wanted)
            matches.append((" ".join(wanted) not in text, away, Hit(page.topic, heading.lstrip("# "), best.strip())))
    return [hit for *_, hit in sorted(matches, key=lambda match: match[:2])]


def _plain(text: str) -> str:
    """Return text in lower case, in which hyphens and line ends are replaced by single spaces."""
    return " ".join(text.lower().replace("-", " ").split())


def find_page(topic: str) -> Page:
    """Return the page on a topic. Raises SpecError if there is no such page."""
    known = pages()
    if topic not in known:
        raise SpecError(
            f"the guide has no page '{topic}'{did_you_mean(topic, known)}, and no section with this word; its pages: "
            f"{listed(known)}"
        )
    return known[topic]
