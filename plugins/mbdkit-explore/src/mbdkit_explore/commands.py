"""Sliders in the browser: `explore`."""

from __future__ import annotations

import webbrowser
from typing import Annotated

import typer

from mbdkit.base.terminal import say, show
from mbdkit.cli.common_options import Debug, Set, SpecName


def explore(
    spec: SpecName,
    assignments: Set = None,
    *,
    parameters: Annotated[
        list[str] | None,
        typer.Option(
            "--parameters",
            metavar="NAME",
            help="Add a slider for this parameter of the spec, or for the number with this key path; may be repeated. "
            "By default, sliders change all parameters or, if there are none, numbers of the model.",
        ),
    ] = None,
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, metavar="N", help="Port of the page; by default a free one.")
    ] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address only.")] = False,
    debug: Debug = False,
) -> None:
    """Change numbers of a spec with sliders in the browser.

    The page shows how motion and forces change. It is served on this machine only, until
    Ctrl-C, at an address that contains a secret token. Needs `pip install "mbdkit[explore]"`.
    """
    from mbdkit_explore.explorer import explorer_of
    from mbdkit_explore.server import Exploration

    with Exploration(explorer_of(spec, parameters, assignments or ()), port) as exploration:
        show(exploration.url)
        say("Press Ctrl-C to end.")
        if not no_browser:
            webbrowser.open(exploration.url)
        exploration.wait()
