"""The pages of the guide: every Markdown file in this folder is a page, which `mbdkit guide` finds by its name."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed


@dataclass(frozen=True)
class Page:
    """A page of the guide.

    Attributes
    ----------
    topic
        Name of the page: its file name without ``.md``.
    text
        The page, as Markdown.
    """

    topic: str
    text: str

    @property
    def summary(self) -> str:
        """The first sentence of the first paragraph, on one line."""
        paragraphs = (" ".join(block.split()) for block in self.text.split("\n\n"))
        first = next(block for block in paragraphs if not block.startswith(("#", "<!--")))
        sentence, stop, _ = first.partition(". ")
        return sentence + stop.strip()


def pages() -> dict[str, Page]:
    """Return all pages by topic, in alphabetical order."""
    files = sorted(importlib.resources.files(__package__).iterdir(), key=lambda file: file.name)
    topics = {file.name.removesuffix(".md"): file for file in files if file.name.endswith(".md")}
    return {topic: Page(topic, file.read_text(encoding="utf-8")) for topic, file in topics.items()}


def find_page(topic: str) -> Page:
    """Return the page on a topic.

    Raises
    ------
    SpecError
        If there is none.
    """
    known = pages()
    if topic not in known:
        raise SpecError(f"the guide has no page '{topic}'{did_you_mean(topic, known)}; its pages: {listed(known)}")
    return known[topic]
