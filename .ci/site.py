"""Pages of the documentation site, as hooks of MkDocs: the Markdown of the repository, and the API reference.

Every file keeps its path in the repository, so that links between pages hold here and there; only pictures in `.github`
move to `pictures`, because hosts of static pages leave out folders with a dot.
"""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path
from typing import Any

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel

import mbdkit
from mbdkit.guide.pages import QUESTION_WORDS
from mbdkit.runs.method_evidence import FILE
from mbdkit_testing import matrix

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = "mbdkit/models/examples"
FILES = (
    "README.md", "CITATION.cff", "LICENSE", "mbdkit/README.md", "mbdkit/*/README.md", "mbdkit/guide/*.md",
    f"{EXAMPLES}/*.*", "schemas/*",
    "plugins/*/src/*/guide/*.md", "plugins/*/src/*/examples/*.*",
    "plugins/*/src/*/__init__.py", "plugins/mbdkit-paper/src/mbdkit_paper/*/*.md",
    "plugins/README.md", "plugins/*/README.md",
    ".github/*.png", ".github/gallery/*.png",
)  # fmt: skip
"""Files of the site, as patterns of paths in the repository."""


class Stubs(griffe.Extension):
    """Shows the methods of mechanisms that are made at run time as their stub declares them."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Replace these methods in the package."""
        if pkg.name == "mbdkit":
            path = ROOT / "mbdkit/mechanism/element_methods.pyi"
            stub = griffe.visit(path.stem, path, path.read_text(encoding="utf-8"))
            own = pkg["mechanism.element_methods.ElementMethods"]
            for name, method in stub["ElementMethods"].functions.items():
                given = own.members[name].docstring.value  # griffe has added methods of plugins from the stub
                examples = "" if given == method.docstring.value else given.partition("\n\n")[2]
                method.docstring.value += f"\n\nExamples\n--------\n{examples}" if examples else ""
                own.set_member(name, method)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the files of the site, with those of the theme."""
    found = [one for one in files if one.src_dir != config.docs_dir]
    for path in sorted(path for pattern in FILES for path in ROOT.glob(pattern) if path.suffix != ".pyc"):
        uri = _moved(path.relative_to(ROOT).as_posix())
        found.append(File.generated(config, uri, abs_src_path=str(path), inclusion=InclusionLevel.INCLUDED))
    evidence = [ROOT / "mbdkit" / FILE, *sorted(ROOT.glob(f"plugins/*/src/*/{FILE}"))]
    page = matrix.html([row for path in evidence for row in matrix.rows_of(path)], is_page=False)
    content = f"# Plugins, and what was observed of them\n\n{page}"
    found.append(File.generated(config, "matrix.md", content=content, inclusion=InclusionLevel.INCLUDED))
    found.append(File.generated(config, "api.md", content=_reference(), inclusion=InclusionLevel.INCLUDED))
    return Files(found)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page with the new addresses of pictures, and the gallery with the specs."""
    is_reference = page.file.src_uri == "mbdkit/guide/spec.md" or "/guide/" not in page.file.src_uri
    if is_reference:  # the search shows pages that explain before lists of keys and names, and maps of the code
        page.meta["search"] = {"boost": 0.1}
    markdown = re.sub(r"(\]\(|src=\")([./]*)\.github/", r"\1\2pictures/", markdown)
    if page.file.src_uri == "plugins/README.md":
        markdown = re.sub(r"\]\((mbdkit-[\w-]+)\)", r"](\1/README.md)", markdown)
    if page.file.src_uri == f"{EXAMPLES}/README.md":
        markdown = re.sub(r"\* Run: (`[^`]+`).*?\[([\w-]+\.yaml)\]\(([\w./-]+)\).*", _with_spec, markdown)
    return markdown


def on_post_build(config: MkDocsConfig) -> None:
    """Make the search split texts into the words of `mbdkit guide WORDS`: without words of questions, in the singular.

    The theme multiplies a word of a heading by 1000, and a page with its heading by 2.5; these numbers undo most of it.
    """
    path = Path(config.site_dir, "search/search_index.json")
    index = json.loads(path.read_text(encoding="utf-8"))
    words = "|".join(f"[{word[0]}{word[0].upper()}]{word[1:]}" for word in sorted(QUESTION_WORDS))
    index["config"]["separator"] = rf"[\W_]+|\b(?:{words})\b|(?<=ss)es\b|(?<=[^isu])s\b"
    index["config"]["fields"]["title"]["boost"] = 20.0
    for section in index["docs"]:
        if "#" not in section["location"]:
            section["boost"] = 0.4 * section.get("boost", 1.0)
    path.write_text(json.dumps(index), encoding="utf-8")


def _moved(uri: str) -> str:
    return uri.replace(".github/", "pictures/", 1)


def _with_spec(found: re.Match[str]) -> str:
    """Return the line of an example with its spec beneath it, folded."""
    text = (ROOT / EXAMPLES / found[3]).read_text(encoding="utf-8")
    lines = "\n".join(f"    {line}".rstrip() for line in ["```yaml", *text.splitlines(), "```"])
    return f'{found[0]}\n\n??? example "{found[2]}"\n\n{lines}\n'


def _reference() -> str:
    """Return the page of the public names of mbdkit, in the order of the package."""
    parts = ["# API reference", "The names that `import mbdkit` offers."]
    for name in mbdkit.__all__:
        thing = getattr(mbdkit, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            parts += [f"## {name}", f"::: {thing.__module__}.{thing.__qualname__}"]
    return "\n\n".join(parts)
