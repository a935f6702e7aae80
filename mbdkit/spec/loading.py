"""Loads specs of runs and of inverse dynamics from files, examples, mappings and mechanisms.

This module also defines the types of these sources.
"""

from __future__ import annotations

import functools
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, TypedDict, TypeVar, cast

from mbdkit.base.errors import SpecError
from mbdkit.base.files_read import recording
from mbdkit.base.plain_data import copied
from mbdkit.base.text import did_you_mean
from mbdkit.engine.formulation import FormulationName
from mbdkit.mechanism.element_kinds import element_files, element_kinds
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.element_items import ElementKind, ModelKey
from mbdkit.registry.feature_items import Example
from mbdkit.registry.manager import registry
from mbdkit.spec.estimates import read_estimates
from mbdkit.spec.input_tables import read_input_files
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import Document, read_file, read_stdin, read_text
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.spec_kinds import refused, spec_kinds, spec_loader

Section: TypeAlias = Mapping[str, object]  #: A section of a spec, such as ``{"name": "gauss", "stages": 2}``.

#: A file, the name of a packaged example, a mapping, a validated spec, or a mechanism.
RunSource: TypeAlias = str | Path | Mapping[str, object] | RunSpec | Mechanism


class Sections(TypedDict, total=False):
    """Top-level keys of a run spec as keyword arguments; see `mbdkit.RunSpec` for their meaning."""

    mbdkit: Literal[1]
    title: str
    meta: Section
    parameters: Mapping[str, float | str]
    estimates: Section | None
    model: Section
    formulation: FormulationName | Section
    stabilization: Section
    integrator: Section
    time: Section
    output: Section
    events: Mapping[str, Section]
    measures: Mapping[str, str | Mapping[str, object]]
    gradients: Sequence[str] | Section
    inputs: Mapping[str, Section]
    limits: Section
    check: bool
    accuracy: float | None
    choose: Literal["method", "step", "nothing"] | None
    impacts: Literal["refuse", "allow"]
    contact: Section
    accept: list[str]


VERSION = 1

S = TypeVar("S", bound=ModelSpec)


def load_spec(source: object, assignments: Iterable[str] = (), **sections: object) -> RunSpec:
    """Load and validate a run spec, build its mechanism, and return the spec, which is immutable.

    Parameters
    ----------
    source
        A file (YAML, TOML, JSON), ``"-"`` for standard input, the name of a packaged example, a mapping, a `Mechanism`,
        or a `RunSpec`.
    assignments
        Texts such as ``"time.step=0.005"``, with values in YAML.
    sections
        Top-level keys of the spec, such as ``time={"end": 5, "step": 0.01}``, which replace those in `source`.

    Raises
    ------
    SpecError
        If the spec is not valid, with the file, line and key path if known.
    """
    return loaded("run", RunSpec, source, assignments, sections)


spec_loader(load_spec)


def loaded(
    name: str,
    kind: type[S],
    source: object,
    overrides: Iterable[str],
    sections: Mapping[str, object],
    defaults: Mapping[str, object] = MappingProxyType({}),
) -> S:
    """Return a validated spec of the kind with this name, which is of the class `kind`, from any source.

    `defaults`: sections that are added if they are missing.
    """
    if isinstance(source, kind) and not sections and not tuple(overrides):
        source.mechanism()
        return source
    document = _document(source)
    document.data |= sections
    document.keywords = frozenset(sections)
    if error := refused(document.data, name):
        raise document.place(error)
    document.data = {**defaults, **document.data}
    for assignment in overrides:
        document.assign(assignment)
    files = document.files
    with SpecError.place_by(document.place):
        _read_files(document)
        spec = kind(**document.data)
        spec._document = document  # before the mechanism, which may depend on files in the folder of the spec
        mechanism = spec.mechanism()
        if files:
            spec.adopt(mechanism, files)
    return spec


def _read_files(document: Document) -> None:
    model: Any = document.data.get("model")
    with recording(document.files):
        read_estimates(document.data, document.folder)
        if isinstance(inputs := document.data.get("inputs"), Mapping):
            read_input_files(inputs, document.folder)
        keys = (cast(ModelKey, item.plugin) for item in registry().of_kind("model-key"))
        kinds: Mapping[str, ElementKind | ModelKey] = element_kinds() | {key.name: key for key in keys}
        for key, kind in kinds.items() if isinstance(model, Mapping) else ():
            if kind.read_files is not None and isinstance(elements := model.get(key), Mapping):
                element_files.of(kind.read_files)(elements, document.folder)


def example_names(kind: str | None = None) -> list[str]:
    """Return the names of the packaged examples of specs of a kind, such as ``run`` or ``inverse``, or of all specs.

    `load_spec` and `mbdkit.run` accept the names of run specs as a source, `mbdkit.inverse` those of inverse dynamics,
    and `mbdkit.design` those of designs.
    """
    return [name for name, own in _kinds(registry()).items() if kind in (None, own)]


@functools.lru_cache(maxsize=1)
def _kinds(known: Registry) -> dict[str, str]:
    marked = [kind for kind in spec_kinds() if kind.marker]
    texts = {name: path.read_text("utf-8") for name, path in _examples_of(known).items()}
    return {
        name: next((kind.name for kind in marked if f"\n{kind.marker}:" in text), "run") for name, text in texts.items()
    }


