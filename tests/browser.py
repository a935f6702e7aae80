"""A headless Chromium to open pages in: Debian's, or playwright's own."""

from __future__ import annotations

import importlib.util
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def executable() -> str | None:
    """Return where a Chromium is: named by MBDKIT_TEST_BROWSER, on the path, or playwright's own; None without one."""
    named = os.environ.get("MBDKIT_TEST_BROWSER")
    found = named or next(filter(None, map(shutil.which, NAMES)), None)
    if found:
        return found
    if importlib.util.find_spec("playwright") is None:
        return None
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        own = playwright.chromium.executable_path
    return own if Path(own).exists() else None


@contextmanager
def launched(path: str) -> Iterator[Browser]:
    """Give a headless browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])  # root may not use one
        yield browser
        browser.close()


@dataclass
class Watched:
    """A page, what its console said, what went wrong in it, and which addresses outside of it were asked for."""

    page: Page
    console: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)


def opened(browser: Browser, path: Path, *, width: int = 1400, height: int = 900, **look: str) -> Watched:
    """Open a file in a window of its own; every request that leaves the file is refused and noted."""
    context = browser.new_context(viewport={"width": width, "height": height}, **look)
    page = context.new_page()
    watched = Watched(page)
    page.on("console", lambda message: watched.console.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: watched.console.append(f"error: {error}"))
    here = path.resolve().as_uri()

    def guard(route, request):
        if request.url == here:
            route.continue_()
        else:
            watched.outside.append(request.url)
            route.abort()

    page.route(lambda url: not url.startswith(("data:", "blob:")), guard)
    page.goto(here)
    return watched


def until(page: Page, expression: str, patience: float = 10.0) -> None:
    """Wait until an expression holds in a page, whose security policy keeps playwright from waiting by itself."""
    end = time.monotonic() + patience
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"within {patience} s this did not come true: {expression}"
        page.wait_for_timeout(50)
