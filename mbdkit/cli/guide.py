"""The command `guide`: lists and prints the pages for users."""

from __future__ import annotations

from typing import Annotated

import typer

from mbdkit.base.terminal import show
from mbdkit.base.text import table
from mbdkit.cli.common_options import Debug


def guide(
    topic: Annotated[
        str | None, typer.Argument(metavar="TOPIC", help="Name of a page; without it, the pages are listed.")
    ] = None,
    debug: Debug = False,
) -> None:
    """List the pages of the guide, or print one.

    Pages are Markdown. A pager helps with long ones, as in
    `mbdkit guide spec | less`.
    """
    from mbdkit.guide.pages import find_page, pages

    if topic is None:
        show(table([("TOPIC", "CONTENTS"), *((page.topic, page.summary) for page in pages().values())]))
    else:
        show(find_page(topic).text.rstrip("\n"))
