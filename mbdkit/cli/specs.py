"""Commands for writing specs: `examples` and `guide`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbdkit.base.terminal import show
from mbdkit.base.text import grouped_table
from mbdkit.cli.common_options import PLAIN, Debug, output_to
from mbdkit.cli.completion import completing
from mbdkit.registry.target import Target

examples_app = typer.Typer(
    help="List the packaged examples, or copy one.", add_completion=False, **{**PLAIN, "no_args_is_help": False}
)


@examples_app.callback(invoke_without_command=True)
def examples(context: typer.Context, debug: Debug = False) -> None:
    """List the packaged examples, specs and notebooks, by purpose.

    Run a spec by its name with `mbdkit run`, `mbdkit inverse` for inverse dynamics, or
    `mbdkit design` for designs, or copy a spec or a notebook to edit it.
    """
    if context.invoked_subcommand is not None:
        return
    from mbdkit.spec.loading import (  # no validation, which imports plugins
        example_groups,
        example_names,
        notebook_names,
        notebook_title,
        read_source,
    )
    from mbdkit.spec.spec_kinds import spec_kinds

    rows: list[tuple[str, str, str]] = []
    for kind in sorted(spec_kinds(), key=lambda kind: bool(kind.marker)):  # run specs first
        names = set(example_names(kind.name)) if kind.heading else set()
        for name, group in example_groups().items():
            if name in names:
                heading = kind.heading if kind.marker else group or kind.heading
                rows.append((f"{heading} ({kind.command})", name, read_source(name).data["title"]))
    rows += [("Notebooks (mbdkit examples copy)", name, notebook_title(name)) for name in notebook_names()]
    show(grouped_table(rows))


_NAMES = completing(Target("mbdkit.spec:example_names"), Target("mbdkit.spec.loading:notebook_names"))


@examples_app.command("copy")
def examples_copy(
    name: Annotated[
        str, typer.Argument(metavar="NAME", autocompletion=_NAMES, help="Name of an example, from `mbdkit examples`.")
    ],
    output: Annotated[
        Path | None, output_to("FILE", "The file; by default ./NAME.yaml, or ./NAME.ipynb for a notebook.")
    ] = None,
    debug: Debug = False,
) -> None:
    """Copy an example to a file: a spec with its comments, or a notebook.

    Tables and other files that the spec reads are copied to the same folder. A
    notebook is written for Jupyter, or as a script with cells if FILE ends with .py. An existing file is
    not replaced.
    """
    from mbdkit.base.errors import SpecError
    from mbdkit.base.files import check_suffix, replacing
    from mbdkit.spec import example_names, example_text
    from mbdkit.spec.loading import example_files, jupyter_text, nearest_examples, notebook_names, notebook_text

    notebooks = notebook_names()
    known = [*example_names(), *notebooks]
    if name not in known:
        raise SpecError(f"there is no example '{name}'{nearest_examples(name, known)}")
    path = output if output is not None else Path(f"{name}.{'ipynb' if name in notebooks else 'yaml'}")
    if name in notebooks:
        check_suffix(path, (".ipynb", ".py"), "a notebook")
        script = notebook_text(name)
        texts = {path: script if path.suffix.lower() == ".py" else jupyter_text(script)}
    else:
        files = {path.with_name(file): text for file, text in example_files(name).items()}
        texts = {path: example_text(name), **files}
    for target in texts:
        if (
            target.is_file()
        ):  # replaces the message of `replacing`, which suggests --overwrite; this command has no such option
            raise SpecError("this file exists already; choose another name or folder with -o", file=target)
    for target, text in texts.items():
        with replacing(target, overwrite=False) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        show(target)


_TOPICS = completing(Target("mbdkit.guide.pages:pages"))


def guide(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="TOPIC", autocompletion=_TOPICS, help="A page, or words to search for."),
    ] = None,
    debug: Debug = False,
) -> None:
    """List the pages of the guide, print one, or search them.

    Pages are Markdown. A pager helps with long ones, as in
    `mbdkit guide spec | less`. Words that are not the name of a page
    are searched for, as in `mbdkit guide how do I add a spring`.
    """
    from mbdkit.guide.pages import find_page, pages, search

    if not (topic := " ".join(words or ())):
        show(grouped_table((page.group, page.topic, page.summary) for page in pages().values()))
    elif topic not in pages() and (hits := search(topic)):
        for hit in hits:
            show(f"{hit.topic}: {hit.heading}\n    {hit.line}")
    else:
        show(find_page(topic).text.rstrip("\n"))
