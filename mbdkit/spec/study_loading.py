"""From whatever a user names as a study to a checked StudySpec with its bases written out."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any

from mbdkit.errors import SpecError
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.manager import registry
from mbdkit.spec.loading import example_names, exists, read_source
from mbdkit.spec.plain_data import Path, parse_path, path_text
from mbdkit.spec.reading import read_file, read_stdin, read_text
from mbdkit.spec.source_document import Document
from mbdkit.spec.study_spec import StudySpec
from mbdkit.text import did_you_mean, listed


def load_study_spec(source: Any) -> StudySpec:
    """Return the checked study spec that `source` names, every base written out as a mapping.

    Parameters
    ----------
    source
        A file (YAML, TOML, JSON), ``"-"`` for the standard input, the name of a packaged study, a mapping, or a
        `StudySpec`. A base that is a file is looked for beside the study's own file.

    Returns
    -------
    StudySpec
        Strict and frozen; its runs are not checked yet.

    Raises
    ------
    SpecError
        If anything is wrong, with file, line and key path where there are any.
    """
    if isinstance(source, StudySpec):
        if source._document is not None:
            return source
        source = source.model_dump(exclude_unset=True)
    document, folder = _document(source)
    data = document.data
    if "mbdkit" in data and "mbdkit_study" not in data:
        message = "this is a run spec, which `mbdkit run` runs; a study spec begins with `mbdkit_study: 1`"
        raise document.place(SpecError(message, key="mbdkit"))
    try:
        bases = _write_out_bases(data, folder)
        spec = StudySpec(**data)
    except SpecError as error:
        raise document.place(error) from None
    spec._document = document
    spec._bases = bases
    return spec


def study_names() -> list[str]:
    """Return the names of the packaged studies, those of plugins included, which stand for their specs."""
    return sorted(registry().names("study"))


def _packaged(name: str) -> Registered | None:
    """Return the packaged study of this short or long name; None if there is none, SpecError if there are several."""
    installed = registry()
    known = any(name in (item.name, item.id) for item in installed.of_kind("study"))
    return installed.get("study", name) if known else None


def _document(source: Any) -> tuple[Document, FilePath]:
    """Return the document of a study, and the folder that file names in it are relative to."""
    if isinstance(source, Mapping):
        return Document(copy.copy(dict(source))), FilePath()
    if not isinstance(source, str | FilePath):
        what = type(source).__name__
        raise SpecError(f"a study is a file, the name of a packaged study, a dict or a StudySpec, not {what}")
    if source == "-":
        return _by_text(read_stdin()), FilePath()
    path = FilePath(source)
    packaged = None if os.path.isfile(path) else _packaged(str(source))
    if packaged is not None:
        return _document_of(packaged)
    if not exists(path):
        names = study_names()
        raise SpecError(
            f"there is no such file, and no packaged study of this name{did_you_mean(str(source), names)}; "
            f"studies: {listed(names)}{registry().advice(str(source))}",
            file=str(source)[:200],
        )
    return _by_text(read_file(path)), path.parent


def _document_of(item: Registered) -> tuple[Document, FilePath]:
    """Return the document of a packaged study, which its own verdict judges unless it names another, and its folder."""
    assert isinstance(item.plugin, StudyPlugin)
    path = item.plugin.spec
    text = path.read_text("utf-8")
    document = _by_text(read_text(text, f"{item.spec_name} (packaged study)", path.suffix))
    if item.plugin.verdict is not None and "verdict" not in document.data:
        document.data["verdict"] = item.spec_name
    return document, path.parent


def _by_text(document: Document) -> Document:
    """Let the lines of keys with dots in them be found by the text of their path."""
    lines = document.lines
    document.lines = lambda: {parse_path(path_text(path)): line for path, line in lines().items()}
    return document


def _write_out_bases(data: dict[str, Any], folder: FilePath) -> dict[Path, Document]:
    """Replace every base that is a name or a Python object by its data; return the documents of those, by key path."""
    documents: dict[Path, Document] = {}
    holders: dict[Path, dict[str, Any]] = {(): data}
    families = data.get("families")
    if isinstance(families, Mapping):
        data["families"] = families = dict(families)
        for name, family in families.items():
            if isinstance(family, Mapping):
                families[name] = holders["families", name] = dict(family)
    for path, holder in holders.items():
        base = holder.get("base")
        if base is None or isinstance(base, Mapping):
            continue
        if isinstance(base, str):
            base = _named(base, folder, path_text((*path, "base")))
        documents[*path, "base"] = document = read_source(base)
        holder["base"] = document.data
    return documents


def _named(base: str, folder: FilePath, key: str) -> str | FilePath:
    """Return a base as `read_source` takes it: a file beside the study, or the name of an example."""
    path = folder / base
    names = example_names()
    if os.path.isfile(path) or base not in names:
        if base == "-" or not exists(path):
            raise SpecError(
                f"there is no file '{base}' beside the study, and no packaged example of this "
                f"name{did_you_mean(base, names)}; examples: {listed(names)}",
                key=key,
            )
        return path
    return base