def example_groups() -> dict[str, str]:
    """Return the group of each packaged example, in the order of lists; empty for none."""
    return {item.name: cast(Example, item.plugin).group for item in registry().of_kind("example")}


def nearest_examples(name: str, known: Iterable[str]) -> str:
    """Return the end of a message on an unknown example: the nearest names, and the command that lists all."""
    return f"{did_you_mean(name, known, most=3)}; `mbdkit examples` lists all"


def example_text(name: str) -> str:
    """Return the text of the spec of a packaged example, including comments.

    Raises SpecError if there is no example with this name.
    """
    files = _examples()
    if name not in files:
        raise SpecError(f"there is no example '{name}'{nearest_examples(name, files)}")
    return files[name].read_text("utf-8")


def example_files(name: str) -> dict[str, str]:
    """Return the texts of the files that a packaged example names and that lie beside it, such as tables, by name."""
    path = _examples()[name]
    words = set(re.findall(r"[\w.-]+", path.read_text("utf-8"))) - {path.name}
    return {file: (path.parent / file).read_text("utf-8") for file in sorted(words) if (path.parent / file).is_file()}


def _examples() -> dict[str, Path]:
    return _examples_of(registry())


@functools.lru_cache(maxsize=2)
def _examples_of(known: Registry, suffix: str = ".yaml") -> dict[str, Path]:
    files = {item.name: cast(Example, item.plugin).file for item in known.of_kind("example")}
    return {name: files[name] for name in sorted(files) if files[name].suffix == suffix}


def read_source(source: Any) -> Document:
    """Read `source` into a document without validation; see `load_spec` for the kinds of source.

    Files that inputs and elements name are read, as are estimates of an identification that its `parameters` name.
    """
    document = _document(source)
    with SpecError.place_by(document.place):
        _read_files(document)
    return document


def _document(source: Any) -> Document:
    if isinstance(source, ModelSpec):
        fields, omitted = type(source).model_fields, source.ABSENT_BY_DEFAULT
        default = {name: info.get_default(call_default_factory=True) for name, info in fields.items()}
        values = source.sections()
        # A copy omits keys that may be absent and have their default values: unlike in a file, `check: false` in a copy
        # is not a choice of the user.
        kept = {name: value for name, value in values.items() if name not in omitted or value != default[name]}
        return Document(copied(kept), folder=source.folder)
    if isinstance(source, Mapping):
        return Document(copied(source))
    if isinstance(source, Document):
        return source
    if isinstance(source, str | Path):
        return _named(source)
    if hasattr(source, "to_spec"):
        model = source.to_spec()
        title = {"title": source.name} if source.name != model["name"] else {}
        return Document({"mbdkit": VERSION, **title, "model": model})
    raise SpecError(
        f"a spec is a file, the name of an example, a dict, a Mechanism or a RunSpec, not {type(source).__name__}"
    )


def _named(source: str | Path) -> Document:
    if source == "-":
        return read_stdin()
    names = [*_examples()]
    if not source:
        raise SpecError(f"the name of the spec is empty: give a file or an example{nearest_examples('', ())}")
    path = Path(source)
    if str(source) in names and not os.path.isfile(path):
        document = read_text(example_text(str(source)), f"{source} (packaged example)")
        document.folder = _examples()[str(source)].parent
        return document
    if not exists(path):
        message = f"there is no such file, and no packaged example with this name{nearest_examples(str(source), names)}"
        raise SpecError(message, file=str(source)[:200])
    return read_file(path)


def exists(path: Path) -> bool:
    """Return whether a file or folder exists at `path`, even if it is not readable."""
    try:
        path.stat()
    except PermissionError:
        return True
    except (OSError, ValueError):  # it does not exist, or its name is too long or contains a null character
        return False
    return True


_CELL = re.compile(r"^# %%(.*)\n", flags=re.MULTILINE)


def notebook_names() -> list[str]:
    """Return the names of the packaged notebooks."""
    return list(_examples_of(registry(), ".py"))


def notebook_text(name: str) -> str:
    """Return the script of the packaged notebook `name`."""
    return _examples_of(registry(), ".py")[name].read_text("utf-8")


def notebook_title(name: str) -> str:
    """Return the first heading of a packaged notebook."""
    return next(line[4:] for line in notebook_text(name).splitlines() if line.startswith("# # "))


def jupyter_text(script: str) -> str:
    """Return a script with cells as the text of a Jupyter file (nbformat 4.5) without outputs."""
    _, *parts = _CELL.split(script)
    cells = [_cell(number, *part) for number, part in enumerate(zip(parts[::2], parts[1::2], strict=True), start=1)]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return json.dumps({"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def _cell(number: int, kind: str, text: str) -> dict[str, object]:
    common = {"id": f"cell-{number}", "metadata": {}}
    if "[markdown]" in kind:
        words = re.sub(r"^# ?", "", text.strip("\n"), flags=re.MULTILINE)
        return {"cell_type": "markdown", **common, "source": words.splitlines(keepends=True)}
    source = text.strip("\n").splitlines(keepends=True)
    return {"cell_type": "code", **common, "source": source, "outputs": [], "execution_count": None}
